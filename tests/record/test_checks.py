"""Datasets check themselves, and each check sees what it is for."""

import dataclasses

import numpy as np
import pytest
import xarray as xr

from jaxcell.record import dataset as described
from jaxcell.record.chain_checks import patrol_map_checks


def dataset(variables, **attributes):
    """A dataset of small arrays, each with the names of its dimensions."""
    built = {name: (dims.split(), np.array(value)) for name, (dims, value) in variables.items()}
    return xr.Dataset(built, attrs={"title": "Small", "spec": "{}", **attributes})


def failing(found):
    return {name for name, (value, limit) in found.items() if not value <= limit}


def altered(data, name, value):
    """With another value of one variable."""
    return data.assign({name: data[name].copy(data=np.array(value, data[name].dtype))})


PATROL = dataset(
    {
        "attack_time": ("attack_time", [2, 1]),
        "capture": ("attack_time position", [[0.9, 1.0], [0.5, 1.0]]),
        "exact": ("attack_time", [0.9, 0.5]),
        "simulated": ("attack_time", [0.91, 0.5]),
        "law": ("step", [0.2, 0.3, 0.4]),
        "arrival": ("run", [1.0] * 100),
        "probability": ("robot branch position", [[[0.5, 1.0], [0.5, 0.0]]]),
        "mixture": ("share", [1.0]),
    }
)
# Cell 0 stays; 1 goes there, to itself, or off the grid; one square is land.
CHECKS = {
    "patrol map": (PATROL, patrol_map_checks),
}


@pytest.mark.parametrize("family", CHECKS)
def test_what_is_right_passes(family):
    data, found = CHECKS[family]
    kept = checks.with_checks(data, found(data)).attrs
    assert sum(name.startswith("check_") for name in kept) == len(found(data)) >= 4


@pytest.mark.parametrize(
    ("family", "variable", "value", "names"),
    [
        ("patrol map", "capture", [[0.4, 1.0], [0.5, 1.0]], {"capture_falls_with_time"}),
        ("patrol map", "capture", [[0.9, 1.1], [0.5, 1.1]], {"capture_beyond_0_to_1"}),
        ("patrol map", "exact", [0.9, 0.6], {"exact_is_of_law"}),
        ("patrol map", "law", [0.2, 0.3, 0.6], {"law_beyond_1", "exact_is_of_law"}),
        ("patrol map", "probability", [[[0.5, 1.0], [0.4, 0.0]]], {"rows_sum_to_1"}),
    ],
)
def test_what_is_wrong_is_seen(family, variable, value, names):
    data, found = CHECKS[family]
    wrong = altered(data, variable, value)
    fails = failing(found(wrong))
    assert all(any(one.startswith(name) for one in fails) for name in names), fails
    with pytest.raises(RuntimeError, match=r"Small: the result contradicts itself: \w+ is"):
        checks.with_checks(wrong, found(wrong))


@pytest.mark.parametrize(
    ("name", "index", "value", "check"),
    [
        ("group_basin", (0, 0), 1, "basins_minus_cells"),
        ("group_period", (0, 0), 1, "periodic_cells_minus_period"),
        ("group_transient", (0, 0), 99, "steps_that_no_cell_takes"),
        ("group", (0, 0, 0), 1, "image_violations"),
        ("longest_period", 0, 1, "numbers_not_those_of_cells"),
    ],
)
def test_groups_that_contradict_themselves(angles, name, index, value, check):
    found = dataclasses.replace(angles, bounce=angles.bounce.copy())
    assert not failing(found.checks())
    wrong = np.array(getattr(found, name))
    assert wrong[index] != value
    wrong[index] = value
    # Numbers of cells are kept by the result once they are computed.
    found.__dict__[name] = wrong
    assert check in failing(found.checks())
    with pytest.raises(RuntimeError, match="the result contradicts itself"):
        described(found)


@pytest.mark.parametrize(
    ("name", "index", "value", "check"),
    [
        ("uncertainty", 0, 151, "uncertainty_minus_members"),
        ("transition", (1, 0), 0, "states_that_gain_cells"),
    ],
)
def test_filters_that_contradict_themselves(lab, name, index, value, check):
    found = lab.localized(100)
    assert not failing(found.checks())
    wrong = np.array(getattr(found, name))
    wrong[index] = value
    found.__dict__[name] = wrong
    assert check in failing(found.checks())


def test_runs_that_contradict_their_filter(lab):
    found = lab.localized(100)
    states, candidates = found.run.states.copy(), found.run.candidates + 1
    states[1] = states[0]
    for name, value, check in (
        ("states", states, "run_off_the_transitions"),
        ("candidates", candidates, "candidates_not_of_the_last_state"),
    ):
        run = dataclasses.replace(found.run, **{name: value})
        assert check in failing(dataclasses.replace(found, run=run).checks())
    path = found.run.path.copy()
    path[-1] = 0
    lost = dataclasses.replace(found, run=dataclasses.replace(found.run, path=path))
    # That is possible, if the filter is of another map.
    assert not failing(lost.checks())
    assert lost.checks()["states_without_the_robot"][0] == 1
