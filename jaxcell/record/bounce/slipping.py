from collections.abc import Mapping
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ...bounce import Slipped
from ..canvas.belief import arrows, belief_length, heat, heat_scale, log_belief_style
from ..canvas.curves import curve_view, log_curve
from ..canvas.map import CellMap
from ..canvas.marks import log_robot, points
from ..canvas.page import legend_view, log_legend, log_text
from ..canvas.palette import CATEGORIES, KNOWN, ROBOT, TRAIL
from ..canvas.prose import bouncing, counted, degrees, made_with
from ..canvas.stream import send_blueprint
from .localization import log_turns


_MAX_CORNERS = 100
_MAX_OBSERVATIONS = 240
_ROWS = 5


def log_slip(stream: rr.RecordingStream, found: Slipped, spec: Mapping[str, Any]) -> None:
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
    log_robot(
        stream,
        "map/robot",
        (found.pose[:, 0], found.pose[:, 1], found.pose[:, 2]),
        max(0.7 * cells.cell, 0.035 * map.extent),
        ROBOT,
        trail="map/trail",
        trail_color=TRAIL,
        corners=_MAX_CORNERS,
        middle=0.0,
        order=30.0,
    )
    marks = [picture, "belief", "likeliest", "trail", "robot", "candidates"]
    if len(found.bounces) > 1:
        log_turns(map, found.pose[:, :2], found.turned_by, found.bounces)
        marks.append("turn")
    legend = scale.legend(_ROWS, shown=[])
    log_legend(stream, "legend", legend)
    about = log_text(stream, "text", _text(found, spec))
    views: list[rrb.View | rrb.Container] = [
        rrb.Vertical(_view(map, marks), _curves(stream, found, last), row_shares=[7, 3])
    ]
    if len(found.smoothed):
        after = map.picture("smoothed", scale.classes, heat(found.smoothed), "step", steps)
        views.append(map.view("Where it was, by the whole run", [after, "trail", "robot"]))
    beside = rrb.Vertical(about, legend_view("legend", len(legend)), row_shares=[4, 1])
    tabs = [
        rrb.Horizontal(view, beside, column_shares=[3, 2], name=name)
        for view, name in zip(views, ("Belief", "Looking back"), strict=False)
    ]
    send_blueprint(stream, tabs, "step", float(np.clip(last / 20, 2, 30)))


def _view(map: CellMap, marks: list[str]) -> rrb.View:
    return map.view("Where the robot is, and where it takes itself to be", marks)


def _log_likeliest(map: CellMap, found: Slipped) -> None:
    """Log a frame around the likeliest cell, with its heading, and the candidates at the end."""
    stream, cells = map.stream, found.cells
    known = np.flatnonzero(found.likeliest >= 0)
    where = found.likeliest[known]
    index = [rr.TimeColumn("step", sequence=known)]
    half = np.full((where.size, 2), map.frame)
    columns = rr.Boxes2D.columns(centers=map.xy(where), half_sizes=half)
    stream.send_columns("map/likeliest", index, columns.partition(np.ones(where.size, int)))
    color = CATEGORIES["pink"]
    line = rr.Boxes2D.from_fields(colors=color, radii=points(2.0), draw_order=28)
    stream.log("map/likeliest", line, static=True)
    origins, vectors = arrows(cells, where, belief_length(cells))
    columns = rr.Arrows2D.columns(origins=origins, vectors=vectors)
    stream.send_columns("map/belief", index, columns.partition(np.ones(where.size, int)))
    log_belief_style(stream, cells)
    end = [rr.TimeColumn("step", sequence=[found.observations.size])]
    boxes = map.xy(found.candidates)
    half = np.full(boxes.shape, 0.9 * map.frame)
    columns = rr.Boxes2D.columns(centers=boxes, half_sizes=half)
    stream.send_columns("map/candidates", end, columns.partition([len(boxes)]))
    line = rr.Boxes2D.from_fields(colors=KNOWN, radii=points(2.5), draw_order=29)
    stream.log("map/candidates", line, static=True)


def _curves(stream: rr.RecordingStream, found: Slipped, last: int) -> rrb.Container:
    log_curve(stream, "belief/credible", found.credible)
    log_curve(stream, "belief/nowhere", found.nowhere, color=CATEGORIES["pink"])
    log_curve(
        stream,
        "robot/bumps",
        np.append(0, np.cumsum(found.observations)),
        color=ROBOT,
        shape="StepBefore",
    )
    most = int(found.credible.max())
    return rrb.Horizontal(
        curve_view("belief/credible", "Cells of the credible set, 95 %", last, most),
        curve_view("belief/nowhere", "Probability that it is nowhere", last, 1.0),
        curve_view("robot/bumps", "Bumps so far", last, int(np.sum(found.observations))),
    )


def _turning(found: Slipped) -> str:
    if len(found.bounces) == 1:
        return bouncing(float(found.bounces[0]))
    return (
        "A robot runs straight. Where it bumps it turns by one of its angles, "
        f"**{', '.join(map(degrees, found.bounces))}**, for the least entropy at the next bump."
    )


def _text(found: Slipped, spec: Mapping[str, Any]) -> str:
    word = found.word[:_MAX_OBSERVATIONS] + "..." * (len(found.word) > _MAX_OBSERVATIONS)
    if found.is_nowhere:
        end = "The belief says that the robot is **nowhere on this map**."
    else:
        truth = "among" if found.truth_is_a_candidate else "**not** among"
        end = (
            f"In the end {counted(found.candidates.size, 'cell')} hold it with probability 0.95; "
            f"the truth is {truth} them."
        )
    says = " At a bump it says which way it turns." * (len(found.bounces) > 1)
    return f"""# Where is a robot that slips?

{_turning(found)} Its steps and turns are off by {100 * found.slip.step:.3g} %. It makes
{len(found.word):,} observations (0: it moved, 1: it bumped):

`{word or "none"}`

{end}

## How to look

Press play, or drag `step` at the bottom.

- **colours**: how probable each position is, whatever the heading.
- **vermilion arrow**: the robot, unseen by the belief, and its trail.{says}
- **pink frame and blue arrow**: the likeliest cell.
- **green frames**, at the end: the credible set.

The tab **Looking back**: how probable each position was, given the whole run.

{made_with(spec, found.cells)}"""
