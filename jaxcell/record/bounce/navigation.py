import itertools
import math

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Float

from ...base.formatting import configuration
from ...bounce import CostSummary, Plan
from ..canvas import palette
from ..canvas.curves import curve
from ..canvas.map import CellMap, directions_shown
from ..canvas.marks import log_arrows, log_dots, log_labels, points
from ..canvas.page import log_legends, log_tab
from ..canvas.palette import Color, PictureClass
from ..canvas.prose import Spec, counted, degrees, made_with, numbers, times
from ..canvas.scale import Scale
from ..canvas.stream import pace, send_blueprint
from .run import log_turns


_MAX_SHADES = 8
_NONE = "from no heading"
_MAX_ACTIONS = 60
_ENDS = ["start/**", "goal/**"]


def log_navigation(stream: rr.RecordingStream, result: Plan | CostSummary, spec: Spec) -> None:
    """Record a plan of a bouncing robot, or the costliest plan of a summary.

    If no plan was found, the recording shows only the cells from which the goal can be reached.
    """
    plan = result.costliest if isinstance(result, CostSummary) else result
    map = CellMap(stream, plan.cells)
    _log_end(map, "start", plan.start, palette.START)
    _log_end(map, "goal", plan.goal, palette.GOAL)
    text = _text(plan, spec)
    if plan.found:
        reached = f"""# Cells that reach the goal

From **{plan.cells_that_reach_the_goal:,} of {plan.cells.size:,} cells** the robot can reach the
goal, {configuration(plan.cells, plan.goal)}, with its bouncing angles.

{_REACHING}
"""
        tabs = [_log_plan(map, plan, text), _log_reaching(map, plan, "reaching", reached)]
        send_blueprint(stream, tabs, "step", pace(plan.actions.size))
    else:
        tab = _log_reaching(map, plan, "", text)
        send_blueprint(stream, [tab], "direction", pace(plan.cells.directions))


def _log_end(map: CellMap, name: str, cell: int, color: Color) -> None:
    """Log the start or goal: a frame around the square, an arrow for the heading, and a name."""
    place, half = map.xy(np.array([cell])), map.frame
    theta = float(map.cells.centre(cell)[2])
    heading = half * np.array([[math.cos(theta), math.sin(theta)]])
    map.frames(f"{name}/frame", np.array([cell]), color, width=3.0, order=15.0)
    log_arrows(map.stream, f"map/{name}/heading", place, heading, color, half / 8, order=15.0)
    at, ground = map.below(place[0], half)
    log_labels(map.stream, f"map/{name}/label", [(name, *at.tolist())], [ground])


def _log_plan(map: CellMap, plan: Plan, text: str) -> rrb.Container:
    """Log the plan, the robot that follows it, and the number of its bumps."""
    place = map.xy(plan.visited)
    legend = _log_runs(map, plan, place)
    poses = plan.robot_x, plan.robot_y, plan.robot_theta
    map.robot(poses, palette.ROBOT, corners=1, width=4.0, order=40.0)
    log_turns(map, place, np.append(plan.actions != 0, False), plan.turns.tolist())
    changed = np.append(False, np.diff(plan.turns) != 0)[: plan.bumps]
    views = []
    for name, title, turns, color in (
        ("bumps", "Bumps so far", np.ones(plan.bumps), palette.BELIEF),
        ("changes", "Changes of the angle so far", changed, palette.ROBOT),
    ):
        happens = np.zeros(len(plan.visited))
        happens[1:][plan.actions != 0] = turns
        most, path = int(happens.sum()), f"plan/{name}"
        views.append(curve(map.stream, path, title, np.cumsum(happens), most, color=color))
    shown = ["plan/**", *_ENDS, "trail", "robot", "turn"]
    left = rrb.Vertical(map.view("The plan", shown), rrb.Horizontal(*views), row_shares=[3, 1])
    return log_tab(map.stream, "", "Plan", left, text, legend, shares=(3, 2), rows=(2, 1))


def _log_runs(
    map: CellMap, plan: Plan, positions: Float[np.ndarray, "times 2"]
) -> list[tuple[str, Color]]:
    """Log an arrow per straight motion and a dot per bump; return the legend of the turns."""
    bump = np.flatnonzero(plan.actions != 0)
    angle, number, counts = np.unique(plan.turns, return_inverse=True, return_counts=True)
    colors = [palette.angle_color(i) for i in number.tolist()]

    # Arrows end where the dot begins.
    dot = max(0.2 * map.cells.cell, 0.011 * map.extent)
    begin, end = np.append(0, bump + 1), np.append(bump, plan.actions.size)
    moves = np.flatnonzero(begin < end)
    vectors = (positions[end] - positions[begin])[moves]
    vectors *= 1 - dot / np.linalg.norm(vectors, axis=1, keepdims=True)
    of_runs = [[palette.TRAIL, *colors][i] for i in moves.tolist()]
    starts = positions[begin[moves]]
    log_arrows(map.stream, "map/plan/runs", starts, vectors, of_runs, points(2.5), order=20.0)
    # Several bumps at one position are drawn as rings, with the first bump outside.
    seen: dict[int, int] = {}
    again = np.empty(bump.size)
    for i, position in enumerate((plan.visited[bump] % map.cells.positions).tolist()):
        again[i] = seen[position] = seen.get(position, -1) + 1
    log_dots(map.stream, "map/plan/bumps", positions[bump], dot * 0.7**again, colors, order=25.0)
    turns = enumerate(zip(angle.tolist(), counts.tolist(), strict=True))
    return [
        *((f"turn by {degrees(a)}: {times(n)}", palette.angle_color(i)) for i, (a, n) in turns),
        ("before the first bump", palette.TRAIL),
        ("the robot", palette.ROBOT),
        ("start", palette.START),
        ("goal", palette.GOAL),
    ]


def _log_reaching(map: CellMap, plan: Plan, path: str, text: str) -> rrb.Container:
    """Log a tab, below the entity `path`, that shows the cells from which the goal is reachable."""
    cells, below = map.cells, f"{path}/" if path else ""
    reaching, special = plan.reaches.sum(axis=0), {_NONE: palette.PLAIN}
    label = f"from {{}} of {cells.directions} headings".format
    scale = Scale.counting(1, cells.directions, label, levels=_MAX_SHADES, special=special)
    classes = scale.classes
    all_headings = map.picture("heat", classes, scale.levels(reaching, {_NONE: reaching == 0}))
    one = [classes[0], PictureClass("not from here", palette.PLAIN)]
    one.append(PictureClass("from here", classes[-1].color))
    shown = directions_shown(cells, plan.visited if plan.found else None)
    one_heading = map.by_direction("heading", one, 1 + plan.reaches, shown)
    shades = scale.legend(_MAX_SHADES)
    for timeline, (when, directions) in shown.items():
        headings = [f"heading {360 * k / cells.directions:.4g}°" for k in directions.tolist()]
        legends = [
            [*shades, *((f"{kind.label}, {heading}", kind.color) for kind in one[:0:-1])]
            for heading in headings
        ]
        log_legends(map.stream, f"{below}legend", legends, timeline, when)
    views = rrb.Vertical(
        map.view("Cells that reach the goal", [all_headings, *_ENDS]),
        map.view("The same for one heading", [one_heading, *_ENDS]),
    )
    rows = len(shades) + 2
    return log_tab(map.stream, path, "Reaching the goal", views, text, rows, shares=(3, 2))


_HOW_TO_LOOK = """## How to look

Press play, or drag `step` at the bottom.

- **vermilion arrow**: the robot, and its trail since its last bump.
- **other arrows**: runs, in the colour of the turn before them.
- **dots**: bumps, a second one inside the first.

The tab **Reaching the goal** shows the cells from which it can be reached."""
_REACHING = """- **Above**: the number of headings that reach the goal, from each square.
- **Below**: the squares that reach it with one heading, that of `direction`, or of the robot at
  `step`."""


def _text(plan: Plan, spec: Spec) -> str:
    look = _HOW_TO_LOOK if plan.actions.size else ""
    slider = "" if plan.found else _REACHING
    return f"""# From start to goal by bumps

A robot runs straight. At a bump it turns by the bouncing angle of the plan (counter-clockwise).

{_outcome(plan)}

{slider}

{numbers(plan)}

{look}

{made_with(spec, plan.cells)}"""


def _outcome(plan: Plan) -> str:
    if not plan.found:
        return "**There is no path** from the start to the goal with these angles."
    if not plan.actions.size:
        return "The robot **starts at the goal**."
    return f"""No plan is cheaper than this one, with cost **{plan.cost:,}**:

`{_action_string(plan)}`"""


def _action_string(plan: Plan) -> str:
    """Format a plan as turns in degrees, with the number of steps between turns."""
    words = []
    for action, same in itertools.groupby(plan.actions.tolist()):
        count = len(list(same))
        words += [counted(count, "step")] if action == 0 else [degrees(action)] * count
    more = len(words) - _MAX_ACTIONS
    return ", ".join(words[:_MAX_ACTIONS]) + (f", and {more:,} more" if more > 0 else "")
