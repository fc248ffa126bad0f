"""The belief of a robot: its possible cells, or the probabilities of positions as a heat map.

Possible cells are drawn as arrows, or as shaded squares if there are many."""

from collections.abc import Sequence

import numpy as np
import rerun as rr
from jaxtyping import Float, Integer, UInt8

from ...space import CellSpace
from .map import CellMap, log_classes, on_squares, send_pictures
from .palette import BELIEF, CLEAR, FREE, PictureClass, mix
from .scale import Scale
from .stream import send_changing


MAX_ARROWS = 400
"""Largest number of cells that are shown as arrows; more cells are shown as shaded squares."""
_SHADES = 8
_FAINT, _UNLIKELY = 1e-3, "less than 0.001"


def arrows(
    cells: CellSpace, where: Integer[np.ndarray, "arrows"]
) -> tuple[Float[np.ndarray, "arrows 2"], Float[np.ndarray, "arrows 2"]]:
    """Return the origins and vectors of arrows at the cells `where`, along their headings."""
    x, y, theta = cells.centre(where)
    heading = np.stack([np.cos(theta), np.sin(theta)], axis=1)
    return np.stack([x, y], axis=1), _length(cells) * heading


def _length(cells: CellSpace) -> float:
    return max(0.42, 0.02 * max(cells.free.shape)) * cells.cell


def robot_length(map: CellMap) -> float:
    """Return the length, in metres, of the arrow that shows the heading of a robot."""
    return max(0.7 * map.cells.cell, 0.035 * map.extent)


def log_belief_style(stream: rr.RecordingStream, cells: CellSpace) -> None:
    """Log the style of the arrows of a belief, at the entity `map/belief`."""
    style = rr.Arrows2D.from_fields(colors=BELIEF, radii=_length(cells) / 10, draw_order=20)
    stream.log("map/belief", style, static=True)


def log_shades(stream: rr.RecordingStream) -> None:
    """Log the meanings and colours of the shades of possible cells, at `map/grid/belief`."""
    shares = np.linspace(0.2, 1, _SHADES)
    classes = [PictureClass("the robot cannot be here", CLEAR)]
    classes += [PictureClass("the robot may be here", mix(FREE, BELIEF, s)) for s in shares]
    log_classes(stream, "map/grid/belief", classes)


def shades(
    cells: CellSpace, where: Integer[np.ndarray, "belief"]
) -> UInt8[np.ndarray, "positions"]:
    """Return the shade of each position, from the share of its directions that are in `where`.

    All shades are 0 if `where` has at most `MAX_ARROWS` cells, because arrows show these cells.
    """
    if where.size <= MAX_ARROWS:
        return np.zeros(cells.positions, np.uint8)
    count = np.bincount(where % cells.positions, minlength=cells.positions)
    return np.ceil(count * (_SHADES / cells.directions)).astype(np.uint8)


def log_beliefs(
    stream: rr.RecordingStream, cells: CellSpace, beliefs: Sequence[Integer[np.ndarray, "_"]]
) -> None:
    """Log the cells where a robot may be at each step, as arrows or as shaded squares."""
    size = np.array([where.size for where in beliefs])
    shown = np.where(size <= MAX_ARROWS, size, 0)
    few = [where for where in beliefs if where.size <= MAX_ARROWS]
    where = np.concatenate([*few, np.empty(0, np.int32)])
    origins, vectors = arrows(cells, where)
    times = np.arange(size.size)
    send_changing(stream, "map/belief", rr.Arrows2D, times, shown, origins=origins, vectors=vectors)
    log_belief_style(stream, cells)

    crowded = np.flatnonzero(size > MAX_ARROWS)
    if crowded.size:
        log_shades(stream)
        times = np.arange(min(crowded[-1] + 2, size.size))
        kinds = [shades(cells, beliefs[time]) for time in times.tolist()]
        pictures = on_squares(cells, np.stack(kinds))
        send_pictures(stream, "map/grid/belief", pictures, "step", times)


def heat_scale() -> Scale:
    """Return the scale for probabilities of positions; improbable squares are transparent."""
    return Scale.over(
        np.array([_FAINT, 1.0]),
        "probability {}".format,
        spaced=np.geomspace,
        special={_UNLIKELY: CLEAR},
        digits=1,
    )


def heat(belief: Float[np.ndarray, "*times positions"]) -> UInt8[np.ndarray, "*times positions"]:
    """Convert probabilities to picture classes of the [`heat_scale`][]."""
    return heat_scale().levels(belief, {_UNLIKELY: belief < _FAINT})
