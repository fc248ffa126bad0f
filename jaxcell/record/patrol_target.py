"""The cell that is attacked: who sees it, how soon a robot does, and how other cells compare."""

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Float

from .blueprint import (
    legend_view,
    log_classes,
    log_legend_style,
    log_legends,
    log_text,
    map_view,
)
from .canvas.palette import (
    BELIEF,
    CATEGORIES,
    CLEAR,
    FREE,
    KNOWN,
    TARGET,
    TEXT,
    Color,
    LegendEntry,
    PictureClass,
    mix,
    ramp,
)
from .canvas.plot import Plot, ticks
from .map_patrol import BASE_VIEW, MapPatrol
from .outlines import log_outline_style, log_outlines, outlines
from .patrol_map_text import target_text, vulnerability_text
from .pictures import on_squares


_ONCE = np.zeros(1, np.int64)
_EXACT, _FITTED, _RUNS = FREE, CATEGORIES["orange"], BELIEF
# Lines of the charts, wide enough for those on top to leave them visible.
_THIN, _MIDDLE, _WIDE = 1.5, 3.0, 7.0
_MOST_BARS = 80
# Later arrivals are not in the histogram.
_SHOWN = 0.95
_POINTS = 400
_LEVELS = 32
_LEGEND_ROWS = 7
_NEVER: Color = FREE


def log_target(stream: rr.RecordingStream, patrol: MapPatrol) -> rrb.Container:
    """Logs what is seen of the target, and the law of the time until a robot sees it."""
    attack = patrol.attack
    classes = [
        PictureClass("not free", CLEAR),
        PictureClass("out of view", FREE),
        PictureClass("in view", mix(BELIEF, FREE, 0.6)),
        PictureClass("boundary: a robot from outside sees it here first", mix(KNOWN, FREE, 0.2)),
    ]
    kind = (1 + attack.view + (attack.view & attack.boundary)).astype(np.uint8)
    log_classes(stream, "map/grid/target_view", classes)
    picture = rr.SegmentationImage(on_squares(patrol.cells, kind))
    stream.log("map/grid/target_view", picture, static=True)
    rings = outlines(patrol, np.array([attack.target]))
    log_outlines(stream, "map/target_outline", "step", _ONCE, rings)
    log_outline_style(stream, "map/target_outline", BELIEF)
    dot = rr.Points2D(
        patrol.xy[[attack.target]], colors=TARGET, radii=0.3 * patrol.cells.cell, draw_order=40
    )
    stream.log("map/target_cell", dot, static=True)
    entries = [(one.label, one.color) for one in classes[1:]]
    entries += [
        ("the target", TARGET),
        ("simulated: a share of the runs", _RUNS),
        ("exact law", _EXACT),
    ]
    if attack.fit is not None:
        entries.append(("generalized lambda fit to the runs", _FITTED))
    _log_legend(stream, "target/legend", [LegendEntry(i, *one) for i, one in enumerate(entries)])
    log_text(stream, "target/text", target_text(patrol))
    names = ["grid/target_view", "target_outline", "target_cell", "base/station", "base/label"]
    charts = [_log_times(stream, patrol), _log_captures(stream, patrol)]
    return rrb.Horizontal(
        rrb.Vertical(
            map_view(patrol.cells, "From where the target is seen", names),
            legend_view("target/legend", len(entries)),
            row_shares=[3, 2],
        ),
        rrb.Vertical(*charts),
        rrb.TextDocumentView(origin="target/text", name="What you see"),
        column_shares=[4, 5, 3],
        name="The target",
    )


def _log_times(stream: rr.RecordingStream, patrol: MapPatrol) -> rrb.View:
    """Logs the histogram of the simulated times with the exact law and the fit."""
    attack = patrol.attack
    time = np.asarray(attack.arrivals.time)
    last = float(np.quantile(time, _SHOWN, method="lower"))
    if not np.isfinite(last):
        last = float(attack.attack_times.max())
    width = max(1, int(np.ceil((last + 1) / _MOST_BARS)))
    bounds = np.arange(0, last + 1 + width, width)
    counts, _ = np.histogram(time[np.isfinite(time)], bounds)
    bars = counts / (time.size * width)
    shown = min(attack.law.size, int(bounds[-1]))
    most_y = 1.1 * max(float(bars.max()), float(attack.law[:shown].max()))
    plot = Plot(stream, "target/times", float(bounds[-1]), most_y)
    plot.axes(
        ticks(plot.most_x),
        ticks(most_y, 4),
        "steps until a robot first sees the target",
        "probability of each number of steps",
    )
    plot.bars("simulated", bars, plot.most_x, _RUNS)
    # A whole number is in the middle of the part of a bar that counts it.
    plot.line("exact", np.arange(shown) + 0.5, attack.law[:shown], _EXACT, _THIN)
    if attack.fit is not None:
        x = np.linspace(0, plot.most_x, _POINTS)
        # The fit is to intervals around whole numbers, and so are its probabilities.
        above, below = (np.asarray(attack.fit.law.cdf(x + half)) for half in (0.5, -0.5))
        plot.line("fitted", x + 0.5, above - below, _FITTED, _MIDDLE)
    return plot.view("How long it takes until a robot sees the target")


def _log_captures(stream: rr.RecordingStream, patrol: MapPatrol) -> rrb.View:
    """Logs the distribution functions, with the attack times."""
    attack = patrol.attack
    most = int(attack.attack_times.max())
    time = np.asarray(attack.arrivals.time)
    plot = Plot(stream, "target/captures", float(most), 1.0)
    plot.axes(
        ticks(most),
        ticks(1.0),
        "steps that the attack takes (upright lines: those asked for)",
        "probability of capture",
    )
    plot.marks("attack_times", attack.attack_times.tolist(), CATEGORIES["yellow"])
    steps = np.arange(most + 1, dtype=float)
    runs = np.searchsorted(np.sort(time), steps, side="right") / time.size
    plot.line("simulated", steps, runs, _RUNS, _WIDE)
    plot.line("exact", steps, np.cumsum(attack.law), _EXACT, _THIN)
    if attack.fit is not None:
        plot.line("fitted", steps, np.asarray(attack.fit.law.cdf(steps + 0.5)), _FITTED, _MIDDLE)
    return plot.view("Whether the adversary is caught")


def log_vulnerability(stream: rr.RecordingStream, patrol: MapPatrol) -> rrb.Container:
    """Logs the probability of capture at each cell, by the policies and by the best mixture."""
    maps = [("capture", "Caught by these policies", patrol.capture[0])]
    if patrol.game is not None:
        maps.append(("mixed", "Caught by the best mixture of shares", patrol.game.mixed))
    open_ = patrol.contested
    told = np.stack([caught[open_] for _, _, caught in maps])
    # A range of nothing has no levels.
    least, most = float(told.min()), max(float(told.max()), float(told.min()) + 1e-6)
    bounds = np.linspace(least, most, _LEVELS + 1)
    colors: list[Color] = [
        (red, green, blue) for red, green, blue in ramp(np.linspace(0, 1, _LEVELS)).tolist()
    ]
    views: list[rrb.View] = []
    for name, title, caught in maps:
        path = f"map/grid/{name}"
        log_classes(stream, path, _heat_classes(bounds, colors))
        level = np.clip(np.searchsorted(bounds, caught, side="right"), 1, _LEVELS)
        kind = np.full(caught.size, _LEVELS + 2)
        kind[open_] = level[open_]
        if patrol.regions is not None:
            kind[patrol.regions.view] = _LEVELS + 1
        picture = rr.SegmentationImage(on_squares(patrol.cells, kind.astype(np.uint8)))
        stream.log(path, picture, static=True)
        worst = int(open_[caught[open_].argmin()])
        _log_worst(stream, patrol, f"map/worst_{name}", worst, float(caught[worst]))
        contents = [f"grid/{name}", f"worst_{name}/**", "base/station"]
        views.append(map_view(patrol.cells, title, contents))
    base = np.zeros(patrol.cells.positions, bool) if patrol.regions is None else patrol.regions.view
    never = open_.size + int(base.sum()) < patrol.cells.positions
    shown = np.linspace(_LEVELS, 0, _LEGEND_ROWS).round().astype(int).tolist()
    entries = [(f"caught with probability {bounds[at]:.2f}", colors[min(at, 31)]) for at in shown]
    if patrol.regions is not None:
        entries.append(("always in view of the base station", BASE_VIEW))
    if never:
        entries.append(("out of sight for all robots", _NEVER))
    _log_legend(stream, "vulnerability/legend", [LegendEntry(i, *e) for i, e in enumerate(entries)])
    log_text(stream, "vulnerability/text", vulnerability_text(patrol))
    return rrb.Horizontal(
        *views,
        rrb.Vertical(
            rrb.TextDocumentView(origin="vulnerability/text", name="What you see"),
            legend_view("vulnerability/legend", len(entries)),
            row_shares=[5, 3],
        ),
        column_shares=[*[4] * len(views), 3],
        name="Vulnerability",
    )


def _heat_classes(bounds: Float[np.ndarray, "bounds"], colors: list[Color]) -> list[PictureClass]:
    classes = [PictureClass("not free", CLEAR)]
    for low, high, color in zip(bounds, bounds[1:], colors, strict=False):
        classes.append(PictureClass(f"caught with probability {low:.3f} to {high:.3f}", color))
    classes.append(PictureClass("always in view of the base station", BASE_VIEW))
    classes.append(PictureClass("out of sight for all robots", _NEVER))
    return classes


def _log_worst(
    stream: rr.RecordingStream, patrol: MapPatrol, path: str, worst: int, caught: float
) -> None:
    """Marks the cell where an adversary is caught least likely."""
    xy, cell = patrol.xy[worst], patrol.cells.cell
    frame = rr.Boxes2D(
        centers=[xy],
        half_sizes=[[0.5 * cell, 0.5 * cell]],
        colors=TARGET,
        radii=rr.Radius.ui_points(3),
        draw_order=40,
    )
    stream.log(f"{path}/frame", frame, static=True)
    label = rr.Points2D(
        [xy + np.array([0, 1.4 * cell])],
        labels=[f"most vulnerable: {caught:.3f}"],
        colors=TEXT,
        radii=0.001,
        show_labels=True,
        draw_order=60,
    )
    stream.log(f"{path}/label", label, static=True)


def _log_legend(stream: rr.RecordingStream, path: str, entries: list[LegendEntry]) -> None:
    log_legend_style(stream, path)
    log_legends(stream, path, "step", _ONCE, [entries])
