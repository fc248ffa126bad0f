"""Datasets check themselves, and each check sees what it is for."""

import json

import numpy as np
import pytest
import xarray as xr

from jaxcell.record import checks
from jaxcell.record.chain_checks import drift_checks, patrol_graph_checks


def dataset(variables, **attributes):
    """A dataset of small arrays, each with the names of its dimensions."""
    built = {name: (dims.split(), np.array(value)) for name, (dims, value) in variables.items()}
    return xr.Dataset(built, attrs={"title": "Small", "spec": "{}", **attributes})


def failing(found):
    return {name for name, (value, limit) in found.items() if not value <= limit}


def altered(data, name, value):
    """With another value of one variable."""
    return data.assign({name: data[name].copy(data=np.array(value, data[name].dtype))})


# Cells 0 and 1 change places, 2 comes to 1, and 3 stays.
IMAGE = np.array([1, 0, 1, 3])
GROUPS = dataset(
    {
        "bounce": ("", 0.5),
        "group": ("direction position", [[0, 0], [0, 1]]),
        "step": ("direction position", [[0, 0], [1, 0]]),
        "group_period": ("group_index", [2, 1]),
        "group_basin": ("group_index", [3, 1]),
        "group_transient": ("group_index", [1, 0]),
        "groups": ("", 2),
    }
)
# Seven cells; the robot in cell 4 moves, and bumps.
FILTER = {
    "transition": ("state observation", [[1, 2], [-1, 2], [2, -1]]),
    "uncertainty": ("state", [3, 2, 1]),
    "offset": ("state_bound", [0, 3, 5, 6]),
    "member": ("entry", [1, 4, 6, 2, 5, 3]),
}
LOCALIZATION = dataset(
    {
        **FILTER,
        "visited": ("time", [0, 1, 2]),
        "sensed": ("move", [0, 1]),
        "cell": ("time", [4, 5, 3]),
        "candidate": ("candidates", [3]),
    }
)
# Three positions in a row, East and West: one step and a turn.
PLAN = dataset(
    {
        "start": ("", 1),
        "goal": ("", 5),
        "cost": ("", 2),
        "cell": ("time", [1, 2, 5]),
        "action": ("move", [0, np.pi]),
        "reaches": ("direction position", [[True] * 3, [True] * 3]),
    },
    spec=json.dumps({"keep": 1, "change": 100}),
)
# Three positions, East and West; robot 0 goes on, robot 1 bumps, and then robot 1 is turned.
TEAM = dataset(
    {
        "cell": ("time robot", [[0, 2], [1, 5], [1, 2]]),
        "bumped": ("move robot", [[False, True], [False, False]]),
        "part_begin": ("part", [0, 2]),
        "covered": ("time", [2, 3, 3]),
    }
)
WALK = dataset(
    {
        "transition": ("start target", [[0.5, 0.5], [1.0, 0.0]]),
        "stationary": ("vertex", [2 / 3, 1 / 3]),
        "hitting_time": ("start target", [[0.0, 2.0], [1.0, 0.0]]),
        "commute_time": ("start target", [[0.0, 3.0], [3.0, 0.0]]),
        "mixture": ("strategy", [0.5, 0.5]),
    }
)
# Cell 0 stays; 1 goes there, to itself, or off the grid; one square is land.
DRIFT = dataset(
    {
        "cell": ("layer y x", [[[0, 1, -2]]]),
        "group": ("layer y x", [[[0, -1, -2]]]),
        "absorption_time": ("layer y x", [[[0.0, 2.0, np.nan]]]),
        "leaving": ("layer y x", [[[0.0, 0.5, np.nan]]]),
        "probability": ("layer group_index y x", [[[[1.0, 0.5, np.nan]]]]),
        "arrival_probability": ("layer y x", [[[1.0, 0.5, np.nan]]]),
        "from_cell": ("entry", [0, 1, 1]),
        "to_cell": ("entry", [0, 0, 1]),
        "transition": ("entry", [1.0, 0.25, 0.5]),
    },
    step_seconds=3600.0,
)
CHECKS = {
    "groups": (GROUPS, lambda data: checks.groups_checks(data, IMAGE)),
    "localization": (LOCALIZATION, checks.localization_checks),
    "navigation": (PLAN, checks.navigation_checks),
    "team": (TEAM, lambda data: checks.team_checks(data, 2, 3)),
    "patrol graph": (WALK, patrol_graph_checks),
    "drift": (DRIFT, drift_checks),
}


@pytest.mark.parametrize("family", CHECKS)
def test_what_is_right_passes(family):
    data, found = CHECKS[family]
    kept = checks.with_checks(data, found(data)).attrs
    assert sum(name.startswith("check_") for name in kept) == len(found(data)) >= 4


@pytest.mark.parametrize(
    ("family", "variable", "value", "names"),
    [
        ("groups", "group_basin", [4, 1], {"basins_minus_cells"}),
        ("groups", "group_period", [1, 1], {"periodic_cells_minus_period"}),
        ("groups", "group_transient", [2, 0], {"steps_that_no_cell_takes"}),
        ("groups", "group", [[0, 1], [0, 0]], {"image_violations"}),
        ("localization", "uncertainty", [3, 1, 1], {"uncertainty_minus_members"}),
        ("localization", "transition", [[1, 1], [-1, 2], [2, -1]], {"states_that_gain_cells"}),
        ("localization", "visited", [0, 2, 2], {"run_off_the_transitions"}),
        ("localization", "candidate", [4], {"candidates_not_of_the_last_state"}),
        ("navigation", "cell", [1, 0, 5], {"actions_that_lead_elsewhere"}),
        ("navigation", "action", [0, np.pi / 2], {"actions_that_lead_elsewhere"}),
        ("navigation", "goal", 4, {"ends_missed"}),
        ("navigation", "reaches", [[True] * 3, [False] * 3], {"cells_that_do_not_reach"}),
        ("navigation", "cost", 101, {"cost_minus_that_of_actions"}),
        ("team", "cell", [[0, 2], [2, 5], [2, 2]], {"shared_positions"}),
        ("team", "cell", [[0, 2], [1, 5], [1, 5]], {"parts_that_begin_otherwise"}),
        ("team", "bumped", [[True, True], [False, False]], {"moves_against_the_rule"}),
        ("team", "covered", [2, 2, 3], {"covered_minus_visited"}),
        ("patrol graph", "transition", [[0.5, 0.4], [1.0, 0.0]], {"rows_sum_to_1"}),
        ("patrol graph", "stationary", [0.5, 0.5], {"stationarity_residual"}),
        ("patrol graph", "hitting_time", [[0, 2.1], [0.9, 0]], {"hitting_time_residual"}),
        ("patrol graph", "commute_time", [[0, 3], [4, 0]], {"commute_is_there_and_back"}),
        ("patrol graph", "mixture", [0.5, 0.6], {"mixture_sums_to_1"}),
        ("drift", "transition", [1.0, 0.6, 0.5], {"rows_sum_to_more_than_1"}),
        ("drift", "transition", [0.9, 0.25, 0.5], {"ways_out_of_persistent_groups"}),
        ("drift", "to_cell", [1, 0, 1], {"ways_out_of_persistent_groups"}),
        ("drift", "leaving", [[[0.0, 0.4, np.nan]]], {"ends_sum_to_1"}),
        ("drift", "probability", [[[[1.0, 0.6, np.nan]]]], {"ends_residual"}),
        ("drift", "arrival_probability", [[[1.0, 1.5, np.nan]]], {"arrival_beyond_0_to_1"}),
    ],
)
def test_what_is_wrong_is_seen(family, variable, value, names):
    data, found = CHECKS[family]
    wrong = altered(data, variable, value)
    fails = failing(found(wrong))
    assert all(any(one.startswith(name) for one in fails) for name in names), fails
    with pytest.raises(RuntimeError, match=r"Small: the result contradicts itself: \w+ is"):
        checks.with_checks(wrong, found(wrong))


def test_what_is_only_told_refuses_nothing():
    wrong = altered(DRIFT, "absorption_time", [[[0.0, 9.0, np.nan]]])
    assert checks.with_checks(wrong, drift_checks(wrong)).attrs[
        "check_absorption_time_residual"
    ] == pytest.approx(3.5 / 9)
    lost = altered(LOCALIZATION, "cell", [0, 5, 3])
    assert checks.localization_checks(lost)["states_without_the_robot"][0] == 1


def test_that_none_leaves_may_be_all_that_is_known_of_ends():
    unknown = DRIFT.assign(
        probability=np.nan * DRIFT.probability,
        leaving=(("layer", "y", "x"), [[[0.0, 0.0, np.nan]]]),
    )
    found = drift_checks(unknown)
    assert found["ends_sum_to_1"][0] == 0
    # Where all leave, no group has a part of them.
    gone = unknown.assign(leaving=(("layer", "y", "x"), [[[0.0, 1.0, np.nan]]]))
    assert drift_checks(gone)["ends_sum_to_1"][0] == 0
