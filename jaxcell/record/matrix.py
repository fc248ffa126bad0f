"""Matrices as heat maps, whose first row is on top; yellow is for large numbers."""

from collections.abc import Sequence

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Float

from .blueprint import log_classes
from .canvas.palette import OBSTACLE, PLAIN, TEXT, LegendEntry, PictureClass, ramp


_LEVELS = 32
_LEGEND_ROWS = 8
# More squares than this do not have their numbers written on them, and more rows or columns have
# no names beside them.
_MOST_NUMBERS = 150
_MOST_NAMES = 40
# A label hangs below its point.
_HANG = 0.25


def log_matrix(
    stream: rr.RecordingStream,
    path: str,
    values: Float[np.ndarray, "rows columns"],
    rows: Sequence[str],
    columns: Sequence[str],
    unit: str,
    margin: float = 1.0,
) -> list[LegendEntry]:
    """Logs a heat map.

    **Arguments:**

    - `values`: the numbers, not negative; squares that have none are NaN.
    - `rows`, `columns`: their names.
    - `unit`: what the numbers count.
    - `margin`: how much space the names of rows have, in squares.

    **Returns:** what the colours mean.
    """
    told = ~np.isnan(values)
    least, most = float(values[told].min()), float(values[told].max())
    bounds = np.linspace(least, most, _LEVELS + 1)
    red_green_blue = ramp(np.linspace(0, 1, _LEVELS)).tolist()
    colors = [(red, green, blue) for red, green, blue in red_green_blue]
    classes = [PictureClass("none", PLAIN)]
    for low, high, color in zip(bounds, bounds[1:], colors, strict=False):
        classes.append(PictureClass(f"{low:.4g} to {high:.4g} {unit}", color))
    log_classes(stream, f"{path}/heat", classes)
    level = np.clip(np.searchsorted(bounds, values, side="right"), 1, _LEVELS)
    picture = np.where(told, level, 0).astype(np.uint8)
    stream.log(f"{path}/heat", rr.SegmentationImage(picture), static=True)
    _log_labels(stream, f"{path}/labels", values, rows, columns, margin)

    shown = np.linspace(_LEVELS, 0, _LEGEND_ROWS).round().astype(int).tolist()
    return [
        LegendEntry(row, f"{bounds[at]:.3g} {unit}", colors[min(at, _LEVELS - 1)])
        for row, at in enumerate(shown)
    ]


def matrix_view(
    path: str, name: str, shape: tuple[int, int], margin: float = 1.0
) -> rrb.Spatial2DView:
    """A view of a heat map with so many rows and columns."""
    rows, columns = shape
    return rrb.Spatial2DView(
        origin=path,
        name=name,
        background=OBSTACLE,
        visual_bounds=rrb.VisualBounds2D(
            x_range=[-margin, columns + 0.3], y_range=[-1, rows + 0.3]
        ),
    )


def _log_labels(
    stream: rr.RecordingStream,
    path: str,
    values: Float[np.ndarray, "rows columns"],
    rows: Sequence[str],
    columns: Sequence[str],
    margin: float,
) -> None:
    """Logs names and numbers, where there is space for them."""
    told = ~np.isnan(values)
    labels: list[tuple[str, float, float]] = []
    if len(rows) <= _MOST_NAMES:
        labels += [(name, -margin / 2, row) for row, name in enumerate(rows)]
    if len(columns) <= _MOST_NAMES:
        labels += [(name, column + 0.5, -0.8) for column, name in enumerate(columns)]
    if told.sum() <= _MOST_NUMBERS:
        labels += [
            (f"{values[row, column]:.3g}", column + 0.5, float(row))
            for row, column in np.argwhere(told).tolist()
        ]
    if labels:
        names = rr.Points2D(
            [(x, y + _HANG) for _, x, y in labels],
            labels=[text for text, _, _ in labels],
            colors=TEXT,
            radii=0.001,
            show_labels=True,
            draw_order=10,
        )
        stream.log(path, names, static=True)
