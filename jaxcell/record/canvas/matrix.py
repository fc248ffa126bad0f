"""Heat maps of matrices. The first row is at the top, and large numbers are yellow."""

from collections.abc import Sequence

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Float

from .map import log_pictures
from .marks import log_labels
from .palette import PLAIN, Color
from .scale import Scale
from .stream import plane


# Largest number of squares with printed numbers, and of rows or columns with names.
_MAX_NUMBERS = 150
_MAX_NAMES = 40
# The viewer draws a label below its point, by this distance in squares.
_HANG = 0.25


def log_matrix(
    stream: rr.RecordingStream,
    path: str,
    title: str,
    values: Float[np.ndarray, "rows columns"],
    rows: Sequence[str],
    columns: Sequence[str],
    unit: str,
    margin: float = 1.0,
) -> tuple[rrb.Spatial2DView, list[tuple[str, Color]]]:
    """Log a matrix as a heat map, with the names of its rows and columns.

    Missing numbers are NaN, and the others are not negative. `unit` may be empty. `margin` is the
    width for the names of rows, in squares. **Returns:** the view, and the legend.
    """
    scale = Scale.over(values, f"{{}} {unit}".rstrip().format, special={"none": PLAIN})
    known = ~np.isnan(values)
    levels = scale.levels(values, {"none": ~known})
    classes = scale.classes
    log_pictures(stream, f"{path}/heat", classes, levels)
    names: list[tuple[str, float, float]] = []
    if len(rows) <= _MAX_NAMES:
        names += [(name, -margin / 2, row + _HANG) for row, name in enumerate(rows)]
    if len(columns) <= _MAX_NAMES:
        names += [(name, column + 0.5, _HANG - 0.8) for column, name in enumerate(columns)]
    log_labels(stream, f"{path}/labels", names, order=10.0)
    if known.sum() <= _MAX_NUMBERS:
        at = np.argwhere(known).tolist()
        numbers = [(f"{values[row, column]:.3g}", column + 0.5, row + _HANG) for row, column in at]
        grounds = [classes[level].color for level in levels[known].tolist()]
        log_labels(stream, f"{path}/numbers", numbers, grounds, order=10.0)
    view = plane(path, title, (-margin, -1, len(columns) + 0.3, len(rows) + 0.3))
    return view, scale.legend(shown=[])
