"""A tab of a recording: its views, a legend of their colours, and a text."""

import itertools
import math
import re
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Float, Int

from .marks import LABEL
from .palette import CLEAR, OBSTACLE, Color, Level
from .stream import plane


_SECTION = re.compile(r"\n+(?=## )")
# Number of lines in a row of a colour bar.
_STRIPES = 8
# In screen points: the width of a letter, the largest height of a row, and of a legend.
_LETTER, _MAX_UNIT, _HEIGHT = 6.0, 40.0, 280.0

Legend: TypeAlias = Sequence[tuple[str, Color]]
"""The rows of a legend, each a text and a colour: a pair, a `PictureClass` or a `Level`."""


def log_tab(
    stream: rr.RecordingStream,
    path: str,
    name: str,
    views: rrb.Container | rrb.View | Sequence[rrb.View],
    text: str,
    legend: Legend | int,
    *,
    shares: tuple[int, int] = (7, 3),
    rows: tuple[int, int] = (3, 2),
) -> rrb.Container:
    """Log a tab: views on the left, a text and a legend on the right.

    **Arguments:**

    - `path`: the parent entity of the text and the legend; empty for the root.
    - `views`: the views on the left. Several form a grid; a free place in it shows the legend.
    - `text`: the text in Markdown; it may be empty if there is a legend.
    - `legend`: the meanings of the colours, or an empty list; or the number of rows of a legend
        that changes over time, which [`log_legends`][] logs.
    - `shares`: the shares of the width for the left and the right side.
    - `rows`: the shares of the height for the text and for the legend.
    """
    below = f"{path}/" if path else ""
    side: list[rrb.View | rrb.Container] = [log_text(stream, f"{below}text", text)] if text else []
    where = f"{below}legend"
    key: list[rrb.View]
    if isinstance(legend, int):
        key = [_legend_view(where, legend)]
    else:
        key = [log_legend(stream, where, legend)] if legend else []
    if isinstance(views, Sequence):
        columns = math.ceil(math.sqrt(len(views) or 1))
        if side and len(views) % columns:
            views, key = rrb.Grid(*views, *key, grid_columns=columns), []
        else:
            views = rrb.Grid(*views, grid_columns=columns)
    side += key
    beside = rrb.Vertical(*side, row_shares=list(rows)) if len(side) > 1 else side[0]
    return rrb.Horizontal(views, beside, column_shares=list(shares), name=name)


def log_text(stream: rr.RecordingStream, path: str, text: str) -> rrb.View | rrb.Container:
    """Log a text in Markdown, and return a view of it with a tab for each section."""
    views = []
    for i, part in enumerate(_SECTION.split(text)):
        heading, _, _ = part.partition("\n")
        where = f"{path}/{i}"
        stream.log(where, rr.TextDocument(part, media_type="text/markdown"), static=True)
        name = heading.removeprefix("## ") if i else "What you see"
        views.append(rrb.TextDocumentView(origin=where, name=name))
    return views[0] if len(views) == 1 else rrb.Tabs(*views, active_tab=0)


def log_legend(stream: rr.RecordingStream, path: str, legend: Legend) -> rrb.View:
    """Log a legend that does not change over time, and return a view of the legend."""
    log_legends(stream, path, [legend])
    return _legend_view(path, len(legend))


def log_legends(
    stream: rr.RecordingStream,
    path: str,
    legends: Sequence[Legend],
    timeline: str | None = None,
    times: Int[np.ndarray, "legends"] | None = None,
) -> None:
    """Log the swatches and the meanings of one legend per time, or of one legend for all times."""
    stream.log(f"{path}/text", rr.Points2D.from_fields(**LABEL), static=True)
    index = []
    if timeline is not None and times is not None:
        index = [rr.TimeColumn(timeline, sequence=times)]
    drawn = [_swatches(legend) for legend in legends]
    at, shades, radii = (np.array(one) for one in zip(*itertools.chain(*drawn), strict=True))
    ends = np.stack(np.broadcast_arrays(0.0, at, 0.5, at), axis=1).reshape(-1, 2, 2)
    colors = shades.round().astype(np.uint8)
    swatch = rr.LineStrips2D.columns(strips=ends, colors=colors, radii=radii)
    stream.send_columns(f"{path}/swatch", index, swatch.partition([*map(len, drawn)]))
    lengths = [len(legend) for legend in legends]
    labels = [label for legend in legends for label, _ in legend]
    # The viewer centres a label under its point. The width of a label does not depend on the scale.
    unit = min(_MAX_UNIT, _HEIGHT / (max(lengths) + 0.6))
    middle = 0.9 + np.array([len(label) for label in labels]) * _LETTER / unit / 2
    row = np.concatenate([np.arange(length) for length in lengths])
    text = rr.Points2D.columns(positions=np.stack([middle, row - 0.4], axis=1), labels=labels)
    stream.send_columns(f"{path}/text", index, text.partition(lengths))


def _swatches(legend: Legend) -> list[tuple[float, Float[np.ndarray, "4"], float]]:
    """Return the row, colour and radius of each line in the swatches of a legend.

    The swatch of a colour is one line, and that of a level several lines of gradual shades.
    """
    # Transparent colours get the colour of the ground, because they would be drawn black.
    shown = [OBSTACLE if one == CLEAR else one for _, one in legend]
    color = np.array([(*one, 255)[:4] for one in shown], float)
    levels = {row for row, one in enumerate(legend) if isinstance(one, Level)}
    lines = []
    for row in range(len(legend)):
        if row not in levels:
            lines.append((float(row), color[row], 0.32))
            continue
        for away in ((np.arange(_STRIPES) + 0.5) / _STRIPES - 0.5).tolist():
            other = row + (1 if away > 0 else -1)
            other = other if other in levels else row
            shade = color[row] + abs(away) * (color[other] - color[row])
            lines.append((row + away, shade, 0.6 / _STRIPES))
    return lines


def _legend_view(path: str, rows: int) -> rrb.Spatial2DView:
    return plane(path, "Legend", (-0.7, -0.8, 10, rows - 0.2), ground=OBSTACLE)
