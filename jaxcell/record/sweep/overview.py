import json
import math
import os
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
import xarray as xr

from ..canvas.curves import log_curve
from ..canvas.marks import points
from ..canvas.page import log_legend, log_tab
from ..canvas.palette import BELIEF, PLAIN, TEXT, Color, mix
from ..canvas.plot import Plot, ticks
from ..canvas.prose import made_with, table
from ..canvas.scale import Scale
from ..canvas.stream import recording, send_blueprint, send_changing
from .axes import QUANTILES, Axis, axes, means, pairs, statistics


_MAX_STEPS = 1000
_MAX_PAIRS = 6
_MAX_VARIABLES = 16
PICTURE_BYTES = 16_000_000
"""Largest total size of the heat maps of a recording, in bytes; a pixel has one byte."""
# Seconds in which the viewer plays a whole axis.
_SECONDS = 30
_MAX_BESIDE = 3
# The scale is geometric if the ratio of the largest to the least number is at least this.
_RATIO = 50
_TICKS_ACROSS, _TICKS_UP = 7, 6
_MAX_FAILURES = 20
_MAX_LETTERS = 80
_UNKNOWN = "none is done"
_COLORS: dict[str, Color] = {
    "value": BELIEF,
    "median": mix(BELIEF, TEXT, 0.25),
    "quarter": mix(BELIEF, TEXT, 0.55),
    "three quarters": mix(BELIEF, TEXT, 0.55),
    "least": PLAIN,
    "most": PLAIN,
}


def log_sweep(
    path: str | os.PathLike[str], dataset: xr.Dataset, *, failures: Sequence[str] = ()
) -> None:
    """Write a Rerun recording of the result of a sweep, in which every parameter is a timeline.

    Each member of a sweep is a run with its own parameters. For each numeric variable, curves show
    minimum, quartiles and maximum over the members at each value of a parameter, and heat maps show
    the mean over pairs of parameters. If a parameter has more than 1,000 values, adjacent values
    share a step of its timeline; with many heat maps this limit is lower.

    **Arguments:**

    - `path`: the file to write or replace; its name ends in `.rrd`.
    - `dataset`: the result from `jaxcell.sweep.open_sweep`. Variables with further dimensions, and
        variables after the sixteenth, are not shown; the text lists their names.
    - `failures`: a line per failure, which the text shows.

    **Raises:** `ValueError` if the dataset is not the result of a sweep, or has no variable to
    show.

    A sweep of three members:

        >>> import xarray as xr
        >>> from jaxcell import examples, record
        >>> values = {"status": ("angle", [1, 1, 1]), "groups": ("angle", [4, 2, 3])}
        >>> path = examples.folder() / "run.rrd"
        >>> record.log_sweep(path, xr.Dataset(values, {"angle": [0, 45, 90]}))
        >>> path.exists()
        True
    """
    if "status" not in dataset:
        raise ValueError("dataset: expected the result of a sweep, which has a variable status")
    status = dataset["status"]
    fit = [
        str(name)
        for name, variable in dataset.data_vars.items()
        if name != "status" and variable.dims == status.dims and variable.dtype.kind in "biuf"
    ]
    shown = fit[:_MAX_VARIABLES]
    if not shown:
        raise ValueError("dataset: expected a variable with a number for each member")
    all_axes = axes(dataset, _MAX_STEPS)
    pictures = max(len(pairs(all_axes, _MAX_PAIRS)) * len(shown), 1)
    side = min(_MAX_STEPS, math.isqrt(PICTURE_BYTES // pictures))
    spanned = pairs(axes(dataset, side), _MAX_PAIRS)
    longest = max(all_axes, key=lambda axis: (not axis.number, axis.steps))
    with recording(path, "sweep") as stream:
        for i, pair in enumerate(spanned):
            _log_pair(stream, f"pairs/{i}", *pair)
        tabs = [
            _log_variable(stream, dataset[name].astype(float).where(status == 1), all_axes, spanned)
            for name in shown
        ]
        text = _text(dataset, all_axes, shown, failures)
        variables = rrb.Tabs(*tabs, name="Variables")
        layout = log_tab(stream, "", "Sweep", variables, text, [])
        speed = max(2.0, float(np.ptp(longest.timeline.times)) / _SECONDS)
        send_blueprint(stream, [layout], longest.timeline.name, speed)


def _log_variable(
    stream: rr.RecordingStream,
    variable: xr.DataArray,
    all_axes: Sequence[Axis],
    spanned: Sequence[tuple[Axis, Axis]],
) -> rrb.Container:
    """Log the curves of a variable over each axis, and its heat maps over the pairs `spanned`."""
    name, values = str(variable.name), variable.values
    known = np.isfinite(values)
    place = {str(dimension): i for i, dimension in enumerate(variable.dims)}
    for axis in all_axes:
        steps, rows, alone = statistics(values, known, place[axis.dimension], axis)
        labels = ["value"] if alone else QUANTILES
        for label, row in zip(labels, rows, strict=False):
            path = f"series/{name}/{label.replace(' ', '_')}"
            at, width = axis.timeline.times[steps], 2.5 if label in ("median", "value") else 1.2
            style = {"color": _COLORS[label], "name": label, "shape": "Linear", "width": width}
            log_curve(stream, path, row, axis.timeline.name, at, **style)
    legend = rrb.PlotLegend(visible=True, corner=rrb.Corner2D.RightTop)
    title = _meaning(variable) or name
    series = rrb.TimeSeriesView(origin=f"series/{name}", name=title, plot_legend=legend)
    if not spanned:
        return rrb.Vertical(series, name=name)
    heats = [
        means(values, known, (place[across.dimension], place[up.dimension]), (across, up))
        for across, up in spanned
    ]
    scale = _scale(np.concatenate([heat.ravel() for heat in heats]), variable)
    views = []
    for i, ((across, up), heat) in enumerate(zip(spanned, heats, strict=True)):
        plot = Plot(stream, f"heat/{name}/{i}", float(across.steps), float(up.steps))
        levels = scale.levels(heat, {_UNKNOWN: np.isnan(heat)})
        plot.picture("picture", scale.classes, levels, plot.most_x, order=5.0)
        views.append(plot.view(f"mean by {across.name} and {up.name}", [f"/pairs/{i}/**"]))
    maps = rrb.Horizontal(*views) if len(views) <= _MAX_BESIDE else rrb.Tabs(*views)
    key = log_legend(stream, f"heat/{name}/legend", scale.legend())
    below = rrb.Horizontal(maps, key, column_shares=[2, 1])
    return rrb.Vertical(series, below, row_shares=[4, 5], name=name)


def _scale(means: np.ndarray, variable: xr.DataArray) -> Scale:
    known = means[np.isfinite(means)]
    wide = known.size and known.min() > 0 and known.max() > _RATIO * known.min()
    label = f"{{}} {_unit(variable)}".rstrip().format
    spaced = np.geomspace if wide else np.linspace
    return Scale.over(means, label, levels=64, spaced=spaced, special={_UNKNOWN: PLAIN})


def _log_pair(stream: rr.RecordingStream, path: str, across: Axis, up: Axis) -> None:
    """Log the axes of the heat maps over two parameters, with lines at the current values."""
    plot = Plot(stream, path, float(across.steps), float(up.steps))
    named = []
    for axis, most in (across, _TICKS_ACROSS), (up, _TICKS_UP):
        stride = max(1, int(ticks(axis.steps, most)[1]))
        named.append({i + 0.5: axis.labels[i] for i in range(0, axis.steps, stride)})
    plot.axes(named[0], named[1], across.name, up.name)
    x, y = np.arange(across.steps) + 0.5, np.arange(up.steps) + 0.5
    upright = np.stack([plot.at(x, 0.0), plot.at(x, plot.most_y)], axis=1)
    level = np.stack([plot.at(0.0, y), plot.at(plot.most_x, y)], axis=1)
    style = {"colors": TEXT, "radii": points(0.8), "draw_order": 20}
    for axis, strips in (across, upright), (up, level):
        slider = f"{path}/slider_{axis.name}"
        kind, columns, (line, at, _) = rr.LineStrips2D, list(strips), axis.timeline
        send_changing(stream, slider, kind, at, None, line, style=style, strips=columns)


def _unit(variable: xr.DataArray) -> str:
    unit = str(variable.attrs.get("units", "1"))
    return "" if unit == "1" else unit


def _meaning(variable: xr.DataArray) -> str:
    meaning, unit = str(variable.attrs.get("long_name", "")), _unit(variable)
    return ", ".join(filter(None, [meaning, unit and f"in {unit}"]))


def _text(
    dataset: xr.Dataset, all_axes: Sequence[Axis], shown: Sequence[str], failures: Sequence[str]
) -> str:
    status = dataset["status"]
    sizes = " x ".join(f"{status.sizes[name]:,} {name}" for name in status.dims)
    done, failed, undone = (int((status == state).sum()) for state in (1, 2, 0))
    states = [f"{done:,} are done"] if failed or undone else ["All are done"]
    states += [f"**{failed:,} failed**"] * (failed > 0)
    states += [f"**{undone:,} are not computed yet**"] * (undone > 0)
    timelines = [
        (f"`{axis.timeline.name}`", axis.timeline.meaning, axis.labels[0], axis.labels[-1])
        for axis in all_axes
    ]
    parts = [
        f"# {dataset.attrs.get('title', 'Sweep')}",
        f"A task was run for **{status.size:,} members** ({sizes}). {', '.join(states)}.",
        f"""## How to look

Each variable has a tab. Each parameter is a timeline: choose one at the bottom left.

{table(("timeline", "a time is", "from", "to"), timelines)}

- **Above**: median, quartiles, least and greatest value along that parameter.
- **Below**: means over pairs of parameters; grey if no member is done. The white line is the
  slider.

One member in detail: `jaxcell sweep view FOLDER --select NAME=VALUE`""",
        "## Variables\n\n"
        + table(("variable", "least", "most", "meaning"), _ranges(dataset, shown)),
    ]
    left_out = [f"`{name}`" for name in dataset.data_vars if name not in (*shown, "status")]
    if left_out:
        reason = "Not shown, because they have several numbers per member, or are too many: "
        parts.append(f"{reason}{', '.join(left_out)}.")
    if failures:
        lines = [f"- {failure}" for failure in failures[:_MAX_FAILURES]]
        lines += [f"- and {len(failures) - _MAX_FAILURES:,} more"] * (len(failures) > _MAX_FAILURES)
        parts.append("## Failures\n\n" + "\n".join(lines))
    return "\n\n".join([*parts, made_with(_made(dataset.attrs))])


def _ranges(dataset: xr.Dataset, shown: Sequence[str]) -> list[Sequence[str]]:
    """Return a table row per variable: its name, its least and largest value, and its meaning."""
    rows: list[Sequence[str]] = []
    for name in shown:
        values = dataset[name].values[dataset["status"].values == 1].astype(float)
        known = values[np.isfinite(values)]
        least, most = (known.min(), known.max()) if known.size else (np.nan, np.nan)
        meaning, infinite = _meaning(dataset[name]), values.size - known.size
        if infinite:
            meaning += f" (not finite, and not shown, for {infinite:,} members)"
        rows.append((f"`{name}`", f"{least:.6g}", f"{most:.6g}", meaning))
    return rows


def _made(attributes: Mapping[str, Any]) -> dict[str, str]:
    """Return the parameters and the software versions from the attributes of a sweep."""
    made: dict[str, str] = {}
    for field, value in json.loads(attributes.get("spec", "{}")).items():
        inside = value if isinstance(value, dict) else {"": value}
        for name, part in inside.items():
            text = json.dumps(part)
            text = text if len(text) <= _MAX_LETTERS else f"{text[: _MAX_LETTERS - 4]} ..."
            made[f"{field}.{name}".rstrip(".")] = text
    versions = ("jaxcell_version", "jax_version", "jax_enable_x64", "git_revision")
    return made | {name: str(attributes[name]) for name in versions if name in attributes}
