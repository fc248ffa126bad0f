"""Results of one kind, side by side or one below the other."""

import dataclasses
import itertools
import json
import re
from typing import Annotated, ClassVar

import numpy as np
import pytest

from jaxcell import space
from jaxcell.base.formatting import format_value
from jaxcell.base.quantities import Result, quantity
from jaxcell.cli import main
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


@pytest.mark.parametrize(("robots", "aside"), [(1, True), (9, False)])
def test_a_wide_table_of_few_rows_is_transposed(capsys, monkeypatch, robots, aside):
    monkeypatch.setenv("COLUMNS", "40")
    tour = np.where(np.arange(3) < 2, 1_234_567_890, -1) * np.ones((robots, 1), int)
    show(Robots(np.full(robots, 12_345_678_901), tour), "a patrol")
    said = capsys.readouterr().out
    rows = [line for line in said.splitlines() if line.startswith("│")]
    # A table that is too wide even so has a row for each cell.
    assert sum(row.startswith("│ its tour") for row in rows) == (1 if aside else robots)
    assert not any("-1" in row for row in rows)
    assert said.count("12,345,678,901") == robots


@pytest.mark.parametrize("width", [20, 40, 60, 80, 120])
def test_tables_of_any_width_keep_their_border_and_their_words(capsys, monkeypatch, width):
    """Heads, words and numbers of many lengths, drawn at random."""
    monkeypatch.setenv("COLUMNS", str(width))
    draw = np.random.default_rng(width)
    for _ in range(60):
        columns, rows = draw.integers(1, 9), draw.integers(1, 6)
        sizes = [draw.integers(1, 12, draw.integers(1, 5)) for _ in range(columns)]
        heads = [" ".join("x" * size for size in one) for one in sizes]
        cells = [[f"{n:,}" for n in draw.integers(0, 10**9, columns)] for _ in range(rows)]
        table("title", heads, cells)
        said = capsys.readouterr().out
        lines = said.splitlines()[1:]
        for number in itertools.chain(*cells):
            assert any(re.search(rf"(?<![\d,]){number}(?![\d,])", line) for line in lines)
        for word in " ".join(heads).split():
            assert word in said
        if lines[0].startswith("┏"):
            assert len({len(line) for line in lines}) == 1
            assert len(lines[0]) <= width
            assert {line[-1] for line in lines} <= set("┓┃┩│┤┘")
        else:
            assert all(len(line) <= width or " " not in line.strip() for line in lines)


def test_words_that_fit_are_not_broken(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "40")
    table("", ["transmogrification", "a few short words", "b"], [["1", "2", "3"]])
    said = capsys.readouterr().out
    assert "transmogrification" in said
    assert max(map(len, said.splitlines())) <= 40


def test_indices_are_told_from_counts():
    index, count = quantity("", "a group", kind="index"), quantity("", "groups", kind="count")
    assert (format_value(3, index), format_value(3, count)) == ("#3", "3")
    assert format_value(-1, index) == "none"
    room = space.CellSpace.of_grid(np.ones((2, 3), bool), 8)
    cell, place = quantity("", "end", kind="cell"), quantity("", "end", kind="position")
    # Row 0 has positions 0 to 2, and direction 1 of 8 looks to the North-East.
    assert format_value(6 + 2, cell, room) == "2.5 m, 0.5 m, heading 45° (cell 8)"
    assert format_value(2, place, room) == "2.5 m, 0.5 m (position 2)"
    assert format_value(8, cell) == "cell 8"
    assert format_value(np.arange(40) % 6, place, room).startswith("positions 0, 1, 2, 3")


@pytest.mark.parametrize("width", [40, 60, 80, 120])
@pytest.mark.parametrize(
    "line",
    [
        "maps",
        "doctor @lab_a",
        "doctor @eight",
        "groups @lab_a --bounce 45 90 135",
        "localize @lab_a --bounce 45 --start 19",
        "patrol graph @eight --robots 2",
    ],
)
def test_tables_of_commands_are_whole(line, width, monkeypatch, capsys):
    for name, value in {"COLUMNS": str(width), "FORCE_COLOR": "1", "TERM": "xterm"}.items():
        monkeypatch.setenv(name, value)
    assert main(line.split()) == 0
    lines = re.sub(r"\x1b\[[\d;]*m", "", capsys.readouterr().out).splitlines()
    assert max(map(len, lines)) <= width
    right = {"┏": "┓", "┃": "┃", "┡": "┩", "│": "│", "├": "┤", "└": "┘"}
    rows = [line for line in lines if line[:1] in right]
    assert rows
    assert all(row[-1] == right[row[0]] for row in rows)
    assert not any("seconds" in row for row in rows)


def test_the_answer_names_each_pose_where_the_robot_may_be(capsys):
    words = ["localize", "@lab_a", "--bounce", "45", "--start", "19"]
    assert main([*words, "--json"]) == 0
    ends = json.loads(capsys.readouterr().out)["candidates"]
    assert main(words) == 0
    answer = capsys.readouterr().out.splitlines()[0]
    of = [[one[f"candidate_{name}"] for name in ("x", "y", "theta_deg")] for one in ends]
    poses = [f"{x:g} m, {y:g} m, heading {theta:g}°" for x, y, theta in of]
    assert len(poses) == 3
    assert all(pose in answer for pose in poses)
