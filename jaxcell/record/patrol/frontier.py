import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ...patrol.map import Frontier
from ..canvas.marks import log_dots
from ..canvas.page import log_tab
from ..canvas.palette import BELIEF, KNOWN
from ..canvas.plot import Plot, ticks
from ..canvas.prose import described


def log_frontier(stream: rr.RecordingStream, frontier: Frontier) -> rrb.Container:
    """Log a tab that shows the trade-off between capture and unpredictability as a curve."""
    most = 1.1 * max(float(frontier.entropy.max()), 1e-3)
    plot = Plot(stream, "frontier/curve", most, 1.0)
    plot.axes(
        ticks(most),
        ticks(1.0),
        "entropy of a step, in nats (mean over robots)",
        "least probability of capture",
    )
    order = np.argsort(frontier.entropy)
    plot.line("frontier", frontier.entropy[order], frontier.least_capture[order], BELIEF, 3.0)
    floors = plot.at(frontier.entropy, frontier.least_capture)
    log_dots(stream, "frontier/curve/floors", floors, 1.2, KNOWN)
    views = plot.view("Capture against entropy")
    legend = [("a floor of randomness", KNOWN), ("the most that was found", BELIEF)]
    return log_tab(stream, "frontier", "Frontier", views, _text(frontier), legend, rows=(5, 4))


def _text(frontier: Frontier) -> str:
    chance = {"chance, at least": [f"{floor:.0%}" for floor in frontier.floor]}
    return f"""# Capture against entropy

A patrol that captures most is nearly a tour, which an adversary can learn. Robots that choose a
neighbour uniformly in a share of their steps are harder to predict, and capture less. Each row is a
local optimum.

{described(frontier, "entropy", "least_capture", first=chance)}
"""
