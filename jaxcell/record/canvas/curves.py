"""Numbers that change over a timeline, as curves over the whole of it."""

from typing import Literal

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Int, Num

from .palette import BELIEF, Color


def log_curve(
    stream: rr.RecordingStream,
    path: str,
    values: Num[np.ndarray, "times"],
    timeline: str = "step",
    times: Int[np.ndarray, "times"] | None = None,
    color: Color = BELIEF,
    name: str | None = None,
    shape: Literal["Linear", "StepAfter", "StepBefore"] = "StepAfter",
) -> None:
    """Log a number at each time as a curve, by default of steps that begin at their times."""
    times = np.arange(values.size) if times is None else times
    index = [rr.TimeColumn(timeline, sequence=times)]
    stream.send_columns(path, index, rr.Scalars.columns(scalars=values))
    line = rr.SeriesLines(
        colors=color,
        widths=2,
        interpolation_mode=shape,
        names=None if name is None else [name],
    )
    stream.log(path, line, static=True)


def curve_view(
    path: str, title: str, last: int, most: float | None = None, legend: bool = False
) -> rrb.TimeSeriesView:
    """A view of the curves at a path, from the start to the end and not near one time.

    **Arguments:**

    - `last`: the last time.
    - `most`: the largest number, if the axis is to begin at 0 and end there.
    - `legend`: whether to name the curves.
    """
    boundary = rrb.TimeRangeBoundary.absolute
    whole = rrb.TimeRange(start=boundary(seq=0), end=boundary(seq=max(last, 1)))
    return rrb.TimeSeriesView(
        origin=path,
        name=title,
        axis_x=rrb.TimeAxis(view_range=whole),
        axis_y=None if most is None else rrb.ScalarAxis(range=(0, 1.05 * max(most, 1))),
        plot_legend=rrb.PlotLegend(visible=legend),
    )
