import math
import os
from collections.abc import Sequence

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
import xarray as xr

from .blueprint import log_text, recording, send_blueprint
from .canvas.palette import BELIEF, PLAIN, TEXT, Color, mix
from .sweep_axes import QUANTILES, Axis, axes, means, pairs, statistics
from .sweep_heat import heat_view, log_heat, log_pair
from .sweep_text import sweep_text


_MOST_STEPS = 1000
_MOST_PAIRS = 6
_MOST_VARIABLES = 16
# A pixel of a heat map takes a byte; this keeps recordings far below 50 MB.
_PICTURE_BYTES = 16_000_000
# A whole axis plays in so many seconds.
_SECONDS = 30
_BESIDE = 3
_NUMBERS = "biuf"


def log_sweep(
    path: str | os.PathLike[str], dataset: xr.Dataset, *, failures: Sequence[str] = ()
) -> None:
    """Writes a Rerun recording of the result of a sweep: every parameter is a timeline.

    For each variable that is a number: along each parameter its least, median, and greatest value
    and quartiles among the members that share the value of the parameter, and heat maps of its mean
    over pairs of parameters; and a text that says what one sees. Values of a parameter past a
    thousand, or fewer where there are many heat maps, share steps with their neighbours.

    **Arguments:**

    - `path`: the file to write or replace; its name ends in `.rrd`.
    - `dataset`: the result, as `jaxcell.sweep.open_sweep` gives it. Variables with dimensions
        beside those of the sweep, and those past the sixteenth, are left out and named.
    - `failures`: what failed, a line each, shown in the text.

    **Raises:** `ValueError` if the dataset is none of a sweep, or has no variable to show.

    A result as `jaxcell.sweep.open_sweep` gives it:

        >>> import pathlib, tempfile
        >>> import xarray as xr
        >>> from jaxcell import record
        >>> values = {"status": ("angle", [1, 1, 1]), "groups": ("angle", [4, 2, 3])}
        >>> dataset = xr.Dataset(values, {"angle": [0, 45, 90]}, {"title": "Three angles"})
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = pathlib.Path(folder, "run.rrd")
        ...     record.log_sweep(path, dataset)
        ...     path.stat().st_size > 1000
        True
    """
    if "status" not in dataset:
        raise ValueError("dataset: expected the result of a sweep, which has a variable status")
    dimensions = dataset["status"].dims
    fit = [
        str(name)
        for name, one in dataset.data_vars.items()
        if name != "status" and one.dims == dimensions and one.dtype.kind in _NUMBERS
    ]
    shown = fit[:_MOST_VARIABLES]
    if not shown:
        raise ValueError("dataset: expected a variable with a number for each member")
    found = axes(dataset, _MOST_STEPS)
    number = max(len(pairs(found, _MOST_PAIRS)) * len(shown), 1)
    side = min(_MOST_STEPS, math.isqrt(_PICTURE_BYTES // number))
    spanned = pairs(axes(dataset, side), _MOST_PAIRS)
    place = {str(name): i for i, name in enumerate(dimensions)}
    done = dataset["status"].values == 1
    ranges = {}
    with recording(path, "sweep") as stream:
        for i, (across, up) in enumerate(spanned):
            log_pair(stream, f"pairs/{i}", across, up)
        for name in shown:
            values = dataset[name].values.astype(float)
            known = done & np.isfinite(values)
            ends = (values[known].min(), values[known].max()) if known.any() else (np.nan, np.nan)
            ranges[name] = (float(ends[0]), float(ends[1]), int(done.sum() - known.sum()))
            for axis in found:
                _log_series(stream, name, values, known, place[axis.dimension], axis)
            for i, pair in enumerate(spanned):
                places = (place[pair[0].dimension], place[pair[1].dimension])
                unit = str(dataset[name].attrs.get("units", ""))
                heat = means(values, known, places, pair)
                log_heat(stream, f"heat/{name}/{i}", heat, "" if unit == "1" else unit)
        left_out = [str(name) for name in dataset.data_vars if name not in (*shown, "status")]
        text = sweep_text(dataset, found, ranges, left_out, failures)
        log_text(stream, "text", text)
        layout = rrb.Horizontal(
            rrb.Tabs(*(_layout(name, dataset[name], spanned) for name in shown), name="Variables"),
            rrb.TextDocumentView(origin="text", name="What you see"),
            column_shares=[7, 3],
        )
        longest = max(found, key=lambda axis: (not axis.number, axis.steps))
        speed = max(2.0, float(np.ptp(longest.times)) / _SECONDS)
        send_blueprint(stream, layout, longest.timeline, speed)


def _log_series(
    stream: rr.RecordingStream,
    name: str,
    values: np.ndarray,
    known: np.ndarray,
    place: int,
    axis: Axis,
) -> None:
    """Logs the quantiles of a variable along an axis, or its value where members are alone."""
    steps, rows, alone = statistics(values, known, place, axis)
    index = [rr.TimeColumn(axis.timeline, sequence=axis.times[steps])]
    lines = {"value": rows[0]} if alone else dict(zip(QUANTILES, rows, strict=True))
    for label, row in lines.items():
        path = f"series/{name}/{label.replace(' ', '_')}"
        style = rr.SeriesLines(
            colors=_COLORS[label], widths=2.5 if label in ("median", "value") else 1.2, names=label
        )
        stream.log(path, style, static=True)
        stream.send_columns(path, index, rr.Scalars.columns(scalars=row))


_COLORS: dict[str, Color] = {
    "value": BELIEF,
    "median": mix(BELIEF, TEXT, 0.25),
    "quarter": mix(BELIEF, TEXT, 0.55),
    "three quarters": mix(BELIEF, TEXT, 0.55),
    "least": PLAIN,
    "most": PLAIN,
}


def _layout(name: str, variable: xr.DataArray, spanned: list[tuple[Axis, Axis]]) -> rrb.Container:
    """What shows a variable: its series, and its heat maps below."""
    meaning = str(variable.attrs.get("long_name", name))
    unit = variable.attrs.get("units", "1")
    series = rrb.TimeSeriesView(
        origin=f"series/{name}",
        name=meaning if unit == "1" else f"{meaning}, in {unit}",
        plot_legend=rrb.PlotLegend(visible=True, corner=rrb.Corner2D.RightTop),
    )
    heats = [
        heat_view(f"mean by {across.name} and {up.name}", f"pairs/{i}", f"heat/{name}/{i}")
        for i, (across, up) in enumerate(spanned)
    ]
    if not heats:
        return rrb.Vertical(series, name=name)
    below = (
        heats[0]
        if len(heats) == 1
        else (rrb.Horizontal(*heats) if len(heats) <= _BESIDE else rrb.Tabs(*heats))
    )
    return rrb.Vertical(series, below, row_shares=[4, 5], name=name)
