"""The box of a dynamical system in a recording, drawn as a square along its first two axes."""

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Float

from ...space import Box
from ..canvas.marks import log_labels
from ..canvas.palette import CATEGORIES, PLAIN, Color
from ..canvas.stream import plane


SIDE = 10.0
"""The side of the drawn box, to which all axes are scaled."""


def category(number: int) -> Color:
    """Return the colour of the attractor or set `number`; numbers past the last colour are grey."""
    return list(CATEGORIES.values())[number] if number < len(CATEGORIES) else PLAIN


def scaled(box: Box, points: Float[np.ndarray, "points axes"]) -> Float[np.ndarray, "points axes"]:
    """Scale points so that the box is a cube of side `SIDE`."""
    lower = np.array(box.lower)
    return SIDE * (points - lower) / (np.array(box.upper) - lower)


def log_axes(
    stream: rr.RecordingStream, box: Box, names: tuple[str, ...], pictures: tuple[str, ...]
) -> None:
    """Log the names and the ends of the axes, and scale the entities `pictures` to the box."""
    columns, rows = (*box.cells[:2], 1)[:2]
    stretch = rr.Transform3D(translation=[0, SIDE, 0], scale=[SIDE / columns, -SIDE / rows, 1])
    for name in pictures:
        stream.log(f"box/{name}", stretch, static=True)
    below = SIDE + 0.2
    ends = [(f"{box.lower[0]:.4g}", 0.0, below), (names[0], SIDE / 2, below)]
    ends.append((f"{box.upper[0]:.4g}", SIDE, below))
    if box.dimensions > 1:
        ends += [(f"{box.upper[1]:.4g}", -0.7, 0.0), (names[1], -1.4, SIDE / 2)]
        ends.append((f"{box.lower[1]:.4g}", -0.7, SIDE - 0.4))
    log_labels(stream, "box/ends", ends)


def view(title: str, *shown: str) -> rrb.Spatial2DView:
    """Create a view of entities of the box, with the axes."""
    around = -3, -1.2, SIDE + 1, SIDE + 1.4
    return plane("box", title, around, [f"/box/{one}" for one in (*shown, "ends")])
