import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ...bounce import Slipped
from ..canvas.belief import arrows, belief_length, heat, heat_scale, log_belief_style
from ..canvas.curves import curve_view, log_curve
from ..canvas.map import CellMap
from ..canvas.page import log_tab
from ..canvas.palette import CATEGORIES
from ..canvas.prose import Spec, bouncing, counted, degrees, made_with
from ..canvas.stream import pace, send_blueprint, send_changing
from .run import log_bumps, log_candidates, log_run, log_turns, observed


def log_slip(stream: rr.RecordingStream, found: Slipped, spec: Spec) -> None:
    """Log a robot that slips and is localized by a belief.

    Over the timeline `step`: the robot and its trail, how probable each position is, the likeliest
    cell, the size of the credible set, and how probable it is that the robot is nowhere.
    """
    cells, last = found.cells, found.observations.size
    steps = np.arange(last + 1)
    map = CellMap(stream, cells)
    scale = heat_scale()
    picture = map.picture("heat", scale.classes, heat(found.belief), "step", steps)
    _log_likeliest(map, found)
    log_run(map, (found.pose[:, 0], found.pose[:, 1], found.pose[:, 2]), order=30.0)
    log_candidates(map, found.candidates, last)
    marks = [picture, "belief", "likeliest", "trail", "robot", "candidates"]
    if len(found.bounces) > 1:
        turns = found.turned_by[found.turned_by >= 0]
        log_turns(map, found.pose[:, :2], found.turned_by >= 0, found.bounces[turns].tolist())
        marks.append("turn")
    seen = map.view("Where the robot is, and where it takes itself to be", marks)
    views = rrb.Vertical(seen, _curves(stream, found, last), row_shares=[7, 3])
    legend, text = scale.legend(shown=[]), _text(found, spec)
    tabs = [log_tab(stream, "", "Belief", views, text, legend, shares=(3, 2), rows=(3, 1))]
    if len(found.smoothed):
        after = map.picture("smoothed", scale.classes, heat(found.smoothed), "step", steps)
        view = map.view("Where it was, by the whole run", [after, "trail", "robot"])
        tabs.append(log_tab(stream, "smoothed", "Looking back", view, "", legend, shares=(7, 2)))
    send_blueprint(stream, tabs, "step", pace(last))


def _log_likeliest(map: CellMap, found: Slipped) -> None:
    """Log a frame around the likeliest cell, with its heading."""
    stream, cells = map.stream, found.cells
    known = np.flatnonzero(found.likeliest >= 0)
    where = found.likeliest[known]
    map.frames("likeliest", where, CATEGORIES["pink"], known, width=2.0, order=28.0)
    origins, vectors = arrows(cells, where, belief_length(cells))
    send_changing(stream, "map/belief", rr.Arrows2D, known, origins=origins, vectors=vectors)
    log_belief_style(stream, cells)


def _curves(stream: rr.RecordingStream, found: Slipped, last: int) -> rrb.Container:
    log_curve(stream, "belief/credible", found.credible)
    log_curve(stream, "belief/nowhere", found.nowhere, color=CATEGORIES["pink"])
    most = int(found.credible.max())
    return rrb.Horizontal(
        curve_view("belief/credible", "Cells of the credible set, 95 %", last, most),
        curve_view("belief/nowhere", "Probability that it is nowhere", last, 1.0),
        log_bumps(stream, found.observations),
    )


def _turning(found: Slipped) -> str:
    if len(found.bounces) == 1:
        return bouncing(float(found.bounces[0]))
    return (
        "A robot runs straight. Where it bumps it turns by one of its angles, "
        f"**{', '.join(map(degrees, found.bounces))}**, for the least entropy at the next bump."
    )


def _text(found: Slipped, spec: Spec) -> str:
    if found.is_nowhere:
        end = "The belief says that the robot is **nowhere on this map**."
    else:
        truth = "among" if found.truth_is_a_candidate else "**not** among"
        end = (
            f"In the end {counted(found.candidates.size, 'cell')} hold it with probability 0.95; "
            f"the truth is {truth} them."
        )
    return f"""# Where is a robot that slips?

{_turning(found)} Its steps and turns are off by {100 * found.slip.step:.3g} %. It makes
{len(found.word):,} observations (0: it moved, 1: it bumped):

`{observed(found.word)}`

{end}

## How to look

Press play, or drag `step` at the bottom.

- **colours**: how probable each position is, whatever the heading.
- **vermilion arrow**: the true robot, and its trail.
- **pink frame and blue arrow**: the likeliest cell.
- **green frames**, at the end: the credible set.

The tab **Looking back**: how probable each position was, given the whole run.

{made_with(spec, found.cells)}"""
