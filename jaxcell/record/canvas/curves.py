"""Curves of numbers over a whole timeline."""

from typing import Any, Literal

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Int, Num

from .palette import BELIEF, Color


_MIN_COUNT = 10


def log_curve(
    stream: rr.RecordingStream,
    path: str,
    values: Num[np.ndarray, "times"],
    timeline: str = "step",
    times: Int[np.ndarray, "times"] | None = None,
    **style: Any,
) -> None:
    """Log numbers over a timeline as a curve; `style` is passed to [`log_curve_style`][]."""
    times = np.arange(values.size) if times is None else times
    index = [rr.TimeColumn(timeline, sequence=times)]
    stream.send_columns(path, index, rr.Scalars.columns(scalars=values))
    log_curve_style(stream, path, **style)


def curve(
    stream: rr.RecordingStream,
    path: str,
    title: str,
    values: Num[np.ndarray, "times"],
    most: float | int | None = None,
    times: Int[np.ndarray, "times"] | None = None,
    **style: Any,
) -> rrb.TimeSeriesView:
    """Log a curve over the timeline `step`, and return a view of the curve.

    For `most` see [`curve_view`][]; `style` is passed to [`log_curve_style`][].
    """
    log_curve(stream, path, values, times=times, **style)
    return curve_view(path, title, values.size - 1 if times is None else int(times[-1]), most)


def log_curve_style(
    stream: rr.RecordingStream,
    path: str,
    color: Color = BELIEF,
    name: str | None = None,
    shape: Literal["Linear", "StepAfter", "StepBefore"] = "StepAfter",
    width: float = 2.0,
) -> None:
    """Log the style of a curve, by default a step function that changes at the logged times."""
    names = None if name is None else [name]
    line = rr.SeriesLines(colors=color, widths=width, interpolation_mode=shape, names=names)
    stream.log(path, line, static=True)


def curve_view(
    path: str,
    title: str,
    last: int | None,
    most: float | int | None = None,
    legend: bool = False,
    first: int = 0,
) -> rrb.TimeSeriesView:
    """Create a view of the curves at a path, over the whole timeline.

    `first` and `last` are the ends of the timeline; `last` is `None` while the recording grows.
    `most` is the largest value of the curves. If it is given, their axis begins at 0. If it is an
    `int`, the axis reaches at least 10, so that the viewer places ticks only at whole numbers.
    """
    boundary = rrb.TimeRangeBoundary
    end = boundary.infinite() if last is None else boundary.absolute(seq=max(last, first + 1))
    whole = rrb.TimeRange(start=boundary.absolute(seq=first), end=end)
    least = _MIN_COUNT if isinstance(most, int) else 1
    return rrb.TimeSeriesView(
        origin=path,
        name=title,
        axis_x=rrb.TimeAxis(view_range=whole),
        axis_y=None if most is None else rrb.ScalarAxis(range=(0, 1.05 * max(most, least))),
        plot_legend=rrb.PlotLegend(visible=legend),
    )
