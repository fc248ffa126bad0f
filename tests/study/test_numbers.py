"""Numbers of many studies at once are those of each alone."""

import dataclasses

import numpy as np
import pytest

from jaxcell import bundled
from jaxcell.study import Groups, Rooms
from jaxcell.sweep.study_task import study_task


def alone(study, columns):
    """The numbers of each study, which runs by itself with one value of each parameter."""
    rows = zip(*(column.tolist() for column in columns.values()), strict=True)
    members = (dict(zip(columns, row, strict=True)) for row in rows)
    several = ({k: (v,) if k == "bounce" else v for k, v in one.items()} for one in members)
    return [dataclasses.replace(study, **one).run() for one in several]


SMALL = Rooms(room=0, bounce=(45.0,), columns=9, rows=7, obstacles=2, directions=8)


@pytest.mark.parametrize(
    "columns",
    [
        {"room": np.repeat(np.arange(5), 3), "bounce": np.tile([45.0, 90.0, 315.0], 5)},
        # Each room has an angle of its own.
        {"room": np.array([3, 1, 2, 1]), "bounce": np.array([90.0, 45.0, 135.0, 45.0])},
        {"room": np.array([4, 4, 0])},
    ],
    ids=["product", "scattered", "one_angle"],
)
def test_rooms(columns):
    numbers = SMALL.numbers(columns)
    assert set(numbers) >= {"count", "longest_period", "filter_states", "positions"}
    for i, result in enumerate(alone(SMALL, columns)):
        for name, (_, column) in numbers.items():
            assert column[i] == np.ravel(getattr(result, name))[0]


def test_groups():
    study = Groups(map=bundled("lab_a"), bounce=(0.0,))
    columns = {"bounce": np.array([90.0, 45.0, 90.0])}
    numbers = study.numbers(columns)
    for i, result in enumerate(alone(study, columns)):
        assert {name: column[i] for name, (_, column) in numbers.items()} == {
            name: getattr(result, name)[0] for name in numbers
        }


def test_only_wanted_numbers_are_computed(monkeypatch):
    monkeypatch.setattr("jaxcell.bounce.group_results.heading_filter_sizes", None)
    batch = {"room": np.arange(3)}
    fixed = {"bounce": 45, "columns": 9, "rows": 7, "directions": 8}
    table = study_task(Rooms, batch, fixed, 0, ["longest_period", "count"])
    assert set(table) == {"longest_period", "count"}
    with pytest.raises(ValueError, match="results: Rooms has no number 'kemeny'"):
        study_task(Rooms, batch, fixed, 0, ["kemeny"])


def test_each_value_of_a_column_is_within_its_limits():
    with pytest.raises(ValueError, match="room: expected at least 0, got -2"):
        study_task(Rooms, {"room": np.array([1, -2, 3])}, {"bounce": 45}, 0)
    with pytest.raises(ValueError, match="bounce: expected one value for each member, got 2"):
        study_task(Rooms, {"room": np.arange(2)}, {"bounce": [45, 90]}, 0)
