"""Results of one kind, side by side or one below the other."""

import dataclasses
from typing import Annotated, ClassVar

import numpy as np
import pytest

from jaxcell.base.quantities import Result, quantity
from jaxcell.cli.terminal import show, table


@dataclasses.dataclass(frozen=True, eq=False)
class Layer(Result):
    mean_depth: Annotated[float, quantity("", "depth of the middle of the layer", "m")]
    cells: Annotated[int, quantity("", "cells of water", kind="count")]


@dataclasses.dataclass(frozen=True, eq=False)
class Sea(Result):
    brief: ClassVar[tuple[str, ...]] = ("name",)
    name: Annotated[str, quantity("", "name")]
    layers: tuple[Layer, ...]


@pytest.mark.parametrize(("count", "lines"), [(3, 2), (6, 6)])
def test_more_than_three_of_a_kind_have_a_row_each(capsys, count, lines):
    show(Sea("blue", tuple(Layer(10.0 * k, 100 + k) for k in range(count))), "a sea")
    below = capsys.readouterr().out.split("Layers")[1]
    rows = [line for line in below.splitlines() if line.startswith("│")]
    assert len(rows) == lines
    assert ("depth of the middle of the layer" in below) == (count == 3)
    assert ("mean depth" in below) == (count == 6)


def test_the_numbers_of_a_single_layer_are_in_the_first_table(capsys):
    @dataclasses.dataclass(frozen=True, eq=False)
    class Pond(Result):
        cells: Annotated[int, quantity("", "cells of water", kind="count")]
        layers: tuple[Layer, ...]

    show(Pond(5, (Layer(3.0, 5),)), "a pond")
    out = capsys.readouterr().out
    assert out.count("cells of water") == 1
    assert "depth of the middle of the layer" in out
    assert "Layers" not in out


@dataclasses.dataclass(frozen=True, eq=False)
class Robots(Result):
    tables: ClassVar[dict[str, str]] = {"robot": "robots"}
    cells: Annotated[np.ndarray, quantity("robot", "cells that it visits every now and then")]
    tour: Annotated[np.ndarray, quantity("robot stop", "its tour", kind="index", listed=True)]


@pytest.mark.parametrize(("robots", "aside"), [(2, True), (9, False)])
def test_a_wide_table_of_few_rows_is_transposed(capsys, monkeypatch, robots, aside):
    monkeypatch.setenv("COLUMNS", "40")
    tour = np.where(np.arange(3) < 2, 1_234_567_890, -1) * np.ones((robots, 1), int)
    show(Robots(np.full(robots, 12_345_678_901), tour), "a patrol")
    rows = [line for line in capsys.readouterr().out.splitlines() if line.startswith("│")]
    assert any(row.startswith("│ its tour") for row in rows) == aside
    assert not any("-1" in row for row in rows)


def test_words_that_fit_are_not_broken(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "40")
    table("", ["transmogrification", "a few short words", "b"], [["1", "2", "3"]])
    said = capsys.readouterr().out
    assert "transmogrification" in said
    assert max(map(len, said.splitlines())) <= 40
