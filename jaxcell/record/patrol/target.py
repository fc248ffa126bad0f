import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ...patrol import PatrolledMap
from ...patrol.map import Vulnerability
from ..canvas.map import CellMap
from ..canvas.marks import log_dots
from ..canvas.page import log_tab
from ..canvas.palette import BELIEF, CATEGORIES, FREE, KNOWN, NOT_FREE, TARGET, PictureClass, tint
from ..canvas.plot import Plot, ticks
from ..canvas.prose import described, numbers
from .sight import log_sight, place


_EXACT, _FITTED, _RUNS = FREE, CATEGORIES["orange"], BELIEF
# Widths of the lines of charts; lower lines are wider, so that they remain visible.
_THIN, _MIDDLE, _WIDE = 1.5, 3.0, 7.0
_MAX_BARS = 80
# The histogram ends at this quantile of arrivals.
_SHOWN = 0.95
_POINTS = 400


def log_target(map: CellMap, patrol: PatrolledMap) -> rrb.Container:
    """Log a tab that shows from which cells the target is seen, and the time until it is seen."""
    attack, stream = patrol.attack, map.stream
    classes = [
        NOT_FREE,
        PictureClass("out of view", FREE),
        PictureClass("in view", tint(BELIEF, 0.6)),
        PictureClass("boundary: a robot from outside sees it here first", tint(KNOWN, 0.2)),
    ]
    kind = 1 + attack.view.astype(np.uint8) + (attack.view & attack.boundary)
    picture = map.picture("target_view", classes, kind)
    target = np.array([attack.target])
    log_sight(map, patrol, "map/target_outline", target, BELIEF)
    log_dots(stream, "map/target_cell", map.xy(target), 0.3 * patrol.cells.cell, TARGET)
    legend = [*classes[1:], ("the target", TARGET)]
    legend += [("simulated: a share of the runs", _RUNS), ("exact law", _EXACT)]
    if attack.fit is not None:
        legend.append(("generalized lambda fit to the runs", _FITTED))
    names = [picture, "target_outline", "target_cell", "base/station", "base/label"]
    views = rrb.Horizontal(
        map.view("From where the target is seen", names),
        rrb.Vertical(_log_times(stream, attack), _log_captures(stream, attack)),
        column_shares=[4, 5],
    )
    return log_tab(stream, "target", "The target", views, _text(patrol), legend, rows=(5, 4))


def _log_times(stream: rr.RecordingStream, attack: Vulnerability) -> rrb.View:
    """Log the simulated, exact and fitted distributions of the time until the target is seen."""
    time = attack.arrival
    last = float(np.quantile(time, _SHOWN, method="lower"))
    if not np.isfinite(last):
        last = float(attack.attack_time.max())
    width = max(1, int(np.ceil((last + 1) / _MAX_BARS)))
    bounds = np.arange(0, last + 1 + width, width)
    counts, _ = np.histogram(time[np.isfinite(time)], bounds)
    bars = counts / (time.size * width)
    shown = min(attack.law.size, int(bounds[-1]))
    most_y = 1.1 * max(float(bars.max()), float(attack.law[:shown].max()))
    plot = Plot(stream, "target/times", float(bounds[-1]), most_y)
    about = "steps until a robot first sees the target", "probability of each number of steps"
    plot.axes(ticks(plot.most_x), ticks(most_y, 4), *about)
    plot.bars("simulated", bars, plot.most_x, _RUNS)
    # A whole number is in the middle of the part of the bar for this number.
    plot.line("exact", np.arange(shown) + 0.5, attack.law[:shown], _EXACT, _THIN)
    if attack.fit is not None:
        x = np.linspace(0, plot.most_x, _POINTS)
        # The fit uses intervals around whole numbers, so its probabilities are for these intervals.
        chance = attack.fit.cdf(x + 0.5) - attack.fit.cdf(x - 0.5)
        plot.line("fitted", x + 0.5, chance, _FITTED, _MIDDLE)
    return plot.view("How long it takes until a robot sees the target")


def _log_captures(stream: rr.RecordingStream, attack: Vulnerability) -> rrb.View:
    """Log the simulated, exact and fitted probabilities of capture, by duration of the attack."""
    most = int(attack.attack_time.max())
    plot = Plot(stream, "target/captures", float(most), 1.0)
    steps_taken = "steps that the attack takes (upright lines: the attack times)"
    plot.axes(ticks(most), ticks(1.0), steps_taken, "probability of capture")
    plot.marks("attack_times", attack.attack_time.tolist(), CATEGORIES["yellow"])
    steps = np.arange(most + 1, dtype=float)
    runs = np.searchsorted(np.sort(attack.arrival), steps, side="right") / attack.arrival.size
    plot.line("simulated", steps, runs, _RUNS, _WIDE)
    plot.line("exact", steps, np.cumsum(attack.law), _EXACT, _THIN)
    if attack.fit is not None:
        plot.line("fitted", steps, attack.fit.cdf(steps + 0.5), _FITTED, _MIDDLE)
    return plot.view("Whether the adversary is caught")


def _text(patrol: PatrolledMap) -> str:
    attack, fit = patrol.attack, patrol.attack.fit
    if fit is None:
        about = f"No generalized lambda distribution was fitted: {attack.failure}."
    else:
        about = f"A generalized lambda distribution was fitted to these:\n\n{numbers(fit)}"
    return f"""# How soon a robot sees the target

The robots {patrol.begun}, and do not see the cell at {place(patrol, attack.target)} at first. The
first that sees it catches the adversary.

The law of this time is computed **exactly**, and from {attack.arrival.size:,} simulated runs.
{about}

## Probability of capture

{described(attack, "attack_time", "exact", "simulated", "fitted")}

{numbers(attack, patrol.cells)}
"""
