import jax.numpy as jnp
import numpy as np
import pytest
from oracles.drifter import Current
from seas import sea, water_and_flow

from jaxcell import bundled, drift
from jaxcell.drift import Sampling
from jaxcell.drift.validation.distance import nearest_maps


@pytest.fixture(scope="module")
def eastward():
    """The water and the flow of a tenth of a cell a second to the East."""
    return water_and_flow(sea(np.full((4, 9), 100.0), np.zeros((4, 9)), np.ones((4, 9), bool)))


def four_eddies():
    rows, columns = (np.arange(24) + 0.5) * np.pi / 12 * np.ones((2, 24, 1))
    columns = columns.T
    east, north = np.sin(columns) * np.cos(rows), -np.cos(columns) * np.sin(rows)
    # In six hours they go by some seven cells.
    return sea(0.6 * east, 0.6 * north)


@pytest.fixture(scope="module")
def eddies():
    """The water and the flow of four eddies, which spread drifters nowhere."""
    return water_and_flow(four_eddies())


def test_an_exact_map_has_distance_0(eastward):
    water, flow = eastward
    step = 2 * drift.crossing_time(water, flow)
    chain = drift.drift_map(water, flow, drift.METHODS["drifters"].lasting(step))
    hours = 3600 / step
    # As slow as it must be for 6 and 24 h to be 1 and 4 steps.
    slow = drift.Flow(flow.rate / (6 * hours), flow.time, flow.wraps)
    (distance,) = drift.distances(water, slow, [(chain, 6 * 3600.0)])
    assert distance.hours.tolist() == [6, 24]
    np.testing.assert_allclose(distance.total_variation, 0, atol=1e-12)
    # Two of nine columns are left in every step.
    np.testing.assert_allclose(distance.drifters_left, [2 / 9, 8 / 9])
    np.testing.assert_allclose(distance.map_left, distance.drifters_left)


def test_a_closed_edge_holds_drifters_that_leave(eastward):
    water, flow = eastward
    step = 6 * 3600.0
    slow = drift.Flow(2 * flow.rate / (step * float(flow.rate.max())), flow.time, flow.wraps)
    chain = drift.drift_map(water, slow, drift.METHODS["source"].lasting(step))
    (distance,) = drift.distances(water, slow, [(chain, step)])
    np.testing.assert_allclose(distance.map_left, 0, atol=1e-12)
    np.testing.assert_allclose(distance.drifters_left, [2 / 9, 8 / 9])
    assert (distance.total_variation >= distance.drifters_left - 1e-12).all()


def test_times_are_whole_steps_and_at_least_one(eddies):
    water, flow = eddies
    seconds = 10 * 3600.0
    chain = drift.drift_map(water, flow, drift.METHODS["drifters"].lasting(seconds))
    (distance,) = drift.distances(water, flow, [(chain, seconds)], hours=(2, 6, 24, 96))
    assert distance.hours.tolist() == [10, 20, 100]
    assert distance.replay.hours.tolist() == [2, 6, 10, 20, 24, 96, 100]


def test_the_noise_is_the_distance_of_drifters_from_an_exact_map(eddies):
    water, flow = eddies
    seconds = drift.crossing_time(water, flow)
    chain = drift.drift_map(water, flow, drift.METHODS["drifters"].lasting(seconds))
    few, many = (
        drift.distances(water, flow, [(chain, seconds)], Sampling(most=most), hours=(96,))[0]
        for most in (3, 12)
    )
    exact = many.replay.share(many.hours[-1], water.cells)
    apart = np.abs(few.replay.share(few.hours[-1], water.cells) - exact).sum() / 2
    assert apart / 2 < few.noise[-1] < 2 * apart
    assert many.noise[-1] < few.noise[-1] < few.total_variation[-1]


def test_the_distance_of_a_cell_is_that_of_its_drifters(eddies):
    water, flow = eddies
    seconds = 4 * drift.crossing_time(water, flow)
    chain = drift.drift_map(water, flow, drift.METHODS["drifters"].lasting(seconds))
    (distance,) = drift.distances(water, flow, [(chain, seconds)], hours=(96,))
    apart, noise = drift.distances_by_cell(water, chain, seconds, distance)
    power = np.linalg.matrix_power(
        chain.to_scipy().toarray(), round(distance.hours[0] * 3600 / seconds)
    )
    part = 6 * (water.row // 4) + water.column // 4
    for cell in (0, 77, 300):
        end = distance.replay.cell[0][distance.replay.origin == cell]
        seen = np.bincount(part[end[end >= 0]], minlength=36) / end.size
        mapped = np.bincount(part, power[cell], 36)
        expected = (np.abs(seen - mapped).sum() + abs(seen.sum() - mapped.sum())) / 2
        assert apart[cell] == pytest.approx(expected, abs=1e-12)
    assert 0 < noise.mean() < apart.mean() < 1


def test_drifters_that_leave_in_a_long_step_do_not_come_back():
    # A part of an eddy, whose other half is off the map to the South.
    x, y = np.meshgrid(np.arange(21) - 10.0, np.arange(10) + 0.5)
    water, flow = water_and_flow(sea(-y * 0.02, x * 0.02))
    seconds = 1.8 * np.pi * 1000 / 0.02
    chain = drift.drift_map(water, flow, drift.METHODS["drifters"].lasting(seconds))
    (distance,) = drift.distances(water, flow, [(chain, seconds)], hours=(seconds / 3600,))
    assert distance.drifters_left[0] > 0.9
    assert distance.map_left[0] == pytest.approx(distance.drifters_left[0], abs=0.02)


def test_the_step_depends_on_the_time_that_is_asked():
    water, flow = water_and_flow(drift.open_currents(bundled("ocean/gyres.nc"), time=0, depths=0))
    options = drift.METHODS["drifters"]
    short, long = (drift.nearest_step([water], [flow], options, hours) for hours in (6, 48))
    assert short.duration <= 1.5 * 3600
    assert 2 * short.duration < long.duration <= 12 * 3600
    maps = [(drift.drift_maps(water, flow, step), step.duration) for step in (short, long)]
    by_short, by_long = drift.distances(water, flow, maps, hours=(48,))
    assert by_long.total_variation[-1] < 0.5 * by_short.total_variation[-1]


def test_the_distance_is_that_of_drifters_of_a_solver():
    current, (water, flow) = Current.of(four_eddies()), water_and_flow(four_eddies())
    step, cells = 7200.0, 24 * 24
    chain = drift.drift_map(water, flow, drift.METHODS["drifters"].lasting(step))
    (distance,) = drift.distances(water, flow, [(chain, step)])
    off = (np.arange(3) - 1) / 3
    row, column = np.array(current.squares).T[:, :, None, None]
    begin = np.broadcast_arrays(column + off, row + off[:, None])
    matrix = chain.to_scipy().toarray()
    for k, hours in enumerate((6, 24)):
        x, y, beyond = current.solved(*(one.ravel() for one in begin), 0.0, hours * 3600.0)
        row, column = (np.floor(place[beyond < 0] + 0.5).astype(int) for place in (y, x))
        seen = np.bincount(24 * row + column, minlength=cells) / x.size
        mapped = np.linalg.matrix_power(matrix, hours // 2).sum(axis=0) / cells
        assert distance.hours[k] == hours
        apart = (np.abs(seen - mapped).sum() + abs(seen.sum() - mapped.sum())) / 2
        assert distance.total_variation[k] == pytest.approx(apart, abs=0.03)
        assert distance.drifters_left[k] == pytest.approx(1 - seen.sum(), abs=0.003)


def test_few_drifters_per_cell_give_the_same_distance(eddies):
    water, flow = eddies
    step = 2 * drift.crossing_time(water, flow)
    maps = [(drift.drift_map(water, flow, drift.METHODS["drifters"].lasting(step)), step)]
    (many,) = drift.distances(water, flow, maps)
    (few,) = drift.distances(water, flow, maps, Sampling(drifters=water.cells))
    assert many.total_variation.max() < 0.1
    np.testing.assert_allclose(few.total_variation, many.total_variation, atol=0.05)


def test_the_step_is_the_nearest_of_those_up_to_a_quarter_of_the_time(eastward, monkeypatch):
    water, flow = eastward
    options = drift.METHODS["drifters"]
    # It flows across a cell in five hours on average, and turns every six hours.
    along = np.where(np.arange(9) % 2 == 0, 1.0, -0.5)[:, None, None, None]
    rate = jnp.asarray(np.asarray(flow.rate) * along * np.linspace(0.2, 1.8, 4)[:, None])
    tide = drift.Flow(rate, jnp.linspace(0.0, 48 * 3600.0, 9), flow.wraps)
    slow = drift.crossing_time(water, tide.mean()) / (5 * 3600)
    tide = drift.Flow(rate * slow, tide.time, flow.wraps)
    steps = [5 * 3600.0 * factor for factor in (1, 2, 4)]
    maps = [(drift.drift_map(water, tide.mean(), options.lasting(step)), step) for step in steps]
    compared = drift.distances(water, tide, maps, hours=(6, 24, 120))
    worst = [one.total_variation.max() for one in compared]
    duration = drift.nearest_step([water], [tide], options, 120).duration
    assert duration == pytest.approx(steps[int(np.argmin(worst))])
    monkeypatch.setattr("jaxcell.drift.validation.distance.MOST_CELLS", 0)
    step, made = nearest_maps([water], [tide], [tide.mean()], options)
    assert step.duration == pytest.approx(10 * 3600)
    assert made is None
