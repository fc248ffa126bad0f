"""A tuple of results is a list in the summary, and columns side by side in the terminal."""

import dataclasses
from typing import Annotated, ClassVar

import numpy as np
import pytest

from jaxcell.base.quantities import Result, derived, quantity
from jaxcell.cli.terminal import show
from jaxcell.record import dataset, summary


@dataclasses.dataclass(frozen=True, eq=False)
class Floor(Result):
    tables: ClassVar = {"room": "rooms"}

    height: Annotated[float, quantity("", "height of the floor", "m")]
    rooms_area: Annotated[np.ndarray, quantity("room", "area", "m2")]
    lit: Annotated[float, quantity("", "share that is lit", kind="share", padding="NaN: not known")]


@dataclasses.dataclass(frozen=True, eq=False)
class House(Result):
    title: ClassVar = "A house"

    floors: tuple[Floor, ...]

    @derived("floor", "rooms of each floor", kind="count")
    def rooms(self):
        raise AssertionError("a derived quantity is computed although it is not used")


HOUSE = House((Floor(0.0, np.array([9.0, 4.0]), 0.5), Floor(2.5, np.arange(1.0, 41), float("nan"))))


def test_the_summary_lists_the_parts():
    first, second = summary(HOUSE)["floors"]
    assert first == {"height": 0.0, "lit": 0.5, "rooms": [{"area": 9.0}, {"area": 4.0}]}
    assert second["lit"] is None


def test_the_dataset_has_their_single_numbers_along_a_dimension():
    kept = dataclasses.replace(HOUSE)
    kept.__dict__["rooms"] = np.array([2, 40])
    found = dataset(kept)
    assert found.floor_height.dims == ("floor",)
    assert found.floor_height.values.tolist() == [0, 2.5]
    assert found.floor_height.attrs["long_name"] == "height of the floor"
    assert "floor_rooms_area" not in found
    # An unknown share, NaN, passes the check.
    assert np.isnan(found.floor_lit[1])
    bright = dataclasses.replace(HOUSE.floors[0], lit=1.5)
    wrong = dataclasses.replace(kept, floors=(HOUSE.floors[0], bright))
    wrong.__dict__["rooms"] = np.array([2, 2])
    with pytest.raises(RuntimeError, match="floor_lit_out_of_0_to_1"):
        dataset(wrong)


def test_the_terminal_has_a_column_for_each(capsys):
    show(HOUSE, "house")
    out = " ".join(capsys.readouterr().out.split())
    assert "│ height of the floor │ 0 m │ 2.5 m │" in out
    assert "Floor 1: rooms" in out
    assert "and 10 more" in out
