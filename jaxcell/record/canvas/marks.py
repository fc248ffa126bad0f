"""Marks on maps and charts: labels, dots, arrows, lines and trails.

Marks are drawn over pictures. A mark with a higher `order` is drawn over other marks.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import rerun as rr
from jaxtyping import Float, Int

from .palette import BLACK, FREE, PLAIN, TEXT, Color, share_colors, text_on
from .stream import send_changing


MAX_CORNERS = 100
"""Largest number of corners of a trail. Without a limit, n steps would need n^2 corners in all."""
_LAST_STEPS = 4
LABEL: dict[str, Any] = {"colors": TEXT, "radii": 0.001, "show_labels": True}
"""Style of a label on a black background; Rerun attaches it to a point too small to be seen."""


def points(width: float) -> float:
    """Convert a width in screen points to a radius for Rerun."""
    return float(np.asarray(rr.Radius.ui_points(width)))


def log_labels(
    stream: rr.RecordingStream,
    path: str,
    labels: Sequence[tuple[str, float, float]],
    grounds: Sequence[Color] = (BLACK,),
    order: float = 60.0,
) -> None:
    """Log labels, each a text with its x and y; the viewer centres the text below this point.

    `grounds` is the colour behind each text, or one colour for all texts.
    """
    if labels:
        texts, x, y = zip(*labels, strict=True)
        style = {**LABEL, "colors": [text_on(one) for one in grounds], "draw_order": order}
        text = rr.Points2D(np.stack([x, y], axis=1), labels=texts, **style)
        stream.log(path, text, static=True)


def send_labels(
    stream: rr.RecordingStream,
    path: str,
    labels: Sequence[str],
    times: Int[np.ndarray, "times"],
    lengths: npt.ArrayLike | None = None,
    *,
    ground: Color = FREE,
    **columns: Any,
) -> None:
    """Log texts that change over the timeline `step`; `ground` is the colour behind them.

    The other arguments are those of [`send_changing`][].
    """
    style = {**LABEL, "colors": text_on(ground), "draw_order": 60.0}
    columns["labels"] = labels
    send_changing(stream, path, rr.Points2D, times, lengths, style=style, **columns)


def log_dots(
    stream: rr.RecordingStream,
    path: str,
    xy: npt.ArrayLike,
    radius: float | np.ndarray,
    color: Color | Sequence[Color],
    order: float = 40.0,
) -> None:
    """Log round marks, with one radius for all marks or a radius per mark."""
    stream.log(path, rr.Points2D(xy, colors=color, radii=radius, draw_order=order), static=True)


def log_lines(
    stream: rr.RecordingStream,
    path: str,
    strips: Sequence[npt.ArrayLike],
    color: Color,
    width: float = 1.5,
    order: float = 20.0,
) -> None:
    """Log lines; each of `strips` has the corners of a line, and `width` is in screen points."""
    lines = rr.LineStrips2D(list(strips), colors=color, radii=points(width), draw_order=order)
    stream.log(path, lines, static=True)


def log_shares(
    stream: rr.RecordingStream,
    path: str,
    ends: Float[np.ndarray, "lines 2 2"],
    level: Float[np.ndarray, "lines"],
    width: float,
) -> None:
    """Log lines whose width and colour show `level`, from 0 (thin, grey) to 1 (wide, yellow).

    `width` is half the width of the widest line, in units of the plane.
    """
    colors, radii = share_colors(level, PLAIN), width * (0.1 + 0.9 * level)
    stream.log(path, rr.LineStrips2D(ends, colors=colors, radii=radii, draw_order=15), static=True)


def log_arrows(
    stream: rr.RecordingStream,
    path: str,
    xy: npt.ArrayLike,
    vectors: npt.ArrayLike,
    color: Color | Sequence[Color],
    radius: float,
    order: float,
) -> None:
    arrows = rr.Arrows2D(origins=xy, vectors=vectors, colors=color, radii=radius, draw_order=order)
    stream.log(path, arrows, static=True)


def log_walker(
    stream: rr.RecordingStream,
    path: str,
    place: Float[np.ndarray, "times 2"],
    color: Color,
    radius: float,
    width: float = 3.0,
    rim: float | None = None,
) -> None:
    """Log a dot that is at `place[t]` in step t, and a line along its last steps.

    `width` is the width of the line in screen points; `rim` is its width including a light rim.
    """
    times = np.arange(len(place))
    trail = [place[max(0, time - _LAST_STEPS) : time + 1] for time in times]
    # A line needs two points, so the first line has its point twice.
    trail[0] = place[[0, 0]]
    for name, shown, wide, order in ("rim", TEXT, rim, 29.0), ("trail", color, width, 30.0):
        if wide is not None:
            style = {"colors": shown, "radii": points(wide), "draw_order": order}
            line = f"{path}/{name}"
            send_changing(stream, line, rr.LineStrips2D, times, style=style, strips=trail)
    style = {"colors": color, "radii": radius, "draw_order": 40}
    send_changing(stream, f"{path}/here", rr.Points2D, times, style=style, positions=place)
