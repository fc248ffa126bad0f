"""Tables of quantities in the texts of recordings."""

import dataclasses
from typing import Annotated, ClassVar

import numpy as np

from jaxcell.base.quantities import Result, quantity
from jaxcell.record.canvas.prose import described, numbers, table
from jaxcell.space import CellSpace


@dataclasses.dataclass(frozen=True, eq=False)
class Seen(Result):
    title: ClassVar[str] = "What was seen"

    cells: CellSpace
    where: Annotated[int, quantity("", "where it was seen", kind="place")]
    share: Annotated[float, quantity("", "share of time", "1", kind="share")]
    again: Annotated[float | None, quantity("", "time until it was seen again", "s", kind="time")]
    heights: Annotated[np.ndarray, quantity("window", "height", "m")]


def seen(again=None, share=0.25):
    return Seen(CellSpace.of_grid(np.ones((1, 2), bool), 4), 1, share, again, np.array([2.0, 1.5]))


def test_single_numbers_have_their_meanings_and_units():
    lines = numbers(seen(np.inf)).splitlines()
    assert lines[2:] == [
        "| where it was seen | (1.5, 0.5) |",
        "| share of time | 25 % |",
        "| time until it was seen again | never |",
    ]
    assert "again" not in numbers(seen())


def test_a_row_for_each_place_along_a_dimension_or_for_each_result():
    rows = described(seen(), "heights", first={"window": ["left", "right"]}).splitlines()
    assert rows[0] == "| window | height |"
    assert rows[2:] == ["| left | 2 m |", "| right | 1.5 m |"]
    rows = described([seen(3.0), seen(share=0.5)], "share", "again").splitlines()
    assert rows[2:] == ["| 25 % | 3 s |", "| 50 % |  |"]


def test_long_tables_say_how_many_rows_are_missing():
    rows = table(("a", "b"), [(i, "x|y") for i in range(5)], most=2).splitlines()
    assert rows[2:] == ["| 0 | x&#124;y |", "| 1 | x&#124;y |", "| 3 more |  |"]
