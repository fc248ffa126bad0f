import contextlib
import dataclasses
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from ...robot.anywhere import AnywhereOutcome
from ...robot.emulation.body import Body, Noise, bumper_give
from ...robot.emulation.emulator import Emulator, Line
from ...robot.outcome import RunOutcome
from ...robot.tasks.anywhere_task import AnywhereTask
from ...robot.tasks.files import AnyTask, PlanTask
from ...robot.tasks.patrol_task import PatrolTask
from ...robot.team import MemberTask
from ...space import CellSpace, Workspace, nearest_cell, visible_cells
from ...study.bounce.anywhere import check_start, pose_at
from ...study.errors import read_errors
from ...study.map_study import cell_at
from ...walls import draw_starts
from ..terminal import note
from .options import RunOptions, direction_at


# Tolerance for the radius of the robot of a task, compared with the emulated body.
_AS_WIDE = 0.01
# Allowed overlap of a body and a wall, in metres.
_TOUCH = 0.05


@dataclasses.dataclass(frozen=True)
class Emulation:
    """An emulated robot, and the cells of its map."""

    robot: Emulator
    cells: CellSpace
    start: int
    pose: tuple[float, float, float]
    "The pose of the robot at the start, in metres and radians."
    radius: float = 0.0
    "The radius of the body, in metres."
    touches: Sequence[tuple[float, float, float]] | None = None
    "The time in seconds, x and y in metres, of each touch of a wall; `None` without `--physics`."

    @property
    def end(self) -> int | None:
        with contextlib.suppress(ValueError):
            return int(self.cells.index(*self.robot.pose))
        return None

    def describe(
        self, outcome: RunOutcome, cells: CellSpace | None = None, back: float = 0.0
    ) -> dict[str, Any]:
        """Describe the end of a run.

        `cells` are the cells of the task, or `None` if the robot is on another map and the map of
        the task is not found, so that no cell of the task is the true one. `back` is the largest
        distance in metres from a wall to a robot that has bumped into it.
        """
        x, y, theta = self.robot.pose
        among = None
        if outcome.result == "stopped":
            # The robot may have left the cell of its last observation.
            pass
        elif isinstance(outcome, AnywhereOutcome):
            if outcome.result == "refuted":
                among = False
            elif outcome.place is not None and outcome.extent is not None:
                # A body that touches a wall presses its bumper in.
                reach = outcome.extent / 2 + max(back, _TOUCH)
                among = math.dist((x, y), outcome.place) <= reach
        elif outcome.cells:
            among = False
            with contextlib.suppress(ValueError):
                among = cells is not None and int(cells.index(x, y, theta)) in outcome.cells
        return {
            "start": self.start,
            "end": self.end,
            "pose": [round(x, 4) + 0.0, round(y, 4) + 0.0, round(math.degrees(theta) % 360, 2)],
            "seconds": round(self.robot.seconds, 2),
            "truth_is_a_candidate": among,
        }


def emulate(map: Path, task: AnyTask, options: RunOptions, rng: Any) -> Emulation:
    """Emulate a robot in a map; the start is `options.start`, or that of the task, or random."""
    workspace = dataclasses.replace(Workspace.load(map), robot_radius=task.radius)
    cells = CellSpace.of(workspace, task.cell, task.directions)
    if isinstance(task, AnywhereTask):
        pose = _start_pose(workspace, task, options.start, rng)
        start = int(nearest_cell(cells, *pose))
    else:
        if options.start is not None:
            start = cell_at(cells, options.start, "--start")
        else:
            start = _start(cells, task, options.heading, rng)
        x, y, theta = cells.centre(start)
        pose = float(x), float(y), float(theta)
    if options.physics:
        return _physical(cells, start, pose, task, options, rng)
    give = bumper_give(cells.cell) if options.give is None else options.give
    slip = read_errors(options.errors, ("slip",)).get("slip", 0.0)
    noise = Noise(distance=slip, rotation=slip, veer=slip)
    body = Body(workspace, pose, give=give, noise=noise, rng=rng)
    robot = Emulator(body, line=Line(speedup=options.speedup))
    return Emulation(robot, cells, start, pose, task.radius)


def _start_pose(
    workspace: Workspace, task: AnywhereTask, start: str | None, rng: Any
) -> tuple[float, float, float]:
    """Return the pose `start` or, without it, a random pose with a heading that the task allows."""
    if start is not None:
        pose = pose_at(workspace, start, "--start", task.headings)
        check_start(task.start, pose, f"--start {start}")
        return pose
    place, heading = draw_starts(workspace, task.start, 1, task.headings, rng)
    return *place[0].tolist(), float(heading[0])


def _physical(
    cells: CellSpace,
    start: int,
    pose: tuple[float, float, float],
    task: AnyTask,
    options: RunOptions,
    rng: Any,
) -> Emulation:
    from ...robot.physics import LATENCY, RADIUS, Physics, PhysicsBody

    assert cells.workspace is not None
    physics = Physics() if options.friction is None else Physics(floor=options.friction)
    body = PhysicsBody(cells.workspace, pose, physics, rng=rng)
    if abs(task.radius - RADIUS) > _AS_WIDE:
        note(
            f"{task.path.name} is for a robot of radius {task.radius:g} m, and the body of a "
            f"Create 2 has {RADIUS:g} m, so it bumps at corners that the other robot passes; "
            "make the task with --robot-radius 0.174"
        )
    line = Line(speedup=options.speedup, latency=LATENCY)
    return Emulation(Emulator(body, line=line), cells, start, pose, RADIUS, body.touches)


def _start(cells: CellSpace, task: AnyTask, heading: float | None, rng: Any) -> int:
    """Return the start cell of a task or, if it has none, a random cell with this `heading`."""
    match task:
        case PlanTask():
            return cell_at(cells, task.start, f"{task.path}: start")
        case MemberTask():
            pose = task.start
        case PatrolTask():
            x, y, _ = map(float, task.cells.centre(task.start))
            pose = x, y, math.radians(heading or 0)
        case _ if heading is not None:
            first = direction_at(heading, cells.directions) * cells.positions
            return first + int(rng.integers(cells.positions))
        case _:
            return int(rng.integers(cells.size))
    try:
        return int(cells.index(*pose))
    except ValueError as error:
        raise ValueError(f"{task.path}: its start is outside the map: {error}") from None


def seen_from(
    cells: CellSpace, task: PatrolTask, intruder: str
) -> Callable[[int], dict[str, float] | None]:
    """Return a function of a cell: the place `intruder` ("x,y") if visible from it, else `None`."""
    try:
        x, y = map(float, intruder.split(","))
        hidden = int(cells.index(x, y)) % cells.positions
    except ValueError as error:
        raise ValueError(f'--intruder {intruder!r}: expected "x,y" in metres: {error}') from None
    sees = visible_cells(cells, task.reach)[:, hidden]

    def look(position: int) -> dict[str, float] | None:
        there = task.cells.centre(position)
        at = int(cells.index(*there)) % cells.positions
        return {"x": x, "y": y} if sees[at] else None

    return look
