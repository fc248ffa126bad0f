import os
from collections.abc import Mapping
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Int

from ...bounce import TeamTrajectory
from ..canvas.curves import curve_view, log_curve
from ..canvas.map import CellMap
from ..canvas.marks import log_robot, points
from ..canvas.page import log_tab
from ..canvas.palette import CLEAR, FREE, ROBOTS, Color, PictureClass, mix, robot_color
from ..canvas.prose import counted, describe, made_with, pose, table
from ..canvas.stream import recording, send_blueprint


_MARK: Color = (0, 0, 0)
# Longer trajectories are shown at so many times, and at the end.
_MAX_TIMES = 20_000
_MAX_PICTURES = 500


def log_team(
    team: TeamTrajectory, path: str | os.PathLike[str], *, spec: Mapping[str, Any] | None = None
) -> None:
    """Write a Rerun recording of a joint trajectory of several robots.

    Over the timeline `step`: the robots with the last corners of their trails, the positions that
    were visited, in the colour of the robot that came first, the robots that collide, and curves of
    the coverage, the collisions and the parts.

    **Arguments:**

    - `team`: the joint trajectory.
    - `path`: the file to write or replace; its name ends in `.rrd`.
    - `spec`: what was asked for, shown in the text.
    """
    stride = max(1, -(-team.steps // _MAX_TIMES))
    times = np.unique(np.append(np.arange(0, team.steps + 1, stride), team.steps))
    with recording(path, "team") as stream:
        map = CellMap(stream, team.cells)
        shown = [_log_visited(map, team), "collisions", *_log_robots(map, team, times)]
        _log_collisions(map, team, times)
        views = rrb.Vertical(
            map.view("The robots, and what they have visited", shown),
            _log_curves(stream, team, times),
            row_shares=[7, 3],
        )
        text = _text(team, stride, spec or {})
        tab = log_tab(stream, "", "Team", views, text, [], shares=(3, 2))
        send_blueprint(stream, tab, "step", max(4.0, team.steps / 60))


def _log_visited(map: CellMap, team: TeamTrajectory) -> str:
    """Log which robot came first to each square that was visited."""
    classes = [PictureClass("not visited", CLEAR)]
    for robot in range(min(team.starts.size, len(ROBOTS))):
        name, color = robot_color(robot)
        label = f"first visited by robot {robot} ({name})"
        classes.append(PictureClass(label, mix(color, FREE, 0.55)))
    changes = np.unique(team.first_visit[team.first_visit >= 0])
    shown = np.linspace(0, len(changes) - 1, min(len(changes), _MAX_PICTURES)).round().astype(int)
    changes = changes[shown]
    seen = (team.first_visit >= 0) & (team.first_visit <= changes[:, None])
    kind = np.where(seen, 1 + team.first_visitor % len(ROBOTS), 0)
    return map.picture("visited", classes, kind, "step", changes)


def _log_robots(map: CellMap, team: TeamTrajectory, times: Int[np.ndarray, "times"]) -> list[str]:
    """Log each robot and the trail behind it."""
    length = max(0.8 * map.cells.cell, 0.045 * map.extent)
    robots = range(team.starts.size)
    for robot in robots:
        poses = (
            team.robot_x[:, robot],
            team.robot_y[:, robot],
            team.robot_theta[:, robot],
        )
        color = mix(robot_color(robot)[1], (0, 0, 0), 0.15)
        log_robot(
            map.stream,
            f"map/robot_{robot}",
            poses,
            length,
            color,
            times=times,
            trail=f"map/trail_{robot}",
        )
    return [f"{kind}_{robot}" for kind in ("trail", "robot") for robot in robots]


def _log_collisions(map: CellMap, team: TeamTrajectory, times: Int[np.ndarray, "times"]) -> None:
    """Mark the robots that collided since the time before."""
    move, robot = np.nonzero(team.collided)
    centers = map.xy(team.cell[move, robot])
    boxes = rr.Boxes2D.columns(centers=centers, half_sizes=np.full(centers.shape, map.frame))
    # What happens in a move is seen when it has been made.
    marks = np.bincount(np.searchsorted(times, move + 1), minlength=times.size)
    index = [rr.TimeColumn("step", sequence=times)]
    map.stream.send_columns("map/collisions", index, boxes.partition(marks))
    style = rr.Boxes2D.from_fields(colors=_MARK, radii=points(2.5), draw_order=40)
    map.stream.log("map/collisions", style, static=True)


def _log_curves(
    stream: rr.RecordingStream, team: TeamTrajectory, times: Int[np.ndarray, "times"]
) -> rrb.Container:
    """Log the numbers that change along the trajectory."""
    part = np.searchsorted(team.part_begin, team.time, side="right")
    collisions = np.append(0, np.cumsum(team.collisions))
    views = []
    for name, title, values, most in (
        (
            "covered",
            f"Positions visited (of {team.cells.positions:,})",
            team.covered,
            team.cells.positions,
        ),
        ("collisions", "Collisions so far", collisions, team.collisions_in_all),
        ("part", "Part", part, team.parts),
    ):
        log_curve(stream, f"team/{name}", values[times], times=times)
        views.append(curve_view(f"team/{name}", title, team.steps, most))
    return rrb.Horizontal(*views, column_shares=[2, 1, 1])


def _text(team: TeamTrajectory, stride: int, spec: Mapping[str, Any]) -> str:
    """What the recording shows."""
    cells = team.cells
    rows = [
        (robot, robot_color(robot)[0], pose(cells, z))
        for robot, z in enumerate(team.starts.tolist())
    ]
    covered = (
        f"**{team.positions_covered:,} of {cells.positions:,} positions** in {team.steps:,} steps"
        if team.uncovered
        else f"**all {cells.positions:,} positions** in **{team.steps:,} steps**"
    )
    every = f" Of so many steps every {stride:,}th is shown." if stride > 1 else ""
    return f"""# {counted(len(rows), "bouncing robot")}

Each runs straight. Where it bumps, into a wall or another robot, it stays and turns by its
bouncing angle, and runs on.

{describe(cells)}

They visit {covered}, with {team.bumps:,} bumps and {team.collisions_in_all:,} collisions of two
robots, in {counted(team.parts, "part")}. A part ends when all robots together are as they were
before, for then they would only repeat themselves; the next begins with one robot turned by one
direction. The search ended since {team.meaning}.

{table(("robot", "colour", "starts at"), rows)}

## How to look

Press play, or drag the slider `step` at the bottom.{every}

- **arrows**: the robots, each with the last corners of its trail.
- **squares** in a pale colour were visited, first by the robot of that colour.
- **black frames**: robots that collided in the step before.
- **curves**: the positions visited so far, the collisions so far, and the part.

{made_with(spec)}"""
