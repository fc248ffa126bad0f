"""Programs that leave JAX at its 32 bits get results of 64 bits, and their setting stays."""

import math
import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.sparse

from jaxcell import bounce, dynamics, examples, mapping, markov, optimize, space
from jaxcell.base.wide import wide


pytestmark = pytest.mark.usefixtures("without_flags")
HINT = r"traces it with 32 bits: call jax.config.update\(\"jax_enable_x64\", True\)"
THIRD = np.array([[0, 1 / 3, 2 / 3], [1, 0, 0], [0, 1, 0]])


def room():
    free = np.random.default_rng(4).random((12, 15)) < 0.85
    return space.CellSpace.of_grid(free, 24)


@pytest.mark.parametrize("collision", ["swept", "endpoint"])
def test_maps_and_groups_are_the_same(collision):
    def results():
        cells, angles = room(), np.radians([45, 75, 90])
        motion = space.Motion(collision=collision)
        maps = bounce.bounce_map(cells, angles, motion=motion)
        return jax.tree.leaves(
            (
                maps,
                bounce.bounce_groups(cells, angles, motion=motion),
                bounce.group_summary(cells, angles, motion=motion),
                jax.vmap(mapping.periodic_groups)(maps.image),
            )
        )

    without = results()
    with jax.enable_x64(True):
        with_x64 = results()
    for a, b in zip(without, with_x64, strict=True):
        np.testing.assert_array_equal(a, b)
        assert a.dtype == b.dtype


def test_a_chain_and_its_analyses_have_64_bits():
    chain = mapping.Chain.from_scipy(scipy.sparse.csr_array(THIRD))
    # pi P = pi, solved by hand: pi = (3, 3, 2) / 8.
    stationary = np.array([3, 3, 2]) / 8
    groups = mapping.persistent_groups(chain)
    limit = markov.limiting_distribution(chain, groups).value
    np.testing.assert_allclose(limit, stationary, rtol=0, atol=1e-14)
    np.testing.assert_allclose(chain.push(stationary), stationary, rtol=0, atol=1e-15)
    np.testing.assert_allclose(markov.dense.stationary(THIRD), stationary, rtol=0, atol=1e-14)
    # From cell 2 to cell 1 it takes 1 step; from cell 0, 1/3 * 1 + 2/3 * 2 = 5/3 steps.
    times = markov.hitting_times(chain, 1).value
    np.testing.assert_allclose(times, [5 / 3, 0, 1], rtol=1e-14)
    law = markov.first_passage(chain, 0, 1, steps=2)
    np.testing.assert_allclose(law, [0, 1 / 3, 2 / 3], rtol=1e-14)
    assert jnp.zeros(1).dtype == jnp.float32


def test_results_can_be_used_outside_of_the_context():
    """JAX rounds its own 64-bit arrays at the next operation, or fails."""
    times = markov.hitting_times(mapping.Chain.from_scipy(THIRD), 1).value
    assert times.argmax() == 0
    assert times.max() == times[0] == pytest.approx(5 / 3, rel=1e-15)
    assert (3 * times).sum() == pytest.approx(8, rel=1e-15)
    assert jax.jit(lambda x: x.max())(times).dtype == jnp.float32


def test_methods_of_results_have_64_bits():
    cells = examples.lab()
    chain = bounce.noisy_bounce_map(cells, math.pi / 2, math.pi / 4, 0.8)
    distribution = np.full(cells.size, 1 / cells.size)
    later = chain.pull(distribution)
    assert later.dtype == np.float64
    np.testing.assert_allclose(later, chain.to_scipy() @ distribution, rtol=0, atol=1e-16)
    made = mapping.Chain(np.array([[1, 0]]), np.ones((1, 2)))
    assert made.leaving.dtype == made.push(np.array([1.0, 0.0])).dtype == np.float64


def test_maps_of_a_user_are_computed_with_64_bits():
    """Orbits of x -> 4 x (1 - x) double their rounding errors at each step."""
    box = space.Box([0], [1], cells=[2])
    seen = []

    def tent(x, p):
        seen.append(x.dtype)
        return p * x * (1 - x)

    dynamics.basins(tent, box, 3.2)
    assert set(seen) == {np.dtype("float64")}


def test_32_bit_arguments_do_not_round_the_rest():
    half = jnp.array([0.5, 0.25, 0.25])
    later = mapping.Chain.from_scipy(THIRD).push(half)
    np.testing.assert_allclose(later, [1 / 4, 1 / 6 + 1 / 4, 1 / 3], rtol=1e-15)


def test_a_flow_and_its_reversal_have_64_bits():
    _, flow = examples.gyres()
    parts = [*vars(flow).values(), *vars(flow.reversed()).values()]
    kinds = {part.dtype for part in parts if hasattr(part, "dtype")}
    assert np.dtype("float64") in kinds
    assert np.dtype("float32") not in kinds


@pytest.mark.parametrize(
    "call",
    [
        lambda p: mapping.Chain(jnp.array([[1, 0]]), p[None]),
        lambda p: optimize.mixture(np.eye(2), p),
    ],
)
def test_tracing_with_32_bits_raises(call):
    with pytest.raises((RuntimeError, TypeError), match=f"{HINT}|outside jit"):
        jax.jit(call)(jnp.ones(2))


def test_a_solve_under_a_trace_with_32_bits_raises():
    chain = examples.walk()
    with pytest.raises(RuntimeError, match=HINT):
        jax.jit(lambda chain: markov.first_passage(chain, 0, 1, steps=2))(chain)


def test_a_function_of_a_program_with_64_bits_returns_arrays_of_jax():
    with jax.enable_x64(True):
        assert isinstance(markov.hitting_times(examples.walk(), 2).value, jax.Array)
        assert isinstance(wide(jnp.zeros)(3), jax.Array)


def test_a_fresh_process_needs_no_flag_and_keeps_its_setting():
    program = """
import jax
from jaxcell import bundled, study
policy = study.Cover(
    map=bundled("lab_a"), bounce=(45.0, 90.0), errors="turn=45deg", reliability=0.7, directions=8
).run()
assert abs(policy.mixture.sum() - 1) < 1e-12 and policy.mixture.dtype == "float64"
assert not jax.config.jax_enable_x64
"""
    environment = {name: value for name, value in os.environ.items() if name != "JAX_ENABLE_X64"}
    command = [sys.executable, "-W", "error", "-c", program]
    subprocess.run(command, env=environment, check=True)


def test_lists_of_arguments_are_not_copied():
    grows, table = [(0.0, 1.0)], {"part": [(np.ones(2), 1)]}
    assert wide(lambda value: value)(grows) is grows
    assert wide(lambda value: value)(table) is table
