"""Diffusion of unresolved motion, and reversed flows."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import ndtr
from seas import sea

from jaxcell import drift
from jaxcell.drift import advection


SIDE, STEP = 31, 3600.0
# The spread of one step, in cells of a kilometre.
SPREAD = 0.8
DIFFUSIVITY = (1000 * SPREAD) ** 2 / (2 * STEP)
SAMPLED = {"spread": "sampled", "edge": "exit", "samples": 3}


@pytest.fixture(scope="module")
def river():
    """A current of half a cell per step to the East."""
    currents = sea(np.full((SIDE, SIDE), 500 / STEP), np.zeros((SIDE, SIDE)))
    return drift.Water.of(currents), drift.Flow.of(currents, diffusivity=DIFFUSIVITY)


def heat(steps):
    """The heat kernel of some steps, over the cells, from all of the cell in the middle."""
    from_, spread = np.linspace(-0.5, 0.5, 201), SPREAD * np.sqrt(steps)

    def along(shift):
        sides = np.arange(SIDE + 1) - SIDE // 2 - 0.5
        over = ndtr((sides[:, None] - from_ - shift) / spread).mean(axis=1)
        return np.diff(over)

    return np.outer(along(0.0), along(0.5 * steps))


def test_drifters_spread_by_the_heat_kernel(river):
    water, flow = river
    chain = drift.drift_map(water, flow, drift.DriftStep(STEP, **SAMPLED))
    middle = int(water.number[SIDE // 2, SIDE // 2])
    after = np.zeros(water.cells)
    after[middle] = 1.0
    once = np.asarray(chain.push(after)).reshape(SIDE, SIDE)
    place = np.arange(SIDE) - SIDE // 2
    for axis, mean in ((0, 0.5), (1, 0.0)):
        over = once.sum(axis=axis)
        assert over @ place == pytest.approx(mean, abs=0.01)
        # Of the cell itself, of the walk, and of the cells of the grid.
        assert over @ (place - mean) ** 2 == pytest.approx(1 / 12 + SPREAD**2 + 1 / 12, rel=0.02)
    assert np.abs(once - heat(1)).sum() / 2 < 0.02


def test_probabilities_have_the_derivative_of_the_heat_kernel():
    currents = sea(np.full((9, 9), 300 / STEP), np.zeros((9, 9)))
    water, flow = drift.Water.of(currents), drift.Flow.of(currents, diffusivity=DIFFUSIVITY)
    step = drift.DriftStep(STEP, spread="sampled", edge="exit", samples=1)
    middle = jnp.zeros(water.cells).at[40].set(1.0)

    def columns(scale, duration=STEP):
        moving = dataclasses.replace(flow, rate=scale * flow.rate)
        after = drift.drift_map(water, moving, step.lasting(duration)).push(middle)
        return after.reshape(9, 9).sum(axis=0)

    def kernel(scale):
        """The normal distribution over the squares, which is cut off after 3 of them."""
        sides = jax.scipy.stats.norm.cdf((jnp.arange(8.0) - 3.5 - 0.3 * scale) / SPREAD)
        return jnp.pad(jnp.diff(sides) / (sides[-1] - sides[0]), 1)

    scales = jnp.array([1.0, 0.5])
    found, slopes = (jax.jit(jax.vmap(of))(scales) for of in (columns, jax.jacrev(columns)))
    for k, scale in enumerate(scales.tolist()):
        np.testing.assert_allclose(found[k], columns(scale), atol=1e-15)
        np.testing.assert_allclose(found[k], kernel(scale), atol=1e-14)
        np.testing.assert_allclose(slopes[k], jax.jacfwd(kernel)(scale), atol=1e-13)
    with pytest.raises(TypeError, match="duration: expected numbers that JAX does not trace"):
        jax.jit(columns)(1.0, STEP)


def test_diffusion_needs_sampling_and_short_steps(river):
    water, flow = river
    still = drift.Flow(flow.rate, flow.time)
    chain = drift.drift_map(water, still, drift.DriftStep(STEP, **SAMPLED))
    assert chain.image.shape[0] == 2
    with pytest.raises(ValueError, match="expected spread 'sampled'"):
        drift.drift_map(water, flow, drift.DriftStep(STEP))
    with pytest.raises(ValueError, match="expected 10 at most"):
        drift.drift_map(water, flow, drift.DriftStep(1e4 * STEP, **SAMPLED))
    with pytest.raises(ValueError, match="expected 0 m²/s or more"):
        drift.Flow.of(sea(np.ones((2, 2)), np.ones((2, 2))), diffusivity=-1)


def test_replayed_drifters_diffuse_as_the_map_does(river):
    water, flow = river
    middle = int(water.number[SIDE // 2, SIDE // 2])
    moved = drift.simulate_drifters(
        jax.random.key(1), water, flow, middle, STEP, 4, drifters=20_000
    )
    spread = np.asarray(moved.x)[-1].std(), np.asarray(moved.y)[-1].std()
    assert spread == pytest.approx(2 * [np.sqrt(1 / 12 + 4 * SPREAD**2)], rel=0.03)
    assert np.asarray(moved.x)[-1].mean() == pytest.approx(SIDE // 2 + 2, abs=0.05)
    chain = drift.drift_map(water, flow, drift.DriftStep(STEP, **SAMPLED))
    (near,) = drift.distances(water, flow, [(chain, STEP)])
    assert near.total_variation[0] < 0.05
    assert near.drifters_left[0] == pytest.approx(near.map_left[0], abs=0.02)


def test_no_drifter_diffuses_ashore():
    wet = np.ones((9, 9), bool)
    wet[:, 4] = False
    currents = sea(np.zeros((9, 9)), np.zeros((9, 9)), wet)
    water = drift.Water.of(currents)
    sides = np.stack([water.dx, water.dy])
    x, y = water.column.astype(float), water.row.astype(float)
    for key in jax.random.split(jax.random.key(0), 5):
        x, y = advection.diffuse(key, DIFFUSIVITY, False, sides, wet, ~wet, x, y, STEP)
    cell, inside = water.at(*(np.rint(np.asarray(one)).astype(int) for one in (y, x)))
    assert (cell[inside] >= 0).all()
    assert not inside.all()


def test_one_program_simulates_all_diffusivities():
    currents = sea(np.zeros((9, 9)), np.zeros((9, 9)))
    water, middle = drift.Water.of(currents), np.full(2000, 4.0)

    def spread(diffusivity):
        flow = drift.Flow.of(currents, diffusivity=diffusivity)
        key = jax.random.key(3)
        return advection.drifted(water, flow, middle, middle, 0, STEP, STEP, key)[0].std()

    narrow, programs = spread(DIFFUSIVITY / 16), advection._drifted._cache_size()
    assert spread(DIFFUSIVITY / 4) == pytest.approx(2 * narrow, rel=1e-9)
    assert advection._drifted._cache_size() == programs


def test_the_reversed_flow_brings_drifters_back():
    random = np.random.default_rng(2)
    currents = sea(*random.normal(0, 0.2, (2, 4, 12, 12)))
    flow = drift.Flow.of(currents)
    x, y = random.uniform(4, 7, (2, 50))
    there = drift.advect(flow, x, y, STEP * 3, method="rk4", steps=24)
    back = drift.advect(flow.reversed(), *there, STEP * 3, method="rk4", steps=24)
    np.testing.assert_allclose(back, [x, y], atol=1e-3)
    assert not np.allclose(there, [x, y], atol=0.1)
    again = flow.repeated().reversed()
    assert float(again.period) == 4 * STEP
    np.testing.assert_array_equal(again.rate[0], -flow.rate[0])
    np.testing.assert_array_equal(again.rate[1], -flow.rate[3])
