"""Pieces of the texts beside the pictures, in Markdown."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from ...space import CellSpace


def describe(cells: CellSpace) -> str:
    """What the map is, and into which cells it is cut."""
    if cells.workspace is not None:
        place = cells.workspace.describe()
    else:
        rows, columns = cells.free.shape
        place = f"a grid of {columns} x {rows} squares"
    return (
        f"The map is {place}. Squares of {cells.cell:g} m make {cells.positions:,} free positions; "
        f"with {cells.directions} directions these are **{cells.size:,} cells**. A step leads from "
        "the centre of a square to that of another, so paths follow the grid more than the heading."
    )


def bouncing(bounce: float) -> str:
    """How a robot with one bouncing angle, in radians, moves."""
    return (
        f"A robot runs straight. Where it bumps it turns by **{math.degrees(bounce):.6g}°** "
        "(counter-clockwise), and runs on."
    )


def pose(cells: CellSpace, cell: int) -> str:
    """Where a robot is, and its heading."""
    x, y, theta = (float(value) for value in cells.centre(cell))
    return f"x = {x:.4g} m, y = {y:.4g} m, heading {math.degrees(theta):.6g}°"


def made_with(spec: Mapping[str, Any]) -> str:
    """The parameters of a recording, as its last section."""
    if not spec:
        return ""
    given = {key: value for key, value in spec.items() if value is not None}
    rows = [(key, str(value).replace("|", "&#124;")) for key, value in given.items()]
    return "## Made with\n\n" + table(("what", "value"), rows)


def table(columns: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """A table in Markdown."""
    lines = [columns, ["---"] * len(columns), *rows]
    return "\n".join("| " + " | ".join(map(str, line)) + " |" for line in lines)


def times(count: int) -> str:
    """How often: `once`, `twice`, `3 times`."""
    return {1: "once", 2: "twice"}.get(count, f"{count:,} times")


def counted(count: int, one: str, many: str | None = None) -> str:
    """A number with its noun: `1 group`, `2,000 groups`."""
    return f"{count:,} {one if count == 1 else many or one + 's'}"
