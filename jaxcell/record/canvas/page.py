"""A tab of a recording: its views, a legend of their colours, and a text."""

import math
from collections.abc import Sequence

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Int

from .palette import OBSTACLE, TEXT, Color, LegendEntry


_ONCE = np.zeros(1, np.int64)


def log_tab(
    stream: rr.RecordingStream,
    path: str,
    name: str,
    views: rrb.Container | rrb.View | Sequence[rrb.View],
    text: str,
    legend: Sequence[tuple[str, Color]],
    *,
    timeline: str = "step",
    shares: tuple[int, int] = (7, 3),
    rows: tuple[int, int] = (3, 2),
) -> rrb.Container:
    """Log the text and the legend of a tab, and lay it out.

    **Arguments:**

    - `path`: what the text and the legend are under; empty for the recording as a whole.
    - `name`: what the tab is called.
    - `views`: what is on its left; several make a grid, and the legend fills a hole in it.
    - `text`: what one sees, in Markdown.
    - `legend`: what the colours mean; none for no legend.
    - `timeline`: one that the recording has.
    - `shares`: how much of the width the views and the rest have.
    - `rows`: how much of the height the text and the legend have.
    """
    below = f"{path}/" if path else ""
    log_text(stream, f"{below}text", text)
    about: rrb.Container | rrb.View = text_view(f"{below}text")
    key = legend_view(f"{below}legend", len(legend))
    if legend:
        log_legend(stream, f"{below}legend", legend, timeline)
    if isinstance(views, Sequence):
        columns = math.ceil(math.sqrt(len(views)))
        if legend and len(views) % columns:
            grid = rrb.Grid(*views, key, grid_columns=columns)
            return rrb.Horizontal(grid, about, column_shares=list(shares), name=name)
        views = rrb.Grid(*views, grid_columns=columns)
    if legend:
        about = rrb.Vertical(about, key, row_shares=list(rows))
    return rrb.Horizontal(views, about, column_shares=list(shares), name=name)


def log_text(stream: rr.RecordingStream, path: str, text: str) -> None:
    """Log a text in Markdown."""
    stream.log(path, rr.TextDocument(text, media_type="text/markdown"), static=True)


def text_view(path: str) -> rrb.TextDocumentView:
    """A view of a text."""
    return rrb.TextDocumentView(origin=path, name="What you see")


def log_legend(
    stream: rr.RecordingStream, path: str, legend: Sequence[tuple[str, Color]], timeline: str
) -> None:
    """Log what colours mean, at all times."""
    rows = [LegendEntry(row, *entry) for row, entry in enumerate(legend)]
    log_legends(stream, path, timeline, _ONCE, [rows])


def log_legends(
    stream: rr.RecordingStream,
    path: str,
    timeline: str,
    times: Int[np.ndarray, "legends"],
    legends: Sequence[Sequence[LegendEntry]],
) -> None:
    """Log a column of swatches with their meanings for each time."""
    stream.log(f"{path}/swatch", rr.LineStrips2D.from_fields(radii=0.32), static=True)
    style = rr.Points2D.from_fields(colors=TEXT, radii=0.001, show_labels=True)
    stream.log(f"{path}/text", style, static=True)
    index = [rr.TimeColumn(timeline, sequence=times)]
    lengths = [len(legend) for legend in legends]
    entries = [entry for legend in legends for entry in legend]
    row = np.array([entry.row for entry in entries], float)
    left = np.stack([np.zeros_like(row), row], axis=-1)
    right = left + np.array([0.5, 0])
    swatch = rr.LineStrips2D.columns(
        strips=np.stack([left, right], axis=1), colors=[entry.color for entry in entries]
    )
    stream.send_columns(f"{path}/swatch", index, swatch.partition(lengths))
    # The viewer writes a label centred under its point.
    text = rr.Points2D.columns(
        positions=right + np.array([5, -0.4]), labels=[entry.label for entry in entries]
    )
    stream.send_columns(f"{path}/text", index, text.partition(lengths))


def legend_view(path: str, rows: int) -> rrb.Spatial2DView:
    """A view of a legend of so many rows."""
    return rrb.Spatial2DView(
        origin=path,
        name="Legend",
        background=OBSTACLE,
        visual_bounds=rrb.VisualBounds2D(x_range=[-0.7, 10], y_range=[-0.8, rows - 0.2]),
    )
