"""Heat maps of the results of a sweep over two of its parameters."""

import itertools

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Float

from .blueprint import log_classes
from .canvas.palette import OBSTACLE, PLAIN, TEXT, WALL, PictureClass, ramp
from .sweep_axes import Axis


_WIDTH, _HEIGHT = 160.0, 90.0
_LEFT, _RIGHT, _BELOW, _ABOVE = 26.0, 34.0, 20.0, 8.0
_LEVELS = 64
_LEGEND_STEPS = 8
_RATIO = 50
_TICKS_ACROSS, _TICKS_UP = 7, 6
_BAR = _WIDTH + 5.0
# A label hangs below its point.
_HANG = 2.5


def log_pair(stream: rr.RecordingStream, path: str, across: Axis, up: Axis) -> None:
    """Logs what the heat maps of two axes share: ticks, names, and where the sliders are."""
    x, y = _places(across.steps) * _WIDTH, -_places(up.steps) * _HEIGHT
    labels = [(across.labels[i], x[i], 6.0 - _HANG) for i in _ticks(across.steps, _TICKS_ACROSS)]
    labels += [(up.labels[i], -10.0, y[i] - _HANG) for i in _ticks(up.steps, _TICKS_UP)]
    labels.append((across.name, _WIDTH / 2, 13.0 - _HANG))
    labels.append((up.name, -10.0, -_HEIGHT - 5.0 - _HANG))
    _labels(stream, f"{path}/labels", labels)
    line = rr.LineStrips2D.from_fields(colors=TEXT, radii=rr.Radius.ui_points(0.8), draw_order=20.0)
    level = np.stack([np.stack([x, 0 * x], 1), np.stack([x, 0 * x - _HEIGHT], 1)], 1)
    upright = np.stack([np.stack([0 * y, y], 1), np.stack([0 * y + _WIDTH, y], 1)], 1)
    for axis, strips in (across, level), (up, upright):
        at = f"{path}/slider_{axis.name}"
        stream.log(at, line, static=True)
        index = [rr.TimeColumn(axis.timeline, sequence=axis.times)]
        columns = rr.LineStrips2D.columns(strips=list(strips)).partition([1] * axis.steps)
        stream.send_columns(at, index, columns)


def log_heat(
    stream: rr.RecordingStream, path: str, values: Float[np.ndarray, "up across"], unit: str
) -> None:
    """Logs the heat map of a variable, and what its colours mean; squares without value are NaN."""
    told = np.isfinite(values)
    least, most = (values[told].min(), values[told].max()) if told.any() else (0.0, 0.0)
    # Few large numbers would leave all others in one colour.
    spaced = np.geomspace if least > 0 and most > _RATIO * least else np.linspace
    bounds = spaced(least, most, _LEVELS + 1)
    colors = [(r, g, b) for r, g, b in ramp(np.linspace(0, 1, _LEVELS)).tolist()]
    classes = [PictureClass("no member that is done", PLAIN)]
    for low, high, color in zip(bounds, bounds[1:], colors, strict=False):
        classes.append(PictureClass(f"{_told(low)} to {_told(high)} {unit}", color))
    log_classes(stream, f"{path}/picture", classes)
    level = np.searchsorted(bounds[1:-1], np.where(told, values, least), side="right") + 1
    # The first row of a picture is the highest.
    picture = np.where(told, level, 0).astype(np.uint8)[::-1]
    stream.log(f"{path}/picture", rr.SegmentationImage(picture), static=True)
    rows, columns = values.shape
    scale = [_WIDTH / columns, _HEIGHT / rows, 1]
    stretch = rr.Transform3D(translation=[0, -_HEIGHT, 0], scale=scale)
    stream.log(f"{path}/picture", stretch, static=True)

    edges = np.linspace(0, -_HEIGHT, _LEVELS + 1)
    strips = [np.array([[_BAR, a], [_BAR, b]]) for a, b in itertools.pairwise(edges)]
    bar = rr.LineStrips2D(strips, colors=colors, radii=1.5)
    stream.log(f"{path}/bar", bar, static=True)
    shown = range(0, _LEVELS + 1, _LEVELS // _LEGEND_STEPS) if most > least else [0]
    labels = [(_told(bounds[at]), _BAR + 14.0, edges[at] - _HANG) for at in shown]
    _labels(stream, f"{path}/bounds", [*labels, (unit, _BAR + 8.0, 8.0 - _HANG)])


def heat_view(name: str, pair: str, heat: str) -> rrb.Spatial2DView:
    """A view of the heat map at a path, with what the maps of its pair of axes share."""
    return rrb.Spatial2DView(
        origin="/",
        name=name,
        contents=[f"+ /{pair}/**", f"+ /{heat}/**"],
        background=OBSTACLE,
        visual_bounds=rrb.VisualBounds2D(
            x_range=[-_LEFT, _WIDTH + _RIGHT], y_range=[-_HEIGHT - _ABOVE, _BELOW]
        ),
    )


def _places(steps: int) -> Float[np.ndarray, "steps"]:
    return (np.arange(steps) + 0.5) / steps


def _ticks(steps: int, most: int) -> list[int]:
    """Steps at regular places, at most so many."""
    least = -(-steps // most)
    round_ones = (scale * one for scale in (1, 10, 100, 1000) for one in (1, 2, 5))
    return list(range(0, steps, next(one for one in round_ones if one >= least)))


def _told(value: float) -> str:
    return f"{value:,.0f}" if 1000 <= abs(value) < 1e9 else f"{value:.3g}"


def _labels(stream: rr.RecordingStream, path: str, labels: list[tuple[str, float, float]]) -> None:
    text = rr.Points2D(
        [(x, y) for _, x, y in labels],
        labels=[text for text, _, _ in labels],
        colors=WALL,
        radii=0.001,
        show_labels=True,
        draw_order=40,
    )
    stream.log(path, text, static=True)
