"""What several tabs show of robots on a map: what is seen from a cell, and who is who."""

from collections.abc import Sequence

import numpy as np
import rerun as rr
import shapely
from jaxtyping import Int

from ...patrol import PatrolledMap
from ...space import visibility_polygon
from ..canvas.map import CellMap
from ..canvas.marks import points
from ..canvas.palette import Color, robot_color
from ..canvas.prose import table


# Robots that have maps of their own, and rows in tables.
MAX_MAPS = 6
_MAX_ROWS = 24
BASE_VIEW: Color = (190, 226, 234)
"The colour of what only a base station watches."


def log_sight(
    map: CellMap,
    patrol: PatrolledMap,
    path: str,
    viewers: Int[np.ndarray, "times"],
    color: Color,
    *timelines: tuple[str, Int[np.ndarray, "times"]],
) -> None:
    """Log the outline of what is seen from a cell at each time, or from one at all times."""
    assert patrol.cells.workspace is not None
    outlines = {}
    for cell, xy in zip(np.unique(viewers).tolist(), map.xy(np.unique(viewers)), strict=True):
        polygon = visibility_polygon(patrol.cells.workspace, xy, patrol.reach)
        parts = shapely.get_rings(shapely.get_parts(polygon))
        outlines[cell] = [shapely.get_coordinates(ring) for ring in parts]
    shown = [outlines[cell] for cell in viewers.tolist()]
    style = rr.LineStrips2D.from_fields(colors=color, radii=points(2.0), draw_order=25)
    map.stream.log(path, style, static=True)
    strips = [ring for rings in shown for ring in rings]
    if not timelines:
        map.stream.log(path, rr.LineStrips2D.from_fields(strips=strips), static=True)
    for timeline, times in timelines:
        columns = rr.LineStrips2D.columns(strips=strips).partition([len(one) for one in shown])
        map.stream.send_columns(path, [rr.TimeColumn(timeline, sequence=times)], columns)


def place(patrol: PatrolledMap, cell: int) -> str:
    """The centre of a cell, in words."""
    x, y = patrol.xy[cell].tolist()
    return f"({x:g}, {y:g})"


def robot_table(columns: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """A table of the first robots in Markdown, with their colours."""
    named = [(f"{i} ({robot_color(i)[0]})", *row) for i, row in enumerate(rows[:_MAX_ROWS])]
    return table(("robot", *columns), named)


def only_some(patrol: PatrolledMap) -> str:
    """A sentence on the robots that have no maps of their own, if there are such."""
    return f" The first {MAX_MAPS} robots are shown." if patrol.robots > MAX_MAPS else ""
