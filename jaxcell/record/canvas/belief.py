"""Cells where a robot may be, as arrows, or as shaded squares while there are too many."""

import numpy as np
import rerun as rr
from jaxtyping import Float, Integer, UInt8

from ...space import CellSpace
from .map import CellMap, log_classes, on_squares
from .palette import BELIEF, CLEAR, FREE, PictureClass, mix


MAX_ARROWS = 400
"""More cells than this are shown as shaded squares."""
_SHADES = 8


def log_belief_style(map: CellMap) -> None:
    """Log what the arrows at `map/belief` and the shades at `map/grid/belief` mean."""
    style = rr.Arrows2D.from_fields(colors=BELIEF, radii=_length(map) / 10, draw_order=20)
    map.stream.log("map/belief", style, static=True)
    classes = [PictureClass("the robot cannot be here", CLEAR)]
    for share in np.linspace(0.2, 1, _SHADES):
        classes.append(PictureClass("the robot may be here", mix(FREE, BELIEF, share)))
    log_classes(map.stream, "map/grid/belief", classes)


def belief_arrows(
    map: CellMap, where: Integer[np.ndarray, "arrows"]
) -> tuple[Float[np.ndarray, "arrows 2"], Float[np.ndarray, "arrows 2"]]:
    """Arrows at cells, along their directions: where they begin, and their vectors, in metres."""
    _, _, theta = map.cells.centre(where)
    return map.xy(where), _length(map) * np.stack([np.cos(theta), np.sin(theta)], axis=1)


def belief_shades(
    cells: CellSpace, where: Integer[np.ndarray, "belief"]
) -> UInt8[np.ndarray, "rows columns"]:
    """The share of directions that are possible at each square; 0 if arrows show them."""
    shade = np.zeros(cells.positions, np.uint8)
    if where.size > MAX_ARROWS:
        count = np.bincount(where % cells.positions, minlength=cells.positions)
        shade[:] = np.ceil(count * (_SHADES / cells.directions))
    return on_squares(cells, shade)


def _length(map: CellMap) -> float:
    return max(0.42 * map.cells.cell, 0.02 * map.extent)
