"""The outlines of what is seen from cells."""

from collections.abc import Sequence

import numpy as np
import rerun as rr
import shapely
from jaxtyping import Float, Int

from ..space import visibility_polygon
from .canvas.palette import Color
from .map_patrol import MapPatrol


_Rings = list[Float[np.ndarray, "_ 2"]]


def outlines(patrol: MapPatrol, viewers: Int[np.ndarray, "viewers"]) -> list[_Rings]:
    """The rings around what is seen from each of some cells, in metres."""
    assert patrol.cells.workspace is not None
    xy = patrol.xy
    rings = {}
    for cell in np.unique(viewers).tolist():
        polygon = visibility_polygon(patrol.cells.workspace, xy[cell], patrol.reach)
        parts = shapely.get_rings(shapely.get_parts(polygon))
        rings[cell] = [shapely.get_coordinates(ring) for ring in parts]
    return [rings[cell] for cell in viewers.tolist()]


def log_outlines(
    stream: rr.RecordingStream,
    path: str,
    timeline: str,
    times: Int[np.ndarray, "times"],
    rings: Sequence[_Rings],
) -> None:
    """Logs the rings of each time."""
    strips = rr.LineStrips2D.columns(strips=[ring for some in rings for ring in some])
    index = [rr.TimeColumn(timeline, sequence=times)]
    stream.send_columns(path, index, strips.partition([len(some) for some in rings]))


def log_outline_style(stream: rr.RecordingStream, path: str, color: Color) -> None:
    """Logs what all outlines at a path have in common."""
    line = rr.LineStrips2D.from_fields(colors=color, radii=rr.Radius.ui_points(2), draw_order=25)
    stream.log(path, line, static=True)
