import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ...bounce import Slipped
from ..canvas.belief import arrows, heat, heat_scale, log_belief_style
from ..canvas.curves import curve
from ..canvas.map import CellMap
from ..canvas.page import log_tab
from ..canvas.palette import CATEGORIES
from ..canvas.prose import Spec, bouncing, counted, degrees, made_with
from ..canvas.stream import pace, send_blueprint, send_changing
from .run import log_bumps, log_candidates, log_run, log_turns, observed


def log_slip(stream: rr.RecordingStream, slipped: Slipped, spec: Spec) -> None:
    """Record a robot that slips, and the belief that localizes it."""
    cells, last = slipped.cells, slipped.observations.size
    steps = np.arange(last + 1)
    map = CellMap(stream, cells)
    scale = heat_scale()
    picture = map.picture("heat", scale.classes, heat(slipped.belief), "step", steps)
    _log_likeliest(map, slipped)
    log_run(map, (slipped.pose[:, 0], slipped.pose[:, 1], slipped.pose[:, 2]), order=30.0)
    log_candidates(map, slipped.candidates, last)
    marks = [picture, "belief", "likeliest", "trail", "robot", "candidates"]
    if len(slipped.bounces) > 1:
        turns = slipped.turned_by[slipped.turned_by >= 0]
        log_turns(map, slipped.pose[:, :2], slipped.turned_by >= 0, slipped.bounces[turns].tolist())
        marks.append("turn")
    seen = map.view("The robot, and its belief", marks)
    title, most = "Cells of the credible set, 95 %", int(slipped.credible.max())
    nowhere, about = slipped.nowhere, "Probability of being nowhere"
    curves = rrb.Horizontal(
        curve(stream, "belief/credible", title, slipped.credible, most),
        curve(stream, "belief/nowhere", about, nowhere, 1.0, color=CATEGORIES["pink"]),
        log_bumps(stream, slipped.observations),
    )
    views = rrb.Vertical(seen, curves, row_shares=[7, 3])
    legend, text = scale.legend(shown=[]), _text(slipped, spec)
    tabs = [log_tab(stream, "", "Belief", views, text, legend, shares=(3, 2), rows=(3, 1))]
    if len(slipped.smoothed):
        after = map.picture("smoothed", scale.classes, heat(slipped.smoothed), "step", steps)
        view = map.view("Positions, given the whole run", [after, "trail", "robot"])
        tabs.append(log_tab(stream, "smoothed", "Looking back", view, "", legend, shares=(7, 2)))
    send_blueprint(stream, tabs, "step", pace(last))


def _log_likeliest(map: CellMap, slipped: Slipped) -> None:
    """Log a frame around the likeliest cell of each step, and an arrow along its heading."""
    stream, cells = map.stream, slipped.cells
    known = np.flatnonzero(slipped.likeliest >= 0)
    where = slipped.likeliest[known]
    map.frames("likeliest", where, CATEGORIES["pink"], known, width=2.0, order=28.0)
    origins, vectors = arrows(cells, where)
    send_changing(stream, "map/belief", rr.Arrows2D, known, origins=origins, vectors=vectors)
    log_belief_style(stream, cells)


def _turning(slipped: Slipped) -> str:
    if len(slipped.bounces) == 1:
        return bouncing(float(slipped.bounces[0]))
    return (
        "A robot runs straight. At a bump it turns by one of its angles, "
        f"**{', '.join(map(degrees, slipped.bounces))}**, for the least entropy at the next bump."
    )


def _text(slipped: Slipped, spec: Spec) -> str:
    if slipped.is_nowhere:
        end = "The belief says that the robot is **nowhere on this map**."
    else:
        truth = "among" if slipped.truth_is_a_candidate else "**not** among"
        end = (
            f"In the end {counted(slipped.candidates.size, 'cell')} hold it with probability 0.95; "
            f"the truth is {truth} them."
        )
    return f"""# Where is a robot that slips?

{_turning(slipped)} Its steps and turns are off by {100 * slipped.slip.step:.3g} %. It makes
{len(slipped.word):,} observations (0: it moved, 1: it bumped):

`{observed(slipped.word)}`

{end}

## How to look

Press play, or drag `step` at the bottom.

- **colours**: the probability of each position, summed over headings.
- **vermilion arrow**: the true robot, and its trail.
- **pink frame and blue arrow**: the likeliest cell.
- **green frames**, at the end: the credible set.

The tab **Looking back** shows the probability of each position, by the whole run.

{made_with(spec, slipped.cells)}"""
