"""Positions, lists in rows, and parts, in every view of a result."""

import dataclasses
from typing import Annotated, ClassVar

import numpy as np
import pytest

from jaxcell.base.quantities import Result, derived, quantity
from jaxcell.cli.terminal import show
from jaxcell.record import dataset, summary
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
    found = summary(watch)
    assert found["gate"] == {"cell": 2, "x": 2.5, "y": 0.5}
    assert found["night"] == {
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
        found = dataset(clock)
        checks = (found.attrs["check_late"], found.attrs["check_late_below_0"])
        assert str([*checks, found.late.item()]) == "[0.0, 0.0, 0.0]"
        assert str(found.off.values.tolist()) == "[0.0, 0.0, -1.0]"
        assert str(summary(clock)) == "{'late': 0.0, 'off': [0.0, 0.0, -1.0]}"
    assert np.signbit(off[0])


def test_tables_say_where_positions_are(watch, capsys):
    show(watch, "The watch")
    out = capsys.readouterr().out
    assert "(2.5, 0.5)" in out
    assert "(1.5, 0.5)" in out
    assert "none" in out


def test_parts_have_variables_and_checks_of_their_own(watch):
    found = dataset(watch)
    assert found.night_post.values.tolist() == [1, -1]
    assert found.guard.values.tolist() == [0, 1]
    assert found.attrs["check_night_late"] == 3.0
    late = dataclasses.replace(watch.night, late=6.0)
    with pytest.raises(RuntimeError, match="night_late is 6, expected at most 5"):
        dataset(dataclasses.replace(watch, night=late))
    lost = dataclasses.replace(watch.night, post=np.array([1, -2]))
    with pytest.raises(RuntimeError, match="night_post_below_minus_1"):
        dataset(dataclasses.replace(watch, night=lost))
