import os
from collections.abc import Mapping
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Int

from ..bounce import TeamTrajectory
from ..space import CellSpace
from .blueprint import (
    extent,
    log_classes,
    log_map,
    log_pictures,
    log_text,
    map_view,
    recording,
    send_blueprint,
)
from .canvas.palette import BELIEF, CLEAR, FREE, ROBOTS, Color, PictureClass, mix, robot_color
from .pictures import on_squares
from .team_dataset import check_team, first_visits
from .texts import describe, made_with


_MARK: Color = (0, 0, 0)
# Longer trajectories are shown at so many times, and at the end.
_MOST_TIMES = 20_000
_MOST_PICTURES = 500
# Corners of the trail behind each robot; all of them would hide the map.
_CORNERS = 6


def log_team(
    path: str | os.PathLike[str],
    cells: CellSpace,
    team: TeamTrajectory,
    *,
    spec: Mapping[str, Any] | None = None,
) -> None:
    """Writes a Rerun recording of a joint trajectory of several robots.

    Over the timeline `step`: the robots with the last corners of their trails, the positions that
    were visited, in the colour of the robot that came first, the robots that collide, and curves of
    the coverage, the collisions and the parts.

    **Arguments:**

    - `path`: the file to write or replace; its name ends in `.rrd`.
    - `cells`: the cell space.
    - `team`: the joint trajectory.
    - `spec`: what was asked for, shown in the text.

    **Raises:** `ValueError` if the trajectory is not of these cells.

    Two robots in a corridor of three cells:

        >>> import math
        >>> import pathlib
        >>> import tempfile
        >>> from jaxcell import bounce, record, space
        >>> room = space.Workspace([(0, 0), (3, 0), (3, 1), (0, 1)])
        >>> cells = space.CellSpace.of(room, 1.0, 4)
        >>> team = bounce.team_trajectory(cells, starts=[0, 5], bounces=math.pi / 2)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = pathlib.Path(folder, "run.rrd")
        ...     record.log_team(path, cells, team)
        ...     path.stat().st_size > 1000
        True
    """
    check_team(cells, team)
    steps, robots = team.bumped.shape
    stride = -(-steps // _MOST_TIMES) if steps else 1
    times = np.unique(np.append(np.arange(0, steps + 1, stride), steps))
    with recording(path, "team") as stream:
        log_map(stream, cells)
        _log_visited(stream, cells, team)
        for robot in range(robots):
            _log_robot(stream, cells, team.path[:, robot], robot, times)
        _log_collisions(stream, cells, team, times)
        _log_series(stream, team, times)
        log_text(stream, "text", _text(cells, team, stride, spec or {}))
        speed = max(4.0, steps / 60)
        send_blueprint(stream, _layout(cells, team), "step", speed=speed)


def _log_visited(stream: rr.RecordingStream, cells: CellSpace, team: TeamTrajectory) -> None:
    """Logs which robot came first to each square that was visited."""
    classes = [PictureClass("not visited", CLEAR)]
    for robot in range(min(team.path.shape[1], len(ROBOTS))):
        name, color = robot_color(robot)
        label = f"first visited by robot {robot} ({name})"
        classes.append(PictureClass(label, mix(color, FREE, 0.55)))
    log_classes(stream, "map/grid/visited", classes)

    time, visitor = first_visits(cells, team)
    changes = np.unique(time[time >= 0])
    shown = np.linspace(0, len(changes) - 1, min(len(changes), _MOST_PICTURES)).round().astype(int)
    changes = changes[shown]
    seen = (time >= 0) & (time <= changes[:, None])
    pictures = on_squares(cells, np.where(seen, 1 + visitor % len(ROBOTS), 0))
    log_pictures(stream, "map/grid/visited", "step", changes, pictures)


def _log_robot(
    stream: rr.RecordingStream,
    cells: CellSpace,
    path: Int[np.ndarray, "states"],
    robot: int,
    times: Int[np.ndarray, "times"],
) -> None:
    """Logs a robot and the trail behind it, which has its corners where the robot turned."""
    color = mix(robot_color(robot)[1], (0, 0, 0), 0.15)
    length = max(0.8 * cells.cell, 0.045 * extent(cells))
    x, y, theta = cells.centre(path)
    place = np.stack([x, y], axis=1)
    heading = length * np.stack([np.cos(theta), np.sin(theta)], axis=1)
    index = [rr.TimeColumn("step", sequence=times)]
    # The middle of an arrow is at the robot, so that it lies in its square in any heading.
    arrows = rr.Arrows2D.columns(origins=place[times] - heading[times] / 2, vectors=heading[times])
    stream.send_columns(f"map/robot_{robot}", index, arrows)
    style = rr.Arrows2D.from_fields(colors=color, radii=length / 8, draw_order=30)
    stream.log(f"map/robot_{robot}", style, static=True)

    corner = np.append(0, 1 + np.flatnonzero(np.diff(path // cells.positions)))
    trail = []
    passed = np.searchsorted(corner, times, side="right").tolist()
    for time, past in zip(times.tolist(), passed, strict=True):
        trail.append(place[np.append(corner[max(0, past - _CORNERS) : past], time)])
    stream.send_columns(f"map/trail_{robot}", index, rr.LineStrips2D.columns(strips=trail))
    line = rr.LineStrips2D.from_fields(colors=color, radii=rr.Radius.ui_points(1.5), draw_order=20)
    stream.log(f"map/trail_{robot}", line, static=True)


def _log_collisions(
    stream: rr.RecordingStream,
    cells: CellSpace,
    team: TeamTrajectory,
    times: Int[np.ndarray, "times"],
) -> None:
    """Marks the robots that collided since the time before."""
    move, robot = np.nonzero(team.collided)
    x, y, _ = cells.centre(team.path[move, robot])
    half = max(0.5 * cells.cell, 0.02 * extent(cells))
    boxes = rr.Boxes2D.columns(
        centers=np.stack([x, y], axis=1), half_sizes=np.full((move.size, 2), half)
    )
    # What happens in a move is seen when it has been made.
    marks = np.bincount(np.searchsorted(times, move + 1), minlength=times.size)
    stream.send_columns(
        "map/collisions", [rr.TimeColumn("step", sequence=times)], boxes.partition(marks)
    )
    line = rr.Boxes2D.from_fields(colors=_MARK, radii=rr.Radius.ui_points(2.5), draw_order=40)
    stream.log("map/collisions", line, static=True)


def _log_series(
    stream: rr.RecordingStream, team: TeamTrajectory, times: Int[np.ndarray, "times"]
) -> None:
    """Logs the numbers that change along the trajectory."""
    series = {
        "team/covered": team.covered,
        "team/collisions": np.append(0, np.cumsum(team.collisions)),
        "team/part": np.searchsorted(team.parts, np.arange(len(team.path)), side="right"),
    }
    for path, values in series.items():
        index = [rr.TimeColumn("step", sequence=times)]
        stream.send_columns(path, index, rr.Scalars.columns(scalars=values[times]))
        line = rr.SeriesLines(colors=BELIEF, widths=2, interpolation_mode="StepAfter")
        stream.log(path, line, static=True)


def _layout(cells: CellSpace, team: TeamTrajectory) -> rrb.Container:
    steps, robots = team.bumped.shape
    each = [f"{kind}_{robot}" for kind in ("trail", "robot") for robot in range(robots)]
    boundary = rrb.TimeRangeBoundary.absolute
    # From the start to the end, not what is near the time that is shown.
    whole = rrb.TimeRange(start=boundary(seq=0), end=boundary(seq=max(steps, 1)))

    def plot(name: str, origin: str, most: int) -> rrb.TimeSeriesView:
        return rrb.TimeSeriesView(
            origin=origin,
            name=name,
            axis_x=rrb.TimeAxis(view_range=whole),
            axis_y=rrb.ScalarAxis(range=(0, 1.05 * max(most, 1))),
            plot_legend=rrb.PlotLegend(visible=False),
        )

    return rrb.Horizontal(
        rrb.Vertical(
            map_view(
                cells,
                "The robots, and what they have visited",
                ["grid/visited", "collisions", *each],
            ),
            rrb.Horizontal(
                plot(
                    f"Positions visited (of {cells.positions:,})", "team/covered", cells.positions
                ),
                plot("Collisions so far", "team/collisions", int(team.collisions.sum())),
                plot("Part", "team/part", team.parts.size),
                column_shares=[2, 1, 1],
            ),
            row_shares=[7, 3],
        ),
        rrb.TextDocumentView(origin="text", name="What you see"),
        column_shares=[3, 2],
    )


def _text(cells: CellSpace, team: TeamTrajectory, stride: int, spec: Mapping[str, Any]) -> str:
    """What the recording shows."""
    steps, robots = team.bumped.shape
    rows = ["| robot | colour | starts at |", "| --- | --- | --- |"]
    for robot, z in enumerate(team.path[0].tolist()):
        x, y, theta = (float(value) for value in cells.centre(z))
        place = f"x = {x:.4g} m, y = {y:.4g} m, heading {np.rad2deg(theta):.4g}°"
        rows.append(f"| {robot} | {robot_color(robot)[0]} | {place} |")
    table = "\n".join(rows)
    left = team.uncovered.size
    covered = (
        f"**{team.covered[-1]:,} of {cells.positions:,} positions** in {steps:,} steps"
        if left
        else f"**all {cells.positions:,} positions** in **{steps:,} steps**"
    )
    every = f" Of so many steps every {stride:,}th is shown." if stride > 1 else ""
    return f"""# {robots} bouncing {"robot" if robots == 1 else "robots"}

Each runs straight. Where it bumps, into a wall or another robot, it stays and turns by its
bouncing angle, and runs on.

{describe(cells)}

They visit {covered}, with {int(team.bumped.sum()):,} bumps and {int(team.collisions.sum()):,}
collisions of two robots, in {team.parts.size:,} {"part" if team.parts.size == 1 else "parts"}. A
part ends when all robots together are as they were before, for then they would only repeat
themselves; the next begins with one robot turned by one direction. The search ended since
{team.outcome.value}.

{table}

## How to look

Press play, or drag the slider `step` at the bottom.{every}

- **arrows**: the robots, each with the last corners of its trail.
- **squares** in a pale colour were visited, first by the robot of that colour.
- **black frames**: robots that collided in the step before.
- **curves**: the positions visited so far, the collisions so far, and the part.

{made_with(spec)}"""
