import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from seas import sea

from jaxcell import examples
from jaxcell.drift.advection import advect, carried
from jaxcell.drift.drift_step import DriftStep
from jaxcell.drift.flow import Flow, between, crossing_time, in_squares
from jaxcell.drift.maps import flow_map
from jaxcell.drift.water import Water


def still(rows, columns, wet=None, **metric):
    nothing = np.zeros((rows, columns))
    return Water.of(sea(nothing, nothing, wet, **metric))


def test_cells_are_numbered_row_by_row():
    water = still(2, 3, [[[True, False, True], [False, True, True]]])
    assert water.number.tolist() == [[0, -1, 1], [-1, 2, 3]]
    assert (water.row.tolist(), water.column.tolist()) == ([0, 0, 1, 1], [0, 2, 1, 2])
    assert water.cells == 4
    grid = water.on_grid(np.arange(4) * 2, -7)
    assert grid.tolist() == [[0, -7, 2], [-7, 4, 6]]


def test_neighbors_and_boundary():
    wet = np.ones((4, 4), bool)
    wet[3, 3] = False
    water = still(4, 4, wet)
    assert water.neighbor[:, 5].tolist() == [0, 1, 2, 4, 6, 8, 9, 10]
    assert water.neighbor[:, 0].tolist() == [-1, -1, -1, -1, 1, -1, 4, 5]
    inner = np.flatnonzero(~water.boundary)
    # Cell 10 touches the land at its corner.
    assert inner.tolist() == [5, 6, 9]


def test_every_centre_is_in_its_own_cell():
    wet = np.random.default_rng(0).random((9, 7)) < 0.7
    water = still(9, 7, wet)
    for cell in range(water.cells):
        lon, lat = (g[water.row[cell], water.column[cell]] for g in (water.lon, water.lat))
        assert water.cell(lon + 0.003, lat - 0.003) == cell
        assert water.cell(lon + 360, lat) == cell


def test_a_place_ashore_or_off_the_grid_is_refused():
    wet = np.ones((3, 3), bool)
    wet[1, 1] = False
    water = still(3, 3, wet)
    with pytest.raises(ValueError, match=r"not in the water at 0 m; the nearest water is 0.998 km"):
        water.cell(-118 + 0.0107, 33.009)
    with pytest.raises(ValueError, match=r"off the grid: the nearest square is .* km away"):
        water.cell(-118.5, 33)
    with pytest.raises(ValueError, match="expected a longitude and a latitude"):
        water.cell(0, 91)


@pytest.mark.parametrize("angle_deg", [0, 30, 90, -135])
@pytest.mark.parametrize(("method", "steps"), [("euler", 1), ("euler", 3), ("rk4", 3)])
def test_a_current_to_the_east_goes_east_on_a_rotated_grid(angle_deg, method, steps):
    angle = math.radians(angle_deg)
    currents = sea(np.ones((3, 3)), np.zeros((3, 3)), dx=500.0, dy=2000.0, angle=angle)
    step = DriftStep(1000.0, method=method, substeps=steps)
    right, up = np.asarray(flow_map(Water.of(currents), Flow.of(currents), step))
    x, y = right * 500, up * 2000
    east, north = x * np.cos(angle) - y * np.sin(angle), x * np.sin(angle) + y * np.cos(angle)
    np.testing.assert_allclose(east, 1000, rtol=1e-12)
    np.testing.assert_allclose(north, 0, atol=1e-9)


def rotation(n=41, period=86400.0):
    """Water that turns as a solid body about the middle of the grid."""
    away = (np.arange(n) - n // 2) * 1000.0
    rate = 2 * math.pi / period
    return sea(-rate * np.broadcast_to(away[:, None], (n, n)), rate * np.tile(away, (n, 1)))


def test_solid_body_rotation():
    currents = rotation()
    flow = Flow.of(currents)
    x, y = jnp.array([25.0, 20.0, 17.5]), jnp.array([20.0, 26.0, 14.25])
    angle = 2 * math.pi * 5 / 24
    right, up = np.asarray(x) - 20, np.asarray(y) - 20
    expected = (
        20 + right * math.cos(angle) - up * math.sin(angle),
        20 + right * math.sin(angle) + up * math.cos(angle),
    )
    # A linear flow is bilinear, so only the steps are inexact: of order 4.
    errors = []
    for steps in (4, 8):
        found = advect(flow, x, y, 5 * 3600.0, method="rk4", steps=steps)
        errors.append(np.abs(np.stack(found) - expected).max())
    assert errors[1] < 1e-4
    assert 12 < errors[0] / errors[1] < 24
    # Backwards it comes back.
    back = advect(flow, *found, -5 * 3600.0, method="rk4", steps=8)
    np.testing.assert_allclose(back, [x, y], atol=1e-4)


def test_time_is_interpolated_between_records():
    # The current grows by 1 m/s in an hour: after half an hour 450 m more than none.
    east = np.arange(3.0)[:, None, None] * np.ones((3, 2, 2))
    currents = sea(east, 0 * east, dx=1.0)
    flow = Flow.of(currents)
    zero = jnp.zeros(1)
    x, _ = advect(flow, zero, zero, 1800.0, method="rk4", steps=2)
    np.testing.assert_allclose(x, 450.0)
    x, _ = advect(flow, zero, zero, 3600.0, start=3600.0, method="rk4")
    np.testing.assert_allclose(x, 5400.0)
    # Past the last record it stays as it is then, and so it does before the first.
    x, _ = advect(flow, zero, zero, 100.0, start=9e9, method="euler")
    np.testing.assert_allclose(x, 200.0)
    x, _ = advect(flow, zero, zero, 100.0, start=-9e9, method="euler")
    np.testing.assert_allclose(x, 0.0)
    np.testing.assert_allclose(Flow.of(currents, record=2).rate[0, 0], 2.0)
    np.testing.assert_allclose(flow.mean().rate[0, 0], 1.0)


def test_the_flow_between_centres_is_bilinear_and_stops_at_the_coast():
    east = np.array([[1.0, 3.0], [5.0, 9.0]])
    wet = np.array([[True, True], [True, False]])
    flow = Flow.of(sea(east, -east, wet, dx=1.0, dy=1.0))
    x, y = jnp.array([0.5, 0.0, 1.0, 0.25, -9.0]), jnp.array([0.0, 0.5, 0.5, 0.5, -9.0])
    along_x, along_y = between(flow, in_squares(flow, 0.0), x, y)
    # Halfway between 3 and the land it is 1.5.
    np.testing.assert_allclose(along_x, [2.0, 3.0, 1.5, 0.75 * 3 + 0.25 * 1.5, 1.0])
    np.testing.assert_allclose(along_y, -along_x)


def test_the_default_step_drifts_one_cell_on_average():
    random = np.random.default_rng(1)
    currents = sea(*random.normal(size=(2, 5, 8, 9)), random.random((8, 9)) < 0.8, dx=800.0)
    water, flow = Water.of(currents), Flow.of(currents)
    duration = crossing_time(water, flow)
    shifts = [
        flow_map(water, Flow.of(currents, record=record), DriftStep(duration))
        for record in range(5)
    ]
    assert np.mean([np.hypot(*np.asarray(shift)).mean() for shift in shifts]) == pytest.approx(1)
    steady = Flow.of(currents, record=2)
    found = flow_map(water, steady, DriftStep())
    np.testing.assert_array_equal(
        found, flow_map(water, steady, DriftStep(crossing_time(water, steady)))
    )


@pytest.mark.parametrize("shape", [(0,), (7,), (2, 520), (2, 40_000)])
def test_any_number_of_points_is_carried_as_by_advect(shape):
    flow = Flow.of(rotation(9)).repeated()
    x, y = np.random.default_rng(0).uniform(0, 8, (2, *shape))
    for method, steps in ("rk4", 3), ("euler", 1):
        expected = advect(flow, x, y, 900.0, start=60.0, method=method, steps=steps)
        found = carried(flow, x, y, 900.0, 60.0, method, steps)
        np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_layers_have_cells_of_their_own():
    east = np.zeros((1, 2, 2, 3))
    east[0, 1] = 2
    wet = np.ones((2, 2, 3), bool)
    wet[1, 0, 0] = False
    currents = sea(east, 0 * east, wet)
    assert Water.of(currents, 1).cells == 5
    assert Water.of(currents, 1).depth == 5
    assert float(Flow.of(currents, 1).rate.max()) == pytest.approx(0.002)
    assert not np.asarray(Flow.of(currents, 0).rate).any()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda c: Water.of(c, 1), "layer 1 does not exist; there are 1"),
        (lambda c: Water.of(c.assign(water=c.water & False)), "layer 0 has no water"),
        (lambda c: Flow.of(c, 0, 3), "record 3 does not exist; there are 1"),
        (lambda c: advect(Flow.of(c), *np.ones((2, 1)), 1.0, steps=0), "steps: expected 1 or more"),
        (lambda c: advect(Flow.of(c), *np.ones((2, 1)), 1.0, method="leap"), "got 'leap'"),
        (lambda c: flow_map(Water.of(c), Flow.of(c), DriftStep()),
         "the water stands still everywhere"),
        (lambda c: flow_map(still(2, 2), Flow.of(c), DriftStep(1.0)),
         r"over the \[2, 2\] squares of this water, got one over \[3, 3\]"),
    ],
)  # fmt: skip
def test_bad_input_is_refused(call, message):
    nothing = np.zeros((3, 3))
    with pytest.raises(ValueError, match=message):
        call(sea(nothing, nothing))


def test_displacements_have_derivatives_by_the_current_and_the_duration():
    water, flow = examples.gyres()

    def of_current(scale):
        return dataclasses.replace(flow, rate=scale * flow.rate)

    def shift(scale, duration):
        step = DriftStep(duration, method="rk4", substeps=3)
        return flow_map(water, of_current(scale), step)

    def mean_square(*numbers):
        return (shift(*numbers) ** 2).mean()

    scales, durations = jnp.array([1.3, 0.4]), jnp.array([700.0, 900.0])
    found = jax.jit(jax.vmap(shift))(scales, durations)
    for k in range(2):
        expected = shift(float(scales[k]), float(durations[k]))
        np.testing.assert_allclose(found[k], expected, atol=1e-14)
    by_scale, by_duration = jax.grad(mean_square, (0, 1))(1.3, 700.0)
    more, less = (mean_square(1.3 + step, 700.0) for step in (1e-5, -1e-5))
    np.testing.assert_allclose(by_scale, (more - less) / 2e-5, rtol=1e-6)
    more, less = (mean_square(1.3, 700.0 + step) for step in (1e-2, -1e-2))
    np.testing.assert_allclose(by_duration, (more - less) / 2e-2, rtol=1e-6)
    # The crossing time is inversely proportional to the current.
    time, slope = jax.value_and_grad(lambda scale: crossing_time(water, of_current(scale)))(2.0)
    np.testing.assert_allclose((time, slope), crossing_time(water, flow) / np.array([2, -4]))
