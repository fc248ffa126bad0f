"""Tabs about the probability of capture: at each cell, and against unpredictability."""

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ...patrol import PatrolledMap
from ...patrol.map import Frontier
from ..canvas.map import CellMap
from ..canvas.marks import log_dots, log_labels
from ..canvas.page import log_tab
from ..canvas.palette import BELIEF, FREE, KNOWN, TARGET, Color
from ..canvas.plot import Plot, ticks
from ..canvas.prose import described
from ..canvas.scale import Scale
from .sight import BASE_VIEW


_WATCHED, _HIDDEN = "always in view of the base station", "out of sight for all robots"
_SPECIAL: dict[str, Color] = {_WATCHED: BASE_VIEW, _HIDDEN: FREE}


def log_vulnerability(map: CellMap, patrol: PatrolledMap) -> rrb.Container:
    """Log a tab that shows the probability of capture at each cell."""
    caught, contested = patrol.captures.probability[0], patrol.captures.contested
    half = 0.5 * patrol.cells.cell
    scale = Scale.over(caught[contested], "caught with probability {}".format, special=_SPECIAL)
    watched = np.zeros(patrol.cells.positions, bool)
    if patrol.regions is not None:
        watched = patrol.regions.view
    hidden = ~watched
    hidden[contested] = False
    special = {_WATCHED: watched, _HIDDEN: hidden}
    picture = map.picture("capture", scale.classes, scale.levels(caught, special))
    worst = int(contested[caught[contested].argmin()])
    x, y = patrol.xy[worst].tolist()
    at = np.array([worst])
    map.frames("worst_capture/frame", at, TARGET, half=half, width=3.0, order=40.0)
    label = f"most vulnerable: {caught[worst]:.3f}", x, y + 2.8 * half
    log_labels(map.stream, "map/worst_capture/label", [label], scale.colors[:1])
    view = map.view("Caught by these policies", [picture, "worst_capture/**", "base/station"])
    legend = scale.legend(shown=[name for name, where in special.items() if where.any()])
    steps = int(patrol.attack.attack_time[0])
    text = f"""# How vulnerable each cell is

The colour of a cell is the exact probability that an adversary who attacks it for {steps:,} steps
is caught by robots that {patrol.begun}. It knows the policies of the robots, but not their places:
it would attack the weakest cell. Robots that begin anywhere catch less at the first attack.

{described(patrol.captures, "attack_time", "weakest", "least", "mean", "least_at_first")}
"""
    title, sizes = "Vulnerability", {"shares": (8, 3), "rows": (5, 3)}
    return log_tab(map.stream, "vulnerability", title, view, text, legend, **sizes)


def log_frontier(stream: rr.RecordingStream, frontier: Frontier) -> rrb.Container:
    """Log a tab that shows the trade-off between capture and unpredictability as a curve."""
    most = 1.1 * max(float(frontier.entropy.max()), 1e-3)
    plot = Plot(stream, "frontier/curve", most, 1.0)
    about = "entropy of a step, in nats (mean over robots)", "least probability of capture"
    plot.axes(ticks(most), ticks(1.0), *about)
    order = np.argsort(frontier.entropy)
    plot.line("frontier", frontier.entropy[order], frontier.least_capture[order], BELIEF, 3.0)
    floors = plot.at(frontier.entropy, frontier.least_capture)
    log_dots(stream, "frontier/curve/floors", floors, 1.2, KNOWN)
    views = plot.view("Capture against entropy")
    legend = [("a floor of randomness", KNOWN), ("the most that was found", BELIEF)]
    chance = {"chance, at least": [f"{floor:.0%}" for floor in frontier.floor]}
    text = f"""# Capture against entropy

A patrol that captures most is nearly a tour, which an adversary can learn. Robots that choose a
neighbour uniformly in a share of their steps are harder to predict, and capture less. Each row is a
local optimum.

{described(frontier, "entropy", "least_capture", first=chance)}
"""
    return log_tab(stream, "frontier", "Frontier", views, text, legend, rows=(5, 4))
