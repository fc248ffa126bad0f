import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Int

from ...bounce import TeamTrajectory
from ..canvas import palette
from ..canvas.curves import curve
from ..canvas.map import CellMap
from ..canvas.page import log_tab
from ..canvas.palette import Color, PictureClass, robot_color, robots_by_color, tint
from ..canvas.prose import Spec, counted, described, made_with, numbers
from ..canvas.stream import send_blueprint


_MARK = palette.BLACK
MAX_TIMES, MAX_PICTURES = 20_000, 500
"""Largest number of times at which robots are shown, and of pictures of visited positions."""


def log_team(stream: rr.RecordingStream, team: TeamTrajectory, spec: Spec) -> None:
    """Record a joint trajectory of several robots."""
    stride = max(1, -(-team.steps // MAX_TIMES))
    times = np.unique(np.append(np.arange(0, team.steps + 1, stride), team.steps))
    map = CellMap(stream, team.cells)
    robots = range(team.starts.size)
    for robot in robots:
        poses = team.robot_x[:, robot], team.robot_y[:, robot], team.robot_theta[:, robot]
        map.robot(poses, _darker(robot_color(robot)[1]), f"_{robot}", times=times)
    move, collided = np.nonzero(team.collided)
    # A move is shown at its end.
    marks = np.bincount(np.searchsorted(times, move + 1), minlength=times.size)
    map.frames("collisions", team.cell[move, collided], _MARK, times, marks, order=40.0)
    shown = [_log_visited(map, team), "collisions"]
    shown += [f"{kind}_{robot}" for kind in ("trail", "robot") for robot in robots]
    seen = map.view("The robots, and the positions that they have visited", shown)
    views = rrb.Vertical(seen, _log_curves(stream, team, times), row_shares=[7, 3])
    text = _text(team, stride, spec)
    tab = log_tab(stream, "", "Team", views, text, _legend(team), shares=(3, 2))
    send_blueprint(stream, [tab], "step", max(4.0, team.steps / 60))


def _log_visited(map: CellMap, team: TeamTrajectory) -> str:
    classes = [PictureClass("not visited", palette.CLEAR)]
    classes += [
        PictureClass(f"first visited by robot {alike} ({name})", tint(color, 0.55))
        for alike, name, color in robots_by_color(team.starts.size)
    ]
    changes = np.unique(team.first_visit[team.first_visit >= 0])
    shown = np.linspace(0, len(changes) - 1, min(len(changes), MAX_PICTURES)).round().astype(int)
    changes = changes[shown]
    seen = (team.first_visit >= 0) & (team.first_visit <= changes[:, None])
    kind = np.where(seen, 1 + team.first_visitor % len(palette.ROBOTS), 0)
    return map.picture("visited", classes, kind, "step", changes)


def _log_curves(
    stream: rr.RecordingStream, team: TeamTrajectory, times: Int[np.ndarray, "times"]
) -> rrb.Container:
    part = np.searchsorted(team.part_begin, team.time, side="right")
    collisions = np.append(0, np.cumsum(team.collisions))
    of, views = team.cells.positions, []
    for name, title, values, most in (
        ("covered", f"Positions visited (of {of:,})", team.covered, of),
        ("collisions", "Collisions so far", collisions, team.collisions_in_all),
        ("part", "Part", part, team.parts),
    ):
        views.append(curve(stream, f"team/{name}", title, values[times], most, times))
    return rrb.Horizontal(*views, column_shares=[2, 1, 1])


def _legend(team: TeamTrajectory) -> list[tuple[str, Color]]:
    """Return the legend. Each colour is listed once, even if several robots share it."""
    colors = robots_by_color(team.starts.size)
    return [
        *((f"robot {alike}", _darker(color)) for alike, _, color in colors),
        ("pale: first visited by the robot of that colour", tint(robot_color(0)[1], 0.55)),
        ("not visited", palette.FREE),
        ("collided in the step before (black frame)", _MARK),
    ]


def _darker(color: Color) -> Color:
    """Return the colour of the arrow of a robot, darker than its visited squares."""
    return palette.mix(color, palette.BLACK, 0.15)


def _text(team: TeamTrajectory, stride: int, spec: Spec) -> str:
    robots = range(team.starts.size)
    who = {"robot": robots, "colour": [robot_color(robot)[0] for robot in robots]}
    every = f" Every {stride:,}th step is shown." if stride > 1 else ""
    return f"""# {counted(len(robots), "bouncing robot")}

Each robot runs straight. At a bump, into a wall or another robot, it stays, turns by its bouncing
angle, and runs on.

A part ends when all robots are in an earlier joint state; the next part begins with one robot
turned by one direction. The search ended because {team.meaning}.

## How to look

Press play, or drag `step` at the bottom.{every}

- **arrows**: the robots, each with the end of its trail.
- **pale squares** were visited, first by the robot of that colour.
- **black frames**: robots that collided in the step before.

{numbers(team)}

{described(team, "starts", first=who)}

{made_with(spec, team.cells)}"""
