"""Positions, lists in rows, single parts and several parts, in every view of a result."""

import dataclasses
from typing import Annotated, ClassVar

import numpy as np
import pytest

from jaxcell.base.quantities import Result, derived, quantity
from jaxcell.cli.terminal import show
from jaxcell.record import dataset, summary
from jaxcell.record.canvas.prose import described, numbers, table
from jaxcell.space import CellSpace


@dataclasses.dataclass(frozen=True, eq=False)
class Guard(Result):
    tables: ClassVar = {"guard": "guards"}

    post: Annotated[np.ndarray, quantity("guard", "post", kind="place")]
    seen: Annotated[np.ndarray, quantity("guard look", "seen", kind="index", listed=True)]
    late: Annotated[float, quantity("", "how late it is", "s")]

    @derived("guard", "guard", kind="coordinate")
    def guard(self):
        return np.arange(self.post.size)

    def checks(self):
        return {"late": (self.late, 5.0)}


@dataclasses.dataclass(frozen=True, eq=False)
class Watch(Result):
    title: ClassVar = "A watch"

    cells: CellSpace
    gate: Annotated[int, quantity("", "gate", kind="place")]
    night: Guard


@pytest.fixture
def watch():
    cells = CellSpace.of_grid(np.ones((1, 3), bool), 8)
    seen = np.array([[0, 1], [2, -1]])
    return Watch(cells, 2, Guard(np.array([1, -1]), seen, 3.0))


def test_summaries_say_where_positions_are(watch):
    data = summary(watch)
    assert data["gate"] == {"cell": 2, "x": 2.5, "y": 0.5}
    assert data["night"] == {
        "late": 3.0,
        "guards": [
            {"guard": 0, "post": {"cell": 1, "x": 1.5, "y": 0.5}, "seen": [0, 1]},
            {"guard": 1, "post": None, "seen": [2]},
        ],
    }


def test_zeros_have_no_sign():
    @dataclasses.dataclass(frozen=True, eq=False)
    class Clock(Result):
        late: Annotated[float, quantity("", "how late it is", "s", kind="time")]
        off: Annotated[np.ndarray, quantity("day", "how far it is off", "s", listed=True)]

        def checks(self):
            return {"late": (-self.late, 0.0)}

    off = np.array([-0.0, 0.0, -1.0])
    for clock in (Clock(-0.0, off), Clock(0.0, off)):
        data = dataset(clock)
        checks = (data.attrs["check_late"], data.attrs["check_late_below_0"])
        assert str([*checks, data.late.item()]) == "[0.0, 0.0, 0.0]"
        assert str(data.off.values.tolist()) == "[0.0, 0.0, -1.0]"
        assert str(summary(clock)) == "{'late': 0.0, 'off': [0.0, 0.0, -1.0]}"
    assert np.signbit(off[0])


def test_tables_say_where_positions_are(watch, capsys):
    show(watch, "The watch")
    out = capsys.readouterr().out
    assert "(2.5 m, 0.5 m)" in out
    assert "(1.5 m, 0.5 m)" in out
    assert "none" in out


def test_parts_have_variables_and_checks_of_their_own(watch):
    data = dataset(watch)
    assert data.night_post.values.tolist() == [1, -1]
    assert data.guard.values.tolist() == [0, 1]
    assert data.attrs["check_night_late"] == 3.0
    late = dataclasses.replace(watch.night, late=6.0)
    with pytest.raises(RuntimeError, match="night_late is 6, expected at most 5"):
        dataset(dataclasses.replace(watch, night=late))
    lost = dataclasses.replace(watch.night, post=np.array([1, -2]))
    with pytest.raises(RuntimeError, match="night_post_below_minus_1"):
        dataset(dataclasses.replace(watch, night=lost))


@dataclasses.dataclass(frozen=True, eq=False)
class Floor(Result):
    tables: ClassVar = {"room": "rooms"}

    height: Annotated[float, quantity("", "height of the floor", "m")]
    rooms_area: Annotated[np.ndarray, quantity("room", "area", "m2")]
    lit: Annotated[float, quantity("", "share that is lit", kind="share", padding="NaN: not known")]
    cools: Annotated[float | None, quantity("", "time until it is cold", "s", kind="time")] = None


@dataclasses.dataclass(frozen=True, eq=False)
class House(Result):
    title: ClassVar = "A house"

    floors: tuple[Floor, ...]

    @derived("floor", "rooms of each floor", kind="count")
    def rooms(self):
        raise AssertionError("a derived quantity is computed although it is not used")


HOUSE = House((Floor(0.0, np.array([9.0, 4.0]), 0.5), Floor(2.5, np.arange(1.0, 41), float("nan"))))


def test_the_summary_lists_several_parts():
    first, second = summary(HOUSE)["floors"]
    assert first == {"height": 0.0, "lit": 0.5, "rooms": [{"area": 9.0}, {"area": 4.0}]}
    assert second["lit"] is None


def test_the_dataset_has_single_numbers_of_parts_along_a_dimension():
    kept = dataclasses.replace(HOUSE)
    kept.__dict__["rooms"] = np.array([2, 40])
    data = dataset(kept)
    assert data.floor_height.dims == ("floor",)
    assert data.floor_height.values.tolist() == [0, 2.5]
    assert data.floor_height.attrs["long_name"] == "height of the floor"
    assert "floor_rooms_area" not in data
    # An unknown share, NaN, passes the check.
    assert np.isnan(data.floor_lit[1])
    bright = dataclasses.replace(HOUSE.floors[0], lit=1.5)
    wrong = dataclasses.replace(kept, floors=(HOUSE.floors[0], bright))
    wrong.__dict__["rooms"] = np.array([2, 2])
    with pytest.raises(RuntimeError, match="floor_lit_out_of_0_to_1"):
        dataset(wrong)


def test_the_terminal_has_a_column_for_each_part(capsys):
    show(HOUSE, "house")
    out = " ".join(capsys.readouterr().out.split())
    assert "│ height of the floor │ 0 m │ 2.5 m │" in out
    assert "Floor 1: rooms" in out
    assert "and 10 more" in out


def test_texts_have_meanings_and_units_of_single_numbers(watch):
    assert numbers(watch).splitlines()[2:] == ["| gate | (2.5 m, 0.5 m) |"]
    first, _ = HOUSE.floors
    lines = numbers(dataclasses.replace(first, cools=np.inf)).splitlines()
    assert lines[2:-1] == ["| height of the floor | 0 m |", "| share that is lit | 50 % |"]
    assert lines[-1] == "| time until it is cold | never |"
    assert "cold" not in numbers(first)


def test_texts_have_a_row_for_each_place_along_a_dimension_or_for_each_result():
    first, second = HOUSE.floors
    rows = described(first, "rooms_area", first={"room": ["left", "right"]}).splitlines()
    assert rows[0] == "| room | area |"
    assert rows[2:] == ["| left | 9 m2 |", "| right | 4 m2 |"]
    cold = dataclasses.replace(first, cools=3.0)
    rows = described([cold, second], "height", "cools").splitlines()
    assert rows[2:] == ["| 0 m | 3 s |", "| 2.5 m |  |"]


def test_long_tables_say_how_many_rows_are_missing():
    rows = table(("a", "b"), [(i, "x|y") for i in range(5)], most=2).splitlines()
    assert rows[2:] == ["| 0 | x&#124;y |", "| 1 | x&#124;y |", "| 3 more |  |"]
