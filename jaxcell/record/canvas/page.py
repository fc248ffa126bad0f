"""A tab of a recording: its views, a legend of their colours, and a text."""

import math
from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Int

from .marks import LABEL
from .palette import Color
from .stream import plane


_ONCE = np.zeros(1, np.int64)

Legend: TypeAlias = Sequence[tuple[str, Color]]
"""What colours mean, row by row; classes of pictures are entries too."""


def log_tab(
    stream: rr.RecordingStream,
    path: str,
    name: str,
    views: rrb.Container | rrb.View | Sequence[rrb.View],
    text: str,
    legend: Legend,
    *,
    timeline: str = "step",
    **layout: Any,
) -> rrb.Container:
    """Log the text and the legend of a tab, and lay it out.

    **Arguments:** those of [`lay_out_tab`][], and

    - `text`: what one sees, in Markdown; empty for no text, if there is a legend.
    - `legend`: what the colours mean; none for no legend.
    - `timeline`: one that the recording has.
    """
    below = f"{path}/" if path else ""
    if text:
        log_text(stream, f"{below}text", text)
    if legend:
        log_legend(stream, f"{below}legend", legend, timeline)
    return lay_out_tab(path, name, views, len(legend), text=bool(text), **layout)


def lay_out_tab(
    path: str,
    name: str,
    views: rrb.Container | rrb.View | Sequence[rrb.View],
    legend: int,
    *,
    text: bool = True,
    shares: tuple[int, int] = (7, 3),
    rows: tuple[int, int] = (3, 2),
) -> rrb.Container:
    """Lay out a tab: views on the left, its text and its legend on the right.

    **Arguments:**

    - `path`: what the text and the legend are under; empty for the recording as a whole.
    - `name`: what the tab is called.
    - `views`: what is on its left; several make a grid, and the legend fills a hole in it.
    - `text`: whether it has a text; without one it has a legend.
    - `legend`: how many rows the legend has; 0 for no legend.
    - `shares`: how much of the width the views and the rest have.
    - `rows`: how much of the height the text and the legend have.
    """
    below = f"{path}/" if path else ""
    about: list[rrb.View] = [text_view(f"{below}text")] if text else []
    key = [legend_view(f"{below}legend", legend)] if legend else []
    if isinstance(views, Sequence):
        columns = math.ceil(math.sqrt(len(views)))
        if text and len(views) % columns:
            views, key = rrb.Grid(*views, *key, grid_columns=columns), []
        else:
            views = rrb.Grid(*views, grid_columns=columns)
    about += key
    side = rrb.Vertical(*about, row_shares=list(rows)) if len(about) > 1 else about[0]
    return rrb.Horizontal(views, side, column_shares=list(shares), name=name)


def log_text(stream: rr.RecordingStream, path: str, text: str) -> None:
    """Log a text in Markdown."""
    stream.log(path, rr.TextDocument(text, media_type="text/markdown"), static=True)


def text_view(path: str) -> rrb.TextDocumentView:
    """A view of a text."""
    return rrb.TextDocumentView(origin=path, name="What you see")


def log_legend(
    stream: rr.RecordingStream, path: str, legend: Legend, timeline: str | None = None
) -> None:
    """Log what colours mean, at all times of one timeline or of all."""
    log_legends(stream, path, timeline, _ONCE, [legend])


def log_legends(
    stream: rr.RecordingStream,
    path: str,
    timeline: str | None,
    times: Int[np.ndarray, "legends"],
    legends: Sequence[Legend],
) -> None:
    """Log a column of swatches with their meanings for each time, or once without a timeline."""
    stream.log(f"{path}/swatch", rr.LineStrips2D.from_fields(radii=0.32), static=True)
    stream.log(f"{path}/text", rr.Points2D.from_fields(**LABEL), static=True)
    index = [] if timeline is None else [rr.TimeColumn(timeline, sequence=times)]
    lengths = [len(legend) for legend in legends]
    row = np.concatenate([np.arange(length) for length in lengths]).astype(float)
    left = np.stack([np.zeros_like(row), row], axis=-1)
    right = left + np.array([0.5, 0])
    labels, colors = zip(*(entry for legend in legends for entry in legend), strict=True)
    swatch = rr.LineStrips2D.columns(strips=np.stack([left, right], axis=1), colors=colors)
    stream.send_columns(f"{path}/swatch", index, swatch.partition(lengths))
    # The viewer writes a label centred under its point.
    text = rr.Points2D.columns(positions=right + np.array([5, -0.4]), labels=labels)
    stream.send_columns(f"{path}/text", index, text.partition(lengths))


def legend_view(path: str, rows: int) -> rrb.Spatial2DView:
    """A view of a legend of so many rows."""
    return plane(path, "Legend", (-0.7, -0.8, 10, rows - 0.2))
