"""Currents that change from record to record, and repeat themselves after the last."""

import dataclasses
import itertools

import jax
import numpy as np
import pytest
import xarray as xr
from seas import sea, water_and_flow

from jaxcell import bundled, drift, study, verify
from jaxcell.drift.flow import in_squares
from jaxcell.drift.validation.replay import Sampling
from jaxcell.examples import water
from jaxcell.mapping import Chain, ChainSequence


HOUR = 3600.0
STEP = 3 * HOUR


def strait(rows=5, columns=8):
    """Water that goes two cells there and back in a tide of twelve hours, and half a cell on."""
    along = (np.array([0, 2000, 0, -2000]) + 125) / STEP
    east = np.broadcast_to(along[:, None, None], (4, rows, columns))
    return sea(east, 0 * east, hours=3.0)


@pytest.fixture(scope="module")
def both():
    """The results with the tide, and by the mean of the records."""
    step = drift.METHODS["drifters"].lasting(STEP)
    return [drift.SeaDrift.of(strait(), step, mean=mean) for mean in (False, True)]


def test_a_periodic_current_interpolates_from_its_last_record_to_its_first():
    flow = drift.Flow.of(strait()).repeated()
    assert float(flow.period) == 4 * STEP

    def at(records):
        return float(in_squares(flow, records * STEP)[0, 21])

    for records in (0.0, 1.25, 3.5, -0.5):
        assert at(records + 8) == pytest.approx(at(records), abs=1e-15)
    assert at(3.25) == pytest.approx(0.75 * at(3) + 0.25 * at(0))
    np.testing.assert_allclose(flow.mean().rate, drift.Flow.of(strait()).mean().rate)
    fitted = [flow.fitted(records * STEP) / STEP for records in (0.9, 1.5, 3.9, 7)]
    assert fitted == pytest.approx([1, 4 / 3, 4, 8])


def test_maps_with_the_tide_are_nearer_to_drifters_than_the_mean(both):
    tide, mean = both
    assert (tide.phases, tide.period_hours) == (4, 12.0)
    assert (mean.phases, mean.period_hours) == (None, None)
    assert tide.compared_hours[0] == mean.compared_hours[0] == 6
    assert 3 * tide.distance_by_time[0] < mean.distance_by_time[0]
    assert mean.distance_by_time[0] > 0.2
    # The same drifters.
    left = [one.compared_drifters_left[0, 0] for one in both]
    assert left[0] == pytest.approx(left[1], abs=0.02)
    assert tide.deployment.gained.sum() == tide.cells


def test_answers_for_cells_are_of_release_at_the_first_record(both):
    (layer,) = both[0].layers
    chain = layer.behaviour.chain
    period = np.eye(chain.cells)
    for k in range(chain.phases):
        period = period @ chain.at(k).to_scipy().toarray()
    assert layer.behaviour.unrolled.cells == 4 * layer.cells
    # The products of whole periods have all that leaves.
    gone = 1 - period.sum(axis=1)
    chance = np.linalg.solve(np.eye(chain.cells) - period, gone)
    np.testing.assert_allclose(layer.leaving, chance, atol=1e-9)
    assert layer.group.shape == (layer.cells,)
    assert sum(layer.transients_cells) + sum(layer.groups_cells) == layer.cells
    assert all(value <= limit for value, limit in layer.checks().values())


@pytest.fixture(scope="module", params=[4, 6, 10])
def shifting(request):
    """Maps of 14 cells that few drifters leave at a time, and the cells visited from phase 0."""
    random = np.random.default_rng(request.param)
    matrices = []
    for _ in range(3):
        matrix = np.eye(14)
        for cell in random.integers(0, 14, 4):
            matrix[cell] *= 0.5
            matrix[cell, random.integers(0, 14)] += 0.5
        matrices.append(matrix)
    here = np.eye(14, dtype=bool)
    visits = here
    for n in range(90):
        here = here @ matrices[n % 3] > 0
        visits = visits | here
    return ChainSequence.of([Chain.from_scipy(one) for one in matrices]), visits


def test_the_coverage_curve_counts_cells_at_any_phase(shifting):
    chain, visits = shifting
    curve = drift.coverage_curve(chain)
    assert 1 < curve.cells.size < 14
    for k, covered in enumerate(curve.covered):
        before = visits[curve.cells[:k]].any(axis=0)
        assert covered == (before | visits[curve.cells[k]]).sum()
        assert covered == max((before | one).sum() for one in visits)
    assert curve.covered[-1] == 14


def test_a_deployment_takes_cells_to_which_no_taken_cell_leads(shifting):
    chain, visits = shifting
    behaviour = drift.long_term_behaviour(chain, 60.0)
    deployment = drift.deployment_cells(behaviour)
    number = np.asarray(behaviour.transient.group).reshape(3, 14)
    assert visits[deployment.cells].any(axis=0).all()
    assert deployment.gained.sum() == 14
    part, time = number[0], np.asarray(behaviour.begins.absorption.value)
    # By the definition, with the states that are visited within the part.
    edges = chain.to_scipy().toarray() > 0
    flat = number.ravel()
    inside = edges & (flat[:, None] == flat)
    reach = np.linalg.matrix_power(np.eye(42) + inside, 42) > 0
    taken = []
    for cell in sorted(np.flatnonzero(part >= 0), key=lambda z: (part[z], -time[z].round(9), z)):
        led = [reach[z, np.arange(3) * 14 + cell] & (number[:, cell] == part[cell]) for z in taken]
        if not np.any(led):
            taken.append(cell)
    assert deployment.cells[deployment.group < 0].tolist() == taken
    assert len(taken) > 1


@pytest.fixture(scope="module")
def tidal_sea():
    """Two layers of nine cells, and their matrices at three phases; the sea of them."""
    random = np.random.default_rng(6)
    waters = [water(np.ones((1, 9), bool), depth) for depth in (0.0, 5.0)]
    matrices = np.zeros((2, 3, 9, 9))
    for layer, phase, cell in np.ndindex(2, 3, 9):
        to = np.clip(cell + random.integers(-2, 3, 2), 0, 8)
        np.add.at(matrices[layer, phase, cell], to, [0.7, 0.3 if cell else 0.1])
    tides = [ChainSequence.of([Chain.from_scipy(m) for m in layer]) for layer in matrices]
    return matrices, drift.Sea.of(waters, tides)


def moves(matrices):
    """The matrices of the actions drift, up and down, at each phase, over both layers."""
    nothing, same = np.zeros((9, 9)), np.eye(9)
    for above, below in zip(*matrices, strict=True):
        yield [
            np.block([[above, nothing], [nothing, below]]),
            np.block([[nothing, nothing], [same, nothing]]),
            np.block([[nothing, same], [nothing, nothing]]),
        ]


def test_a_voyage_decides_by_the_phase_of_the_tide(tidal_sea):
    matrices, sea = tidal_sea
    goal, discount = 4, 0.9
    allowed = np.array([np.ones(18, bool), np.arange(18) >= 9, np.arange(18) < 9])
    actions = [np.stack(one) for one in moves(matrices)]
    value, arrives = np.zeros((3, 18)), np.zeros((3, 18))
    for _, phase in itertools.product(range(300), (2, 1, 0)):
        P, later = actions[phase], (phase + 1) % 3
        lost = 1 - P.sum(axis=2)
        reward = 101 * P[:, :, goal] - 1 - lost * discount / (1 - discount)
        gains = discount * (reward + P @ np.where(np.arange(18) == goal, 0, value[later]))
        value[phase] = np.where(
            np.arange(18) == goal, 0, np.where(allowed, gains, -1e9).max(axis=0)
        )
        ahead = np.where(np.arange(18) == goal, 1, arrives[later])
        arrives[phase] = np.where(allowed, P @ ahead, -1).max(axis=0)
    arrives[:, goal] = 1
    voyage = drift.discounted_voyage(sea, goal, discount)
    np.testing.assert_allclose(voyage.value, value[0], atol=1e-6)
    assert voyage.actions.shape == (3, 18)
    assert (np.asarray(voyage.actions) != np.asarray(voyage.action)).any()
    surest = drift.surest_voyage(sea, goal)
    np.testing.assert_allclose(surest.probability, arrives[0], atol=1e-9)
    tracks = drift.simulate_voyages(jax.random.key(0), surest, 0, drifters=4000, steps=200)
    assert float(tracks.arrived.mean()) == pytest.approx(float(arrives[0, 0]), abs=0.03)
    assert int(tracks.cell.max()) < 18


def test_reached_cells_are_reached_at_some_phase(tidal_sea):
    matrices, sea = tidal_sea
    steps = list(moves(matrices))
    for arrivals, actions in (
        (drift.reachable_by_layer(sea, 3), [0]),
        (drift.reachable_at_depth(sea, 3), [0, 1, 2]),
    ):
        here = np.zeros(18, bool)
        here[[3, 12] if actions == [0] else [3]] = True
        met = here.copy()
        for n in range(200):
            here = (here @ sum(steps[n % 3][one] for one in actions)) > 0
            met |= here
        np.testing.assert_array_equal(arrivals, met)


def test_too_many_phases_are_refused_unless_requested(monkeypatch):
    step = drift.METHODS["drifters"].lasting(STEP)
    monkeypatch.setattr(drift.SeaDrift, "largest", 100)
    with pytest.raises(ValueError, match=r"160 cells at its 4 phases, and above 100 .*mean=True"):
        drift.SeaDrift.of(strait(), step)
    assert drift.SeaDrift.of(strait(), step, mean=True).phases is None
    assert drift.SeaDrift.of(strait(), step, mean=False).phases == 4
    monkeypatch.setattr("jaxcell.space.estimates.drift", lambda cells: 1e15 if cells else 0)
    with pytest.raises(MemoryError, match=r"160 cells at its 4 phases; that needs .*mean=True"):
        drift.SeaDrift.of(strait(), step, mean=False)


def test_a_step_is_changed_to_fit_the_period():
    sea = drift.SeaDrift.of(strait(), drift.METHODS["drifters"].lasting(1.2 * STEP))
    assert sea.step == pytest.approx(4 * STEP / 3)
    assert sea.remarks[0].startswith("A step takes 14400 s in place of 12960 s, to fit the 12 h")


def test_drifters_begin_in_separate_parts_of_a_large_sea():
    water, flow = water_and_flow(strait(rows=6, columns=12).isel(time=slice(1)))
    chain = drift.drift_map(water, flow, drift.METHODS["drifters"].lasting(STEP))
    sampling = Sampling(drifters=400, part=3)
    (distance,) = drift.distances(water, flow, [(chain, STEP)], sampling)
    assert distance.cells == 36
    assert distance.total_variation.max() < 0.4
    (distance,) = drift.distances(water, flow, [(chain, STEP)])
    assert distance.cells == 72


def test_verification_agrees_on_a_tide(both):
    sea = dataclasses.replace(both[0], start=0).towards(30)
    assert all(one.agrees in (True, None) for one in verify.compare_drift(sea))


def test_the_mean_of_the_records_is_read_one_by_one(tmp_path, monkeypatch):
    with xr.open_dataset(bundled("ocean/gyres.nc"), decode_times=False) as whole:
        part = whole.isel(time=slice(5)).load()
    name = next(name for name in part if "time" in part[name].dims)
    # A cell with two gaps in five is no water, one with a single gap is.
    at = {part[name].dims[-2]: 10}
    part[name][at | {"time": [1, 3], part[name].dims[-1]: 14}] = np.nan
    part[name][at | {"time": 3, part[name].dims[-1]: 12}] = np.nan
    part.to_netcdf(tmp_path / "gap.nc")
    every = drift.open_currents(tmp_path / "gap.nc", depths=0)
    mean = drift.open_currents(tmp_path / "gap.nc", depths=0, mean=True)
    assert int(every.water.sum()) == 537
    assert mean.sizes["time"] == 1
    assert (mean.attrs["mean_of"], every.attrs["mean_of"]) == (5, 1)
    assert mean.time.values[0] == every.time.values[0]
    np.testing.assert_array_equal(mean.water, every.water)
    for component in "uv":
        there = every[component].copy()
        there[{"time": 3, "y": 10, "x": 12}] = np.nan
        wanted = there.mean("time").where(every.water)
        np.testing.assert_allclose(mean[component][0], wanted, rtol=0, atol=1e-15)
    # A file that does not fit is read as its mean if that is requested.
    monkeypatch.setattr("jaxcell.currents.netcdf.LARGEST_BYTES", 30_000)
    request = study.Drift(file=(tmp_path / "gap.nc",), depths=(0.0,))
    with pytest.raises(ValueError, match=r"GiB at most; .* or --current steady"):
        request.currents()
    steady = dataclasses.replace(request, current="steady")
    read = steady.currents()
    assert steady.spec(steady.run())["current"] == "steady"
    assert read.attrs["mean_of"] == 5
    assert "the mean of 5 records" in read.attrs["notes"]
    with pytest.raises(ValueError, match="GiB at most"):
        drift.open_currents(tmp_path / "gap.nc", depths=0)
