import jax
import numpy as np
import pytest
from scipy.stats import wasserstein_distance
from seas import double_gyre, sea, water_and_flow

from jaxcell.drift.drift_step import DriftStep
from jaxcell.drift.flow import Flow, crossing_time
from jaxcell.drift.maps import drift_map
from jaxcell.drift.validation.simulated_drifters import compare, simulate_drifters
from jaxcell.drift.water import Water


def uniform(east, north, dx=900.0, dy=900.0):
    """The same current everywhere on 9 x 9 cells."""
    return water_and_flow(sea(np.full((9, 9), east), np.full((9, 9), north), dx=dx, dy=dy))


def test_drifters_begin_in_their_cells_and_go_with_the_flow(getkey):
    water, flow = uniform(0.5, 0.25)
    drifters = simulate_drifters(getkey(), water, flow, [10, 11], 1800.0, 6, drifters=4000)
    assert drifters.cell.shape == (7, 4000)
    assert set(drifters.cell[0]) == {10, 11}
    share = drifters.share(water.cells)
    assert share[0, 10] == pytest.approx(0.5, abs=0.03)
    x, y = np.asarray(drifters.x), np.asarray(drifters.y)
    np.testing.assert_allclose(x[1] - x[0], 1.0, rtol=1e-9)
    np.testing.assert_allclose(y[2] - y[0], 1.0, rtol=1e-9)
    # A whole cell to the East and half a cell to the North: two rows share the drifters.
    assert set(np.flatnonzero(share[1])) == {11, 12, 20, 21}
    np.testing.assert_allclose(share[1, [11, 12, 20, 21]], 0.25, atol=0.03)


def test_drifters_are_reproducible_from_their_key():
    water, flow = uniform(0.5, 0.25)

    def run(seed):
        key = jax.random.key(seed)
        return np.asarray(
            simulate_drifters(key, water, flow, [10, 11], 900.0, 6, drifters=4000, rho=0.5).x
        )

    np.testing.assert_array_equal(run(1), run(1))
    assert (run(1)[0] != run(2)[0]).any()


def test_disturbed_drifters_are_turned(getkey):
    water, flow = uniform(1.8, 2.4, dx=1000.0, dy=500.0)
    drifters = simulate_drifters(getkey(), water, flow, [36, 37], 500.0, 6, drifters=4000, rho=0.5)
    x, y = np.asarray(drifters.x), np.asarray(drifters.y)
    right, up = 1000 * (x[1] - x[0]), 500 * (y[1] - y[0])
    angle = np.degrees(np.arctan2(up, right) - np.arctan2(2.4, 1.8))
    np.testing.assert_allclose(np.hypot(right, up), 1500, rtol=1e-9)
    values, counts = np.unique(np.round(angle, 6), return_counts=True)
    assert values.tolist() == [-45, 0, 45]
    np.testing.assert_allclose(counts / 4000, [0.25, 0.5, 0.25], atol=0.03)


def test_the_chain_of_a_rigid_shift_is_exact(getkey):
    water, flow = water_and_flow(sea(np.full((3, 40), 1.0), np.zeros((3, 40)), dx=900.0, dy=900.0))
    chain = drift_map(water, flow, DriftStep(900.0, rho=1.0, edge="exit"))
    drifted = simulate_drifters(getkey(), water, flow, [40, 55, 70], 900.0, 100, drifters=300)
    comparison = compare(water, chain, drifted)
    assert comparison.hours.tolist() == [1, 12, 24]
    assert comparison.total_variation[0] == pytest.approx(0, abs=1e-12)
    # At last all have left, and stay where they left.
    x = np.asarray(drifted.x)
    assert (drifted.cell[40:] == -1).all()
    assert (x[40:] == x[-1]).all()
    assert not drifted.share(water.cells)[40:].any()
    assert (comparison.total_variation[1:] == 0).all()
    assert np.isnan(comparison.transport[2])


def test_comparisons_are_those_of_the_definitions(getkey):
    water, flow = water_and_flow(double_gyre(12, 24))
    duration = crossing_time(water, flow)
    chain = drift_map(water, flow, DriftStep(duration, edge="exit"))
    steps = round(12 * 3600 / duration)
    drifted = simulate_drifters(
        getkey(), water, flow, [100, 101], duration, steps, drifters=3000, rho=0.8
    )
    comparison = compare(water, chain, drifted, [1, 12])
    for k, hours in enumerate((1, 12)):
        step = round(hours * 3600 / duration)
        expected = np.bincount(drifted.cell[0], minlength=water.cells) / 3000
        pushed = expected @ np.linalg.matrix_power(chain.to_scipy().toarray(), step)
        counted = np.bincount(drifted.cell[step], minlength=water.cells) / 3000
        gone = abs(pushed.sum() - (drifted.cell[step] >= 0).mean())
        different = np.abs(pushed - counted).sum() + gone
        assert comparison.total_variation[k] == pytest.approx(different / 2)
        assert comparison.transport[k] == pytest.approx(
            max(
                wasserstein_distance(place, place, pushed, counted)
                for place in (water.column, water.row)
            )
        )
        assert comparison.hours[k] == pytest.approx(step * duration / 3600)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"cells": 32}, "cell 32 does not exist; cells are 0 to 31"),
        ({"drifters": 0}, "1 drifter or more, got 2 and 0"),
        ({}, r"hours: expected times from 0 to 0.5, got \[1, 12, 24\]"),
        ({"side": 3}, "chain: expected one of 32 cells, got one of 9"),
    ],
)
def test_simulations_and_comparisons_out_of_range_are_refused(getkey, options, message):
    water, flow = (of(double_gyre(4, 8)) for of in (Water.of, Flow.of))
    side = options.pop("side", None)
    other = double_gyre(*((side, side) if side else (4, 8)))
    chain = drift_map(Water.of(other), Flow.of(other), DriftStep(900.0))
    options = {"cells": 0, "duration": 900.0, "steps": 2, "drifters": 2} | options
    with pytest.raises(ValueError, match=message):
        compare(water, chain, simulate_drifters(getkey(), water, flow, **options))
