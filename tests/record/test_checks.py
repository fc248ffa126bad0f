"""Results check themselves, and each check sees what it is for."""

import dataclasses

import numpy as np
import pytest

from jaxcell.record import dataset as described


def failing(found):
    return {name for name, (value, limit) in found.items() if not value <= limit}


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
