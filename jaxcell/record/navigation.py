import itertools
import math
import os
from collections.abc import Mapping
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Float, Int

from ..bounce import Plan
from ..space import CellSpace
from .blueprint import (
    bounds,
    extent,
    legend_view,
    log_classes,
    log_legend_style,
    log_legends,
    log_map,
    log_pictures,
    log_text,
    map_view,
    recording,
    send_blueprint,
)
from .canvas.palette import (
    BELIEF,
    CATEGORIES,
    CLEAR,
    GOAL,
    PLAIN,
    ROBOT,
    START,
    TEXT,
    TRAIL,
    Color,
    LegendEntry,
    PictureClass,
    ramp,
)
from .navigation_dataset import check_plan
from .pictures import on_squares
from .texts import describe, made_with


# In this order, so that few angles have none of the colours of the robot and its ends.
_ANGLES = [
    CATEGORIES[name]
    for name in ("orange", "sky blue", "pink", "yellow", "green", "blue", "vermilion")
]
_MOST_SHADES = 8
_MOST_ACTIONS = 60


def log_navigation(
    path: str | os.PathLike[str],
    cells: CellSpace,
    plan: Plan,
    *,
    spec: Mapping[str, Any] | None = None,
) -> None:
    """Writes a Rerun recording of a plan of a bouncing robot.

    Over the timeline `step`: the robot on its way, and the angle it turns by at each bump. The
    whole plan is there as arrows, with a colour for each angle. Over the timeline `direction`: the
    cells from which the goal can be reached; if there is no path, that is all there is to see.

    **Arguments:**

    - `path`: the file to write or replace; its name ends in `.rrd`.
    - `cells`: the cell space.
    - `plan`: the plan.
    - `spec`: what was asked for, shown in the text.

    **Raises:** `ValueError` if the plan is not of these cells.

    A corridor of three cells, and a robot that turns left at every bump:

        >>> import math
        >>> import pathlib
        >>> import tempfile
        >>> from jaxcell import bounce, record, space
        >>> room = space.Workspace([(0, 0), (3, 0), (3, 1), (0, 1)])
        >>> cells = space.CellSpace.of(room, 1.0, 4)
        >>> plan = bounce.plan(cells, [math.pi / 2], start=0, goal=5)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = pathlib.Path(folder, "run.rrd")
        ...     record.log_navigation(path, cells, plan)
        ...     path.stat().st_size > 1000
        True
    """
    check_plan(cells, plan)
    with recording(path, "navigation") as stream:
        log_map(stream, cells)
        _log_end(stream, cells, "start", plan.start, START)
        _log_end(stream, cells, "goal", plan.goal, GOAL)
        _log_reaching(stream, cells, plan)
        log_text(stream, "text", _text(cells, plan, spec or {}))
        reaching = _reaching_layout(cells)
        if plan.found:
            _log_plan(stream, cells, plan)
            _log_robot(stream, cells, plan)
            _log_series(stream, plan)
            tabs = rrb.Tabs(_plan_layout(cells, plan), reaching, active_tab=0)
            speed = float(np.clip(plan.actions.size / 20, 2, 30))
            send_blueprint(stream, tabs, "step", speed=speed)
        else:
            send_blueprint(stream, reaching, "direction", speed=max(2.0, cells.directions / 30))


def _log_end(
    stream: rr.RecordingStream, cells: CellSpace, name: str, cell: int, color: Color
) -> None:
    """Logs where the robot starts or is to be: a frame, its heading, and its name."""
    x, y, theta = (float(value) for value in cells.centre(cell))
    half = max(0.5 * cells.cell, 0.02 * extent(cells))
    frame = rr.Boxes2D(
        centers=[(x, y)],
        half_sizes=[(half, half)],
        colors=color,
        radii=rr.Radius.ui_points(3),
        draw_order=15,
    )
    stream.log(f"map/{name}/frame", frame, static=True)
    heading = half * np.array([math.cos(theta), math.sin(theta)])
    arrow = rr.Arrows2D(
        origins=[(x, y)], vectors=[heading], colors=color, radii=half / 8, draw_order=15
    )
    stream.log(f"map/{name}/heading", arrow, static=True)
    label = rr.Points2D(
        [(x, y - half)], labels=[name], colors=TEXT, radii=0.001, show_labels=True, draw_order=60
    )
    stream.log(f"map/{name}/label", label, static=True)


def _log_plan(stream: rr.RecordingStream, cells: CellSpace, plan: Plan) -> None:
    """Logs an arrow for each run and a dot for each bump, in the colours of their angles."""
    place = _places(cells, plan)
    bump = np.flatnonzero(plan.actions != 0)
    angle, number = np.unique(plan.bumps, return_inverse=True)
    colors = np.array([_ANGLES[i % len(_ANGLES)] for i in range(angle.size)], np.uint8)
    colors = colors.reshape(-1, 3)[number]

    # Arrows end where the dot begins.
    dot = max(0.2 * cells.cell, 0.011 * extent(cells))
    begin, end = np.append(0, bump + 1), np.append(bump, plan.actions.size)
    moves = begin < end
    vectors = (place[end] - place[begin])[moves]
    vectors *= 1 - dot / np.linalg.norm(vectors, axis=1, keepdims=True)
    runs = rr.Arrows2D(
        origins=place[begin[moves]],
        vectors=vectors,
        colors=np.concatenate([[TRAIL], colors]).astype(np.uint8)[moves],
        radii=rr.Radius.ui_points(2.5),
        draw_order=20,
    )
    stream.log("map/plan/runs", runs, static=True)

    # Where the robot bumps again, the dots are rings, the first one outermost.
    seen: dict[int, int] = {}
    again = np.empty(bump.size)
    for i, position in enumerate((plan.cells[bump] % cells.positions).tolist()):
        again[i] = seen[position] = seen.get(position, -1) + 1
    dots = rr.Points2D(
        place[bump],
        colors=colors,
        radii=dot * 0.7**again,
        draw_order=25,
    )
    stream.log("map/plan/bumps", dots, static=True)

    count = np.bincount(number, minlength=angle.size).tolist()
    legend = [
        LegendEntry(i, f"turn by {_degrees(one)}: {_times(count[i])}", _ANGLES[i % len(_ANGLES)])
        for i, one in enumerate(angle.tolist())
    ]
    marks = [("before the first bump", TRAIL), ("the robot", ROBOT)]
    marks += [("start", START), ("goal", GOAL)]
    legend += [LegendEntry(angle.size + i, *mark) for i, mark in enumerate(marks)]
    log_legend_style(stream, "plan/legend")
    log_legends(stream, "plan/legend", "step", np.array([0]), [legend])


def _log_robot(stream: rr.RecordingStream, cells: CellSpace, plan: Plan) -> None:
    """Logs the robot, its way since the bump before, and what it does at a bump."""
    place = _places(cells, plan)
    _, _, theta = cells.centre(plan.cells)
    length = max(0.8 * cells.cell, 0.045 * extent(cells))
    heading = length * np.stack([np.cos(theta), np.sin(theta)], axis=1)
    time = np.arange(len(place))
    index = [rr.TimeColumn("step", sequence=time)]
    # The middle of an arrow is at the robot, so that it lies in its square in any heading.
    arrows = rr.Arrows2D.columns(origins=place - heading / 2, vectors=heading)
    stream.send_columns("map/robot", index, arrows)
    style = rr.Arrows2D.from_fields(colors=ROBOT, radii=length / 8, draw_order=40)
    stream.log("map/robot", style, static=True)

    bump = np.flatnonzero(plan.actions != 0)
    since = np.append(0, bump)[np.searchsorted(bump, time)]
    trail = rr.LineStrips2D.columns(strips=np.stack([place[since], place], axis=1))
    stream.send_columns("map/trail", index, trail)
    line = rr.LineStrips2D.from_fields(colors=ROBOT, radii=rr.Radius.ui_points(4), draw_order=30)
    stream.log("map/trail", line, static=True)

    labels = [
        f"bump {i} of {bump.size}: turn by {_degrees(turn)}"
        for i, turn in enumerate(plan.bumps.tolist(), 1)
    ]
    told = rr.Points2D.columns(positions=place[bump], labels=labels)
    bumps = np.append(plan.actions != 0, False).astype(int)
    stream.send_columns("map/turn", index, told.partition(bumps))
    label = rr.Points2D.from_fields(colors=TEXT, radii=0.001, show_labels=True, draw_order=60)
    stream.log("map/turn", label, static=True)


def _log_series(stream: rr.RecordingStream, plan: Plan) -> None:
    """Logs how many bumps there were, and how many of these changed the angle."""
    bumped = plan.actions != 0
    changed = np.zeros(bumped.size, bool)
    changed[bumped] = np.append(False, np.diff(plan.bumps) != 0)[: plan.bumps.size]
    index = [rr.TimeColumn("step", sequence=np.arange(bumped.size + 1))]
    for name, what, color in (("bumps", bumped, BELIEF), ("changes", changed, ROBOT)):
        values = np.append(0, np.cumsum(what))
        stream.send_columns(f"plan/{name}", index, rr.Scalars.columns(scalars=values))
        line = rr.SeriesLines(colors=color, widths=2, interpolation_mode="StepAfter")
        stream.log(f"plan/{name}", line, static=True)


def _log_reaching(stream: rr.RecordingStream, cells: CellSpace, plan: Plan) -> None:
    """Logs from where the goal can be reached: in how many headings, and in one at a time."""
    reaching = plan.reaching.reshape(cells.directions, cells.positions)
    bound = _shades(cells)
    classes = [PictureClass("not free", CLEAR), PictureClass("from no heading", PLAIN)]
    colors = ramp(np.linspace(0, 1, bound.size - 1)).tolist()
    for low, high, (red, green, blue) in zip(bound[:-1] + 1, bound[1:], colors, strict=True):
        some = f"{high}" if low == high else f"{low} to {high}"
        label = f"from {some} of {cells.directions} headings"
        classes.append(PictureClass(label, (red, green, blue)))
    heat = 1 + np.searchsorted(bound, reaching.sum(axis=0))
    log_classes(stream, "map/grid/heat", classes)
    picture = rr.SegmentationImage(on_squares(cells, heat))
    stream.log("map/grid/heat", picture, static=True)

    one = [PictureClass("not free", CLEAR), PictureClass("not from here", PLAIN)]
    log_classes(stream, "map/grid/heading", [*one, PictureClass("from here", classes[-1].color)])
    log_legend_style(stream, "reaching/legend")
    every = np.arange(cells.directions)
    heading = plan.cells // cells.positions
    turns = np.flatnonzero(np.diff(heading, prepend=-1))
    for timeline, times, headings in (("direction", every, every), ("step", turns, heading[turns])):
        if timeline == "step" and not plan.found:
            continue
        shown = on_squares(cells, 1 + reaching[headings])
        log_pictures(stream, "map/grid/heading", timeline, times, shown)
        legends = [_reaching_legend(cells, classes, k) for k in headings.tolist()]
        log_legends(stream, "reaching/legend", timeline, times, legends)


def _shades(cells: CellSpace) -> Int[np.ndarray, "bounds"]:
    """Shade `s` stands for more than `bound[s - 1]` headings, and for no more than `bound[s]`."""
    shades = min(cells.directions, _MOST_SHADES)
    return np.arange(shades + 1) * cells.directions // shades


def _reaching_legend(
    cells: CellSpace, classes: list[PictureClass], heading: int
) -> list[LegendEntry]:
    """What the shades mean, and the colours for one heading."""
    entries = [LegendEntry(i, *shade) for i, shade in enumerate(classes[:0:-1])]
    degrees = f"{360 * heading / cells.directions:.4g}°"
    return [
        *entries,
        LegendEntry(len(classes), f"from here, heading {degrees}", classes[-1].color),
        LegendEntry(len(classes) + 1, f"not from here, heading {degrees}", PLAIN),
    ]


def _places(cells: CellSpace, plan: Plan) -> Float[np.ndarray, "visited 2"]:
    x, y, _ = cells.centre(plan.cells)
    return np.stack([x, y], axis=1)


def _plan_layout(cells: CellSpace, plan: Plan) -> rrb.Container:
    boundary = rrb.TimeRangeBoundary.absolute
    # From the start to the end, not what is near the time that is shown.
    whole = rrb.TimeRange(start=boundary(seq=0), end=boundary(seq=max(plan.actions.size, 1)))

    def plot(name: str, origin: str, most: int) -> rrb.TimeSeriesView:
        return rrb.TimeSeriesView(
            origin=origin,
            name=name,
            axis_x=rrb.TimeAxis(view_range=whole),
            axis_y=rrb.ScalarAxis(range=(0, 1.05 * max(most, 1))),
            plot_legend=rrb.PlotLegend(visible=False),
        )

    shown = ["plan/**", "start/**", "goal/**", "trail", "robot", "turn"]
    return rrb.Horizontal(
        rrb.Vertical(
            map_view(cells, "The plan", shown),
            rrb.Horizontal(
                plot("Bumps so far", "plan/bumps", plan.bumps.size),
                plot("Changes of the angle so far", "plan/changes", plan.changes),
            ),
            row_shares=[3, 1],
        ),
        rrb.Vertical(
            rrb.TextDocumentView(origin="text", name="What you see"),
            legend_view("plan/legend", plan.angles_used + 4),
            row_shares=[2, 1],
        ),
        column_shares=[3, 2],
        name="Plan",
    )


def _reaching_layout(cells: CellSpace) -> rrb.Container:
    ends = ["start/**", "goal/**"]
    return rrb.Horizontal(
        rrb.Vertical(
            map_view(cells, "From where the goal can be reached", ["grid/heat", *ends]),
            map_view(cells, "The same for one heading", ["grid/heading", *ends]),
        ),
        rrb.Vertical(
            rrb.TextDocumentView(origin="text", name="What you see"),
            legend_view("reaching/legend", _shades(cells).size + 4),
            row_shares=[3, 2],
        ),
        column_shares=[3, 2],
        name="Reaching the goal",
    )


def _text(cells: CellSpace, plan: Plan, spec: Mapping[str, Any]) -> str:
    """What the recording shows."""
    reaching = int(plan.reaching.sum())
    ends = "\n".join(
        f"- **{name}**: {_pose(cells, cell)}"
        for name, cell in (("start", plan.start), ("goal", plan.goal))
    )
    slider = (
        "The tab **Reaching the goal** shows from where the goal can be reached: above in how many "
        "headings, below in one of them. There the slider `direction` is of use: choose it at the "
        "bottom left, in the place of `step`."
        if plan.found
        else "Above you see from where it can be reached, and in how many headings; below for one "
        "heading, which the slider `direction` at the bottom chooses."
    )
    return f"""# From start to goal by bumps

A robot runs straight. Where it bumps it turns by one of its bouncing angles (counter-clockwise),
as the plan says, and runs on. It senses its bumps and counts its steps, and nothing else.

{ends}

{_outcome(plan)}

From **{reaching:,} of {cells.size:,} cells** the goal can be reached. {slider}

{describe(cells)}

{made_with(spec)}"""


def _outcome(plan: Plan) -> str:
    if not plan.found:
        return "**There is no path** from the start to the goal with these angles."
    if not plan.actions.size:
        return "The robot **is there already**."
    steps = plan.actions.size - plan.bumps.size
    changes = "never changes it" if plan.changes == 0 else f"changes it {_times(plan.changes)}"
    used = "one angle" if plan.angles_used == 1 else f"{plan.angles_used} different angles"
    bumps = (
        f"It bumps {_times(plan.bumps.size)}, uses {used}, and {changes}."
        if plan.bumps.size
        else "It does not bump on the way."
    )
    return f"""This plan is a cheapest one, with cost **{plan.cost:,}** and {steps:,} steps forward.
{bumps}

`{_action_string(plan)}`

Press play, or drag the slider `step` at the bottom. The vermilion arrow is the robot, with its way
since its last bump. Each other arrow is a run, in the colour of the angle that the robot turned by
before it, and each dot is a bump in that colour; where it bumps twice the second is inside the
first."""


def _action_string(plan: Plan) -> str:
    """Angles in degrees, and between them numbers of steps forward."""
    words = []
    for action, same in itertools.groupby(plan.actions.tolist()):
        count = len(list(same))
        if action == 0:
            words.append(f"{count} {'step' if count == 1 else 'steps'}")
        else:
            words += [_degrees(action)] * count
    more = len(words) - _MOST_ACTIONS
    return ", ".join(words[:_MOST_ACTIONS]) + (f", and {more:,} more" if more > 0 else "")


def _pose(cells: CellSpace, cell: int) -> str:
    x, y, theta = (float(value) for value in cells.centre(cell))
    return f"x = {x:.4g} m, y = {y:.4g} m, heading {_degrees(theta)}"


def _degrees(angle: float) -> str:
    return f"{math.degrees(angle):.6g}°"


def _times(count: int) -> str:
    return {1: "once", 2: "twice"}.get(count, f"{count:,} times")
