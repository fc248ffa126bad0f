"""The outline of the area that is seen from a cell, and tables of robots."""

from typing import Any

import numpy as np
import rerun as rr
import shapely
from jaxtyping import Int

from ...patrol import PatrolledMap
from ...space import visibility_polygon
from ..canvas.map import CellMap
from ..canvas.marks import points
from ..canvas.palette import Color, robot_color
from ..canvas.prose import described
from ..canvas.stream import send_changing


# Largest number of robots with separate maps, and with rows in tables.
MAX_MAPS = 6
_MAX_ROWS = 24
BASE_VIEW: Color = (190, 226, 234)
"The colour of cells that only a base station watches."
SEEN = {
    "centre": "their centre is in view of the robot",
    "cell": "their whole free part is in view of the robot",
    "source": "the whole square of the robot is in view of their centre",
}
"The end of the sentence 'squares count as seen if ...', for each rule of visibility."


def log_sight(
    map: CellMap,
    patrol: PatrolledMap,
    path: str,
    viewers: Int[np.ndarray, "times"],
    color: Color,
    *timelines: tuple[str, Int[np.ndarray, "times"]],
) -> None:
    """Log the outline of the area that is seen from each cell in `viewers`.

    Each of `timelines` is a name and the time of each viewer; without any, outlines are static.
    """
    outlines = {}
    for cell, xy in zip(np.unique(viewers).tolist(), map.xy(np.unique(viewers)), strict=True):
        polygon = visibility_polygon(patrol.cells.room, xy, patrol.reach)
        parts = shapely.get_rings(shapely.get_parts(polygon))
        outlines[cell] = [shapely.get_coordinates(ring) for ring in parts]
    shown = [outlines[cell] for cell in viewers.tolist()]
    rings, counts = [ring for each in shown for ring in each], [len(each) for each in shown]
    style: dict[str, Any] = {"colors": color, "radii": points(2.0), "draw_order": 25}
    if not timelines:
        map.stream.log(path, rr.LineStrips2D(rings, **style), static=True)
    to = map.stream, path, rr.LineStrips2D
    for line, times in timelines:
        send_changing(*to, times, counts, line, style=style, strips=rings)


def place(patrol: PatrolledMap, cell: int) -> str:
    """Format the centre of a cell, in metres."""
    x, y = patrol.xy[cell].tolist()
    return f"({x:g}, {y:g})"


def robot_table(patrol: PatrolledMap, *names: str) -> str:
    """Format quantities of the first `_MAX_ROWS` robots, and their colours, as a Markdown table."""
    robots = [f"{i} ({robot_color(i)[0]})" for i in range(patrol.robots)]
    return described(patrol, *names, first={"robot": robots}, most=_MAX_ROWS)


def only_some(patrol: PatrolledMap) -> str:
    """Return a sentence about the number of shown robots, or "" if all robots are shown."""
    return f" The first {MAX_MAPS} robots are shown." if patrol.robots > MAX_MAPS else ""
