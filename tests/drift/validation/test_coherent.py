import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from seas import double_gyre, sea, water_and_flow

from jaxcell import drift


def linear(gradient, n=41, dx=1000.0, dy=1000.0):
    """A current that is linear in the place, 0 in the middle of the grid."""
    away = np.arange(n) - n // 2
    x, y = np.meshgrid(away * dx, away * dy)
    (a, b), (c, d) = gradient
    return sea(a * x + b * y, c * x + d * y, dx=dx, dy=dy)


def middle(currents, duration, **options):
    water = drift.Water.of(currents)
    grid = water.on_grid(drift.ftle(water, drift.Flow.of(currents), duration, **options))
    n = len(grid) // 2
    return grid[n - 2 : n + 3, n - 2 : n + 3]


TIME, RATE = 6 * 3600.0, 3e-5
SHEARED = math.log((RATE * TIME + math.hypot(RATE * TIME, 2)) / 2) / TIME


@pytest.mark.parametrize(("dx", "dy"), [(1000.0, 1000.0), (400.0, 1500.0)])
@pytest.mark.parametrize(
    ("gradient", "duration", "expected"),
    [
        (((2e-5, 0), (0, -5e-5)), TIME, 2e-5),
        (((2e-5, 0), (0, -5e-5)), -TIME, 5e-5),
        (((0, RATE), (0, 0)), TIME, SHEARED),
        (((0, 0), (RATE, 0)), TIME, SHEARED),
        (((0, -RATE), (RATE, 0)), TIME, 0.0),
    ],
    ids=["saddle", "saddle backward", "shear along x", "shear along y", "solid body"],
)
def test_linear_currents_stretch_at_their_rate(gradient, duration, expected, dx, dy):
    found = middle(linear(gradient, dx=dx, dy=dy), duration)
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-12)


def test_exponents_have_the_derivatives_of_the_closed_form():
    currents = linear(((0, 1e-5), (0, 0)), n=5)
    water, flow = drift.Water.of(currents), drift.Flow.of(currents)

    def inner(scale, duration):
        moving = dataclasses.replace(flow, rate=scale * flow.rate)
        return drift.ftle(water, moving, duration)[water.row == 2][1:4]

    def exact(scale, duration):
        """The exponent of the shear, as SHEARED."""
        shear = 1e-5 * scale * duration
        return jnp.log((shear + jnp.sqrt(shear**2 + 4)) / 2) / duration

    scales, durations = jnp.array([1.0, 2.0, 0.5]), jnp.array([9000.0, 3000.0, 7000.0])
    found = jax.jit(jax.vmap(inner))(scales, durations)
    slopes = jax.jit(jax.vmap(jax.jacrev(inner, (0, 1))))(scales, durations)
    each = jax.vmap(jax.grad(exact, (0, 1)))(scales, durations)
    for k in range(3):
        one = inner(float(scales[k]), float(durations[k]))
        np.testing.assert_allclose(found[k], one, rtol=1e-13)
        np.testing.assert_allclose(found[k], exact(scales[k], durations[k]), rtol=1e-9)
        for slope, expected in zip(slopes, each, strict=True):
            np.testing.assert_allclose(slope[k], expected[k], rtol=1e-7)


def test_a_cell_at_a_coast_has_an_exponent():
    wet = np.ones((41, 41), bool)
    wet[:15] = False
    x = np.broadcast_to((np.arange(41) - 20) * 1000.0, (41, 41))
    currents = sea(1e-5 * x, 0 * x, wet)
    exponents = drift.ftle(drift.Water.of(currents), drift.Flow.of(currents), 3600.0)
    assert exponents.shape == (26 * 41,)
    assert np.isfinite(exponents).all()


def test_ridges_are_the_crests_of_the_values():
    nothing = np.zeros((15, 15))
    water = drift.Water.of(sea(nothing, nothing))
    x, y = water.column, water.row

    def crest(values):
        return water.on_grid(drift.ridges(water, values), False)

    column = crest(-np.abs(x - 7.0))
    assert column[1:-1, 7].all()
    assert column.sum() == 13
    row = crest(np.exp(-((y - 4.0) ** 2)))
    assert row[4, 1:-1].all()
    assert row.sum() == 13
    diagonal = crest(-((x - y) ** 2.0))
    assert np.diagonal(diagonal)[1:-1].all()
    # Beside it, two cells are equally high across the crest.
    assert np.abs(np.subtract(*np.nonzero(diagonal))).max() == 1
    assert not crest(np.zeros(225)).any()
    # Only what is high counts: of two crests the lower one does not.
    both = -np.minimum(np.abs(x - 4.0), np.abs(x - 10.0)) - 5 * (x > 7)
    assert set(np.argwhere(water.on_grid(drift.ridges(water, both, share=0.1), False))[:, 1]) == {4}


def test_borders_lie_on_ridges_in_the_double_gyre():
    water, flow = water_and_flow(double_gyre(21, 42))
    crossing = drift.crossing_time(water, flow)
    chain = drift.drift_map(water, flow, drift.METHODS["drifters"].lasting(crossing))
    behaviour = drift.long_term_behaviour(chain, crossing)
    ridge = drift.ridges(water, drift.ftle(water, flow, 20 * crossing, steps=200))
    # Each half is a group; in the very middle of each there is a cell by itself.
    assert sorted(behaviour.groups.size.tolist()) == [1, 1, 440, 440]
    agree = drift.agreement(water, np.asarray(behaviour.groups.group), ridge)
    assert agree.near > 0.8
    assert agree.ratio > 5
    # Apart from the outer walls, the only ridge is the wall between the gyres.
    grid = water.on_grid(ridge, False)
    assert grid[2:-2, 20:22].any(axis=1).all()
    left = np.where(water.column < 21, 0, 1)
    whole = drift.agreement(water, left, ridge)
    assert (whole.near, whole.expected) == (1, pytest.approx(agree.expected))


def test_agreement_counts_cells():
    nothing = np.zeros((3, 6))
    water = drift.Water.of(sea(nothing, nothing))
    label = np.where(water.column < 3, 0, 1)
    ridge = (water.column == 4) & (water.row == 0)
    found = drift.agreement(water, label, ridge)
    # Of the cells in columns 2 and 3 those right of the border and low enough; of all 6 of 18.
    assert (found.near, found.expected) == (2 / 6, 6 / 18)
    assert found.ratio == 1
    assert drift.agreement(water, label, ridge, within=2).near == 1
    assert math.isnan(drift.agreement(water, label, np.zeros(18, bool)).ratio)


def test_shares_and_labels_out_of_range_are_refused():
    water = drift.Water.of(double_gyre(4, 8))
    with pytest.raises(ValueError, match="share: expected more than 0 and at most"):
        drift.ridges(water, np.zeros(32), share=0)
    with pytest.raises(ValueError, match="got no border"):
        drift.agreement(water, np.zeros(32, int), np.zeros(32, bool))
