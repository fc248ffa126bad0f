"""Without 64-bit numbers, integer results are the same, and solves raise an error.

`make test-all` runs this file in a process of its own with JAX_ENABLE_X64=0 as well.
"""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.sparse

from jaxcell.bounce import (
    bounce_groups,
    bounce_map,
    coverage_policy,
    group_summary,
    noisy_bounce_map,
)
from jaxcell.mapping import periodic_groups
from jaxcell.mapping.classes import persistent_groups
from jaxcell.mapping.generalized import Chain
from jaxcell.markov import (
    absorption_probabilities,
    absorption_times,
    hitting_times,
    limiting_distribution,
)
from jaxcell.optimize import mixture
from jaxcell.space import CellSpace, Motion


CIRCLE = scipy.sparse.csr_array(np.roll(np.eye(3), 1, axis=1))
HINT = r"JAX is set to 32 bits: call jax.config.update\(\"jax_enable_x64\", True\)"


@pytest.fixture(autouse=True)
def _without_x64():
    with jax.enable_x64(False):
        assert jnp.zeros(1).dtype == jnp.float32
        yield


def room():
    free = np.random.default_rng(4).random((12, 15)) < 0.85
    return CellSpace.of_grid(free, 24)


@pytest.mark.parametrize("collision", ["swept", "endpoint"])
def test_maps_and_groups_are_the_same(collision):
    def results():
        cells, angles = room(), np.radians([45, 75, 90])
        maps = bounce_map(cells, angles, motion=Motion(collision=collision))
        return jax.tree.leaves(
            (
                maps,
                bounce_groups(cells, angles, motion=Motion(collision=collision)),
                group_summary(cells, angles, motion=Motion(collision=collision)),
                jax.vmap(periodic_groups)(maps.image),
            )
        )

    without = results()
    with jax.enable_x64(True):
        with_x64 = results()
    for a, b in zip(without, with_x64, strict=True):
        np.testing.assert_array_equal(a, b)
        assert a.dtype == b.dtype


@pytest.mark.parametrize(
    "make",
    [
        lambda: Chain(np.array([[1, 0]]), np.ones((1, 2))),
        lambda: Chain(jnp.array([[1, 0]]), jnp.ones((1, 2))),
        lambda: Chain.from_scipy(CIRCLE),
        lambda: noisy_bounce_map(room(), math.pi / 2, math.pi / 12, 0.8),
        lambda: coverage_policy(room(), [math.pi / 2], math.pi / 12, 0.8),
        lambda: mixture(np.eye(2), np.ones(2)),
    ],
)
def test_functions_that_need_64_bits_raise(make):
    with pytest.raises(RuntimeError, match=HINT):
        make()


def test_solves_of_a_chain_made_with_64_bits_say_so():
    with jax.enable_x64(True):
        chain = Chain.from_scipy(CIRCLE)
        groups = persistent_groups(chain)
    for solve in (limiting_distribution, absorption_probabilities, absorption_times):
        with pytest.raises(RuntimeError, match=HINT):
            solve(chain, groups)
    with pytest.raises(RuntimeError, match=HINT):
        hitting_times(chain, 0)
