"""Read and write ASCII grids.

A grid becomes a map whose boundary is the rectangle around the grid, whose obstacles are the
blocked squares, and whose suggested `cell` is the side of a square.
"""

import math
import reprlib
from collections.abc import Mapping
from typing import Any

import numpy as np
import shapely
from jaxtyping import Bool

from ...base.documents import checked_number, refused
from ...base.limits import Crop
from ..occupancy import blocked_rings, rasterise


_BLOCKED, _FREE = "#X@", ". "
_HEADER = ("name", "cell", "origin", "robot_radius", "directions")


def parse_ascii(text: str, crop: Crop = None) -> dict[str, Any]:
    """Read an ASCII grid.

    ```text
    ; name a corridor
    ; cell 0.25
    #######
    #..#..#
    #.....#
    #######
    ```

    The first row is at the top. `#`, `X` and `@` are blocked squares, `.` and spaces are free
    squares, and all rows have the same length. Above the rows, lines that begin with `;` give
    `cell` (m; 1 by default), `origin` (x and y of the lower left corner, m), `robot_radius` (m),
    `directions` and `name`; lines that begin with `;;` are remarks.

    Returns keyword arguments of `Workspace`.
    """
    lines = text.replace("\r\n", "\n").split("\n")
    header: dict[str, str] = {}
    first = 0
    while first < len(lines) and (lines[first] == "" or lines[first].startswith(";")):
        _read_header_line(lines[first], first + 1, header)
        first += 1
    rows = lines[first:]
    while rows and rows[-1] == "":
        rows.pop()
    if not rows:
        raise ValueError("the grid has no rows")

    blocked = _squares(rows, first + 1, _BLOCKED, _FREE)
    fields: dict[str, Any] = {"name": header["name"]} if "name" in header else {}
    if "robot_radius" in header:
        fields["robot_radius"] = read_number("robot_radius", header["robot_radius"])
    if "directions" in header:
        try:
            fields["directions"] = int(header["directions"])
        except ValueError:
            raise refused("directions", "a whole number", header["directions"]) from None
    origin = [read_number("origin", text) for text in header.get("origin", "0 0").split()]
    if len(origin) != 2:
        raise refused("origin", "two numbers x y", header["origin"])
    cell = read_side("cell", header.get("cell", "1"))
    return {**fields, **grid_fields(blocked, (origin[0], origin[1]), cell, crop=crop)}


def parse_moving_ai(text: str, crop: Crop = None) -> dict[str, Any]:
    """Read a map of the MovingAI benchmarks (Sturtevant 2012), whose squares have sides of 1 m.

    Its header has the lines `type`, `height`, `width` and `map`. Free squares are `.`, `G` and `S`
    (a swamp), blocked ones `@`, `O`, `T` (trees) and `W` (water). Returns keyword arguments of
    `Workspace`.
    """
    header, _, body = text.replace("\r\n", "\n").partition("\nmap\n")
    sizes = dict(line.split(" ", 1) for line in header.split("\n") if " " in line)
    rows = body.rstrip("\n").split("\n")
    for name, number in (("height", len(rows)), ("width", len(rows[0]))):
        if sizes.get(name, "").strip() != str(number):
            got = f"got {sizes.get(name)}"
            raise ValueError(f"{name}: expected {number} as in the rows below, {got}")
    blocked = _squares(rows, header.count("\n") + 3, "@OTW", ".GS")
    return grid_fields(blocked, (0.0, 0.0), 1.0, crop=crop)


def _squares(
    rows: list[str], first: int, blocked: str, free: str
) -> Bool[np.ndarray, "rows columns"]:
    """Return the blocked squares of rows of equal length; the `first` line is the highest row."""
    for number, row in enumerate(rows, first):
        for column, square in enumerate(row, 1):
            if square not in blocked + free:
                expected = f"expected one of '{blocked}' (blocked) or '{free}' (free)"
                raise ValueError(f"line {number}, column {column}: {expected}, got {square!r}")
        if len(row) != len(rows[0]):
            other = f"but the first row, line {first}, has {len(rows[0])}"
            raise ValueError(f"line {number}: the row has {len(row)} squares, {other}")
    return np.array([[square in blocked for square in row] for row in rows[::-1]])


def format_ascii(
    fields: Mapping[str, Any], environment: shapely.Polygon | shapely.MultiPolygon
) -> str:
    """Write a map, given by its fields and its environment, as the text of an ASCII grid."""
    blocked, origin = grid_of(fields, environment)
    x, y = origin
    header = [f"; cell {fields['cell']!r}", f"; robot_radius {fields['robot_radius']!r}"]
    if fields["name"]:
        header.insert(0, f"; name {fields['name']}")
    if fields["directions"] is not None:
        header.append(f"; directions {fields['directions']}")
    if origin != (0.0, 0.0):
        header.append(f"; origin {x!r} {y!r}")
    rows = ["".join(row) for row in np.where(blocked[::-1], "#", ".")]
    return "\n".join([*header, *rows]) + "\n"


def _read_header_line(line: str, number: int, header: dict[str, str]) -> None:
    if line == "" or line.startswith(";;") or not line[1:].strip():
        return
    key, _, value = line[1:].strip().partition(" ")
    if key not in _HEADER:
        expected = f"{', '.join(_HEADER)}, or ';;' before a remark"
        raise ValueError(f"line {number}: {reprlib.repr(key)}: unknown; expected {expected}")
    if key in header:
        raise ValueError(f"line {number}: {key!r} is given twice")
    header[key] = value.strip()


def read_number(field: str, text: Any) -> float:
    return checked_number(field, text, most=math.inf, text=True)


def read_side(field: str, text: Any) -> float:
    value = read_number(field, text)
    if not value > 0:
        raise ValueError(f"{field}: expected more than 0 m, got {value:g}")
    return value


def grid_fields(
    blocked: Bool[np.ndarray, "rows columns"],
    origin: tuple[float, float],
    cell: float,
    yaw: float = 0.0,
    crop: Crop = None,
) -> dict[str, Any]:
    """Return the map fields of a grid; row 0 is the lowest, `origin` the lower left corner.

    The grid is turned by `yaw` (radians) about this corner. `crop` are two opposite corners of a
    part of it, whose sides are along the rows; squares that the part meets are kept.
    """
    turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    low = np.zeros(2, int)
    if crop is not None:
        corners = (np.reshape(crop, (2, 2)) - origin) @ turn / cell
        low = np.floor(corners.min(axis=0) + 1e-9).clip(0).astype(int)
        high = np.ceil(corners.max(axis=0) - 1e-9).clip(0, blocked.shape[::-1]).astype(int)
        blocked = blocked[low[1] : high[1], low[0] : high[0]]
        if not blocked.size:
            raise ValueError("`crop` is outside the map")
    if blocked.all():
        raise ValueError("the grid has no free square")
    rows, columns = blocked.shape
    rectangle = np.array([(0, 0), (columns, 0), (columns, rows), (0, rows)])
    corners, starts = blocked_rings(blocked)

    def place(squares: np.ndarray) -> np.ndarray:
        away = cell * (squares + low)
        return np.array(origin) + (away if yaw == 0 else away @ turn.T)

    return {
        "boundary": place(rectangle),
        "obstacles": np.split(place(corners), starts) if blocked.any() else [],
        "cell": cell,
    }


def grid_of(
    fields: Mapping[str, Any], environment: shapely.Polygon | shapely.MultiPolygon
) -> tuple[Bool[np.ndarray, "rows columns"], tuple[float, float]]:
    """Return the blocked squares of a map (row 0 is the lowest), and its lower left corner."""
    if fields["cell"] is None:
        raise ValueError("cell: a grid needs the side of its squares, and this map suggests none")
    x, y = fields["boundary"].min(axis=0).tolist()
    far_x, far_y = fields["boundary"].max(axis=0).tolist()
    blocked = rasterise(environment, (x, y, far_x, far_y), fields["cell"])
    if blocked.all():
        raise ValueError(f"cell: no square of side {fields['cell']:g} m has its centre free")
    return blocked, (x, y)
