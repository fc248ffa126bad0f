"""Numbers that change over a timeline, as curves over the whole of it."""

from typing import Literal, TypeAlias

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Int, Num

from .palette import BELIEF, Color


_MIN_COUNT = 10

Shape: TypeAlias = Literal["Linear", "StepAfter", "StepBefore"]


def log_curve(
    stream: rr.RecordingStream,
    path: str,
    values: Num[np.ndarray, "times"],
    timeline: str = "step",
    times: Int[np.ndarray, "times"] | None = None,
    color: Color = BELIEF,
    name: str | None = None,
    shape: Shape = "StepAfter",
    width: float = 2.0,
) -> None:
    """Log a number at each time as a curve, by default of steps that begin at their times."""
    times = np.arange(values.size) if times is None else times
    index = [rr.TimeColumn(timeline, sequence=times)]
    stream.send_columns(path, index, rr.Scalars.columns(scalars=values))
    log_curve_style(stream, path, color, name, shape, width)


def log_curve_style(
    stream: rr.RecordingStream,
    path: str,
    color: Color = BELIEF,
    name: str | None = None,
    shape: Shape = "StepAfter",
    width: float = 2.0,
) -> None:
    """Log how a curve looks whose numbers are logged later."""
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
    """A view of the curves at a path, from the start to the end and not near one time.

    **Arguments:**

    - `last`: the last time; `None` while the recording grows.
    - `most`: the largest number, if the axis is to begin at 0 and end there. That of a count is an
        `int`, and its axis is so long that the viewer puts ticks at whole numbers only.
    - `legend`: whether to name the curves.
    - `first`: the first time.
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
