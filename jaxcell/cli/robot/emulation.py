import contextlib
import dataclasses
import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...study.map_study import cell_at


if TYPE_CHECKING:
    from ...robot.emulation.emulator import Emulator
    from ...robot.outcome import RunOutcome
    from ...robot.tasks.files import AnyTask
    from ...robot.tasks.patrol_task import PatrolTask
    from ...space import CellSpace
    from .run import RobotRun


@dataclasses.dataclass(frozen=True)
class Emulation:
    """An emulated robot, and the cells of its map."""

    robot: "Emulator"
    cells: "CellSpace"
    start: int

    @property
    def pose(self) -> tuple[float, float, float]:
        """Where it starts, in metres and radians."""
        x, y, theta = self.cells.centre(self.start)
        return float(x), float(y), float(theta)

    @property
    def end(self) -> int | None:
        """The cell that the robot is in, if any."""
        with contextlib.suppress(ValueError):
            return int(self.cells.index(*self.robot.pose))
        return None

    def describe(self, outcome: "RunOutcome") -> dict[str, Any]:
        """The true state, for the summary."""
        x, y, theta = self.robot.pose
        return {
            "start": self.start,
            "end": self.end,
            "pose": [round(x, 4), round(y, 4), round(math.degrees(theta) % 360, 2)],
            "seconds": round(self.robot.seconds, 2),
            "truth_is_a_candidate": self.end in outcome.cells if outcome.cells else None,
        }


def emulate(map: Path, task: "AnyTask", options: "RobotRun", rng: Any) -> Emulation:
    """Emulate a robot in a map, at the start of a task, or at that of the options."""
    from ...robot.emulation.body import Body
    from ...robot.emulation.emulator import Emulator, Line
    from ...space import CellSpace, Workspace

    workspace = dataclasses.replace(Workspace.load(map), robot_radius=task.radius)
    cells = CellSpace.of(workspace, task.cell, task.directions)
    if options.start is not None:
        start = cell_at(cells, options.start, "--start")
    else:
        start = _start(cells, task, options.heading, rng)
    body = Body.in_cell(cells, start, options.noise, rng)
    return Emulation(Emulator(body, line=Line(speedup=options.speedup)), cells, start)


def _start(cells: "CellSpace", task: "AnyTask", heading: float | None, rng: Any) -> int:
    """The cell that a task starts in; of a filter any."""
    from ...robot.tasks.files import PlanTask
    from ...robot.tasks.patrol_task import PatrolTask
    from ...robot.team import MemberTask

    match task:
        case PlanTask():
            return cell_at(cells, str(task.start), f"{task.path}: start")
        case MemberTask():
            pose = task.start
        case PatrolTask():
            x, y, _ = map(float, task.cells.centre(task.start))
            pose = x, y, math.radians(heading or 0)
        case _:
            return int(rng.integers(cells.size))
    try:
        return int(cells.index(*pose))
    except ValueError as error:
        raise ValueError(f"{task.path}: its start is not in the map: {error}") from None


def seen_from(
    cells: "CellSpace", task: "PatrolTask", intruder: str
) -> Callable[[int], dict[str, float] | None]:
    """What a robot on patrol reports from each of its positions: an intruder whose cell it sees.

    **Arguments:**

    - `cells`: the cells of the map that it is in.
    - `task`: the patrol, and how far the robot sees.
    - `intruder`: where the intruder is, "x,y" in metres.
    """
    from ...space import visible_cells

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
