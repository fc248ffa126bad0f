import math
from pathlib import Path

import jax
import numpy as np
import pytest
from hypothesis import given, strategies as st

from jaxcell import bounce, drift, optimize
from jaxcell.automata import minimize
from jaxcell.patrol.files.graph_files import load_graph
from jaxcell.space import ENDPOINT, CellSpace, Workspace
from jaxcell.space.maps.random_rooms import place, random_room
from jaxcell.sweep.tasks import TASKS
from jaxcell.sweep.workers.work import Job, compute, find_task, study_of


DATA = Path(__file__).parents[2] / "data"
LAB = str(DATA / "maps" / "lab_a.json")
LINE = str(DATA / "graphs" / "eight.json")
GYRES = str(DATA / "ocean" / "gyres.nc")
DRIFTERS = str(DATA / "ocean" / "drifters.nc")


WIDTH = """
import jax.numpy as jnp
import numpy as np
import xarray as xr

def width(batch, fixed, seed):
    bits = np.full(batch["a"].size, jnp.zeros(()).dtype.itemsize * 8)
    return xr.Dataset({"bits": ("member", bits)})
"""


@pytest.mark.parametrize("wide", [True, False])
def test_a_worker_computes_with_the_precision_of_the_driver(wide, tmp_path, monkeypatch):
    monkeypatch.setenv("JAX_ENABLE_X64", "")
    path = tmp_path / "own.py"
    path.write_text(WIDTH)
    before = jax.config.jax_enable_x64
    try:
        jax.config.update("jax_enable_x64", not wide)
        job = Job(0, np.arange(2), f"{path}:width", {"a": np.arange(2.0)}, {}, 0, wide)
        found = compute(job)
    finally:
        jax.config.update("jax_enable_x64", before)
    assert found.variables["bits"].values.tolist() == [64 if wide else 32] * 2


def task(name):
    return find_task(name)


def lab(**changes):
    workspace = Workspace.load(LAB)
    return CellSpace.of(workspace, workspace.cell, changes.get("directions", workspace.directions))


def test_groups_are_those_of_bounce_groups():
    bounces = np.array([45.0, 90.0, 135.0])
    found = task("groups")({"bounce": bounces}, {"map": LAB, "collision": "endpoint"}, 0)
    for i, angle in enumerate(np.radians(bounces)):
        expected = bounce.bounce_groups(lab(), float(angle), motion=ENDPOINT)
        period = np.asarray(expected.group_period)
        period = period[period > 0]
        assert found["count"][i] == int(expected.count) == period.size
        assert found.longest_transient[i] == int(expected.step.max())
        assert found.shortest_period[i] == period.min()
        assert found.longest_period[i] == period.max()
        assert found.periodic_cells[i] == int(np.sum(np.asarray(expected.periodic)))
        assert found.largest_basin[i] == np.bincount(np.asarray(expected.group)).max()
    assert found.longest_transient.attrs == {"long_name": "longest transient", "units": "mappings"}


def test_filters_are_those_of_the_dissertation():
    found = task("localize")(
        {"bounce": np.array([45.0, 135.0])}, {"map": LAB, "collision": "endpoint"}, 0
    )
    # Tables 2.1 and 2.2.
    assert found.nfa_states.values.tolist() == [153, 153]
    assert found.dfa_states.values.tolist() == [129, 124]
    assert found.knowledge_cycles.values.tolist()[0] == 3
    assert found.least_uncertainty.values.tolist() == [1, 1]
    assert found.largest_uncertainty.values.tolist() == [4, 2]
    filter = bounce.localization_filter(bounce.bounce_map(lab(), math.pi / 4, motion=ENDPOINT))
    assert found.minimal_states[0] == len(minimize(filter).transition)


def test_coverage_is_that_of_coverage_policy():
    batch = {"reliability": np.array([0.9, 0.6])}
    fixed = {"map": LAB, "bounces": [45, 135], "error": 45, "directions": 8}
    found = task("cover")(batch, fixed, 0)
    for i, reliability in enumerate(batch["reliability"]):
        bounces = np.radians([45.0, 135.0])
        policy = bounce.coverage_policy(lab(), bounces, math.pi / 4, float(reliability))
        assert found.distance[i] == pytest.approx(policy.distance)
        assert found.total_variation[i] == pytest.approx(policy.total_variation)
        assert found.positions_visited[i] == int((np.asarray(policy.mixture) > 0).sum())


def test_plans_are_those_of_all_plans():
    batch = {"change": np.array([1.0, 100.0])}
    found = task("plans")(batch, {"map": LAB, "bounces": [45, 135], "directions": 8}, 0)
    for i, change in enumerate((1, 100)):
        costs = bounce.all_plans(lab(), np.radians([45.0, 135.0]), 1, change).costs()
        known = costs[costs >= 0]
        assert found.reachable_pairs[i] == pytest.approx(known.size / costs.size)
        assert found.mean_cost[i] == pytest.approx(known.mean())
        assert found.largest_cost[i] == known.max()


def test_walks_are_those_of_minimum_commute():
    graph, names = load_graph(LINE)
    emphasis = [names[0], names[-1]]
    batch = {"share": np.array([0.3, 0.9])}
    found = task("patrol")(batch, {"file": LINE, "emphasis": emphasis}, 0)
    for i, share in enumerate(batch["share"]):
        stops = [0, len(names) - 1]
        expected = optimize.minimum_commute(graph, emphasis=stops, share=float(share))
        assert found.mean_commute_time[i] == pytest.approx(float(expected.commute_time), rel=1e-6)
    even = task("patrol")(batch, {"file": LINE}, 0)
    expected = optimize.minimum_commute(graph)
    np.testing.assert_allclose(even.mean_commute_time, float(expected.commute_time), rtol=1e-6)


def test_drift_is_that_of_group_counts():
    currents = drift.open_currents(GYRES)
    water, flow = drift.Water.of(currents, 0), drift.Flow.of(currents, 0).mean()
    batch = {"duration": np.array([3600.0, 14400.0])}
    found = task("drift")(batch, {"file": GYRES, "depths": 0, "rho": 0.8, "method": "source"}, 0)
    expected = drift.group_counts(water, flow, [drift.DriftStep(s) for s in (3600.0, 14400.0)])
    np.testing.assert_array_equal(found.persistent_groups, expected)
    assert found.step.values.tolist() == [3600, 14400]
    behaviour = drift.long_term_behaviour(
        drift.drift_map(water, flow, drift.DriftStep(3600.0, rho=0.8)), 3600.0
    )
    hours = np.asarray(behaviour.hours)
    assert found.longest_hours[0] == pytest.approx(hours[np.isfinite(hours)].max())


ROOMS = {"columns": 9, "rows": 7, "obstacles": 2, "directions": 24}


@given(
    st.lists(st.tuples(st.integers(0, 3), st.integers(0, 23)), min_size=1, max_size=8), st.data()
)
def test_rooms_do_not_depend_on_the_batch(pairs, data):
    def run(some):
        batch = {
            "room": np.array([r for r, _ in some]),
            "bounce": np.array([15 * a for _, a in some]),
        }
        return task("rooms")(batch, ROOMS, 7)

    whole = run(pairs)
    cut = data.draw(st.integers(1, len(pairs)))
    order = data.draw(st.permutations(range(len(pairs))))
    shuffled = [pairs[i] for i in order]
    parts = [run(some) for some in (shuffled[:cut], shuffled[cut:]) if some]
    for name in whole:
        together = np.concatenate([part[name].values for part in parts])
        np.testing.assert_array_equal(together, whole[name].values[order])


def test_rooms_are_the_rooms_of_their_numbers():
    found = task("rooms")({"room": np.array([0, 5])}, {**ROOMS, "bounce": 90}, 3)
    for i, number in enumerate((0, 5)):
        free = random_room(3, number, 9, 7, 2)
        cells = CellSpace.of_grid(free, 24)
        expected = bounce.bounce_groups(cells, math.pi / 2)
        assert found.positions[i] == free.sum()
        assert found["count"][i] == int(expected.count)
        assert found.longest_transient[i] == int(expected.step.max())
    environment = task("rooms")(
        {"room": np.array([2])}, {"environment": "E3", "bounce": 90, "directions": 4}, 0
    )
    assert environment.positions[0] == place(0, "E3", 2).free.sum()


def test_observed_drifters_give_one_number_per_member():
    batch, fixed = {"lag": np.array([5.0, 10.0])}, {"file": DRIFTERS, "cell": 3, "samples": 2}
    found = task("drifters")(batch, fixed, 0)
    assert found.cells.values.tolist() == [40, 40]
    assert found.moves.values[1] < found.moves.values[0] == 3722
    assert found.drifters.values.tolist() == [200, 200]
    assert found.observations.values.tolist() == [3922, 3922]
    # Quantities with several numbers per member are left to `jaxcell drifters`.
    assert "estimates_value" not in found


@pytest.mark.parametrize("name", sorted(TASKS))
def test_parameters_are_refused_by_name(name):
    needed = {
        "groups": {"map": LAB, "bounce": 90},
        "rooms": {"bounce": 90},
        "localize": {"map": LAB, "bounce": 90},
        "cover": {"map": LAB, "bounces": [90], "error": 0, "reliability": 1},
        "plans": {"map": LAB, "bounces": [90]},
        "patrol": {"file": LINE},
        "drift": {"file": GYRES},
        "drifters": {"file": DRIFTERS},
        "dynamics": {"system": "henon"},
        "morse": {"system": "henon"},
    }[name]
    swept, bad = {
        "rooms": ("room", -1),
        "patrol": ("share", 1.5),
        "drift": ("rho", 1.5),
        "drifters": ("lag", 0.0),
        "dynamics": ("follow", -1),
        "morse": ("depth", -1),
    }.get(name, ("cell", 0.0))
    called = study_of(name).__name__ if study_of(name) else f"'{name}'"
    with pytest.raises(ValueError, match=f"colour: expected a parameter of {called}, one of"):
        task(name)({swept: np.array([1])}, {**needed, "colour": 1}, 0)
    with pytest.raises(ValueError, match=f"{swept}: expected .*, got {bad:g}"):
        task(name)({swept: np.array([bad])}, needed, 0)
    for missing in needed:
        rest = {key: value for key, value in needed.items() if key != missing}
        # A filter is of one angle or of several, and neither parameter is needed by itself.
        either = (name, missing) == ("localize", "bounce")
        needs = f"{missing}: {called} needs this"
        message = "expected one of `bounce` or `bounces`" if either else needs
        with pytest.raises(ValueError, match=message):
            task(name)({swept: np.array([1])}, rest, 0)


def test_drawing_rooms_that_cannot_be_connected_ends():
    with pytest.raises(
        ValueError, match=r"obstacles: 60 obstacles leave .* in several pieces; expected fewer"
    ):
        random_room(0, 0, 4, 1, 60)
