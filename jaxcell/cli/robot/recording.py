import contextlib
import dataclasses
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ... import record
from ...base.bundled import with_path
from ...base.paths import name_in_results
from ...robot.tasks.files import AnyTask, BeliefTask, FilterTask, PolicyTask
from ...space import CellSpace, Workspace
from .emulation import Emulation


def recording_of(
    task: AnyTask,
    path: Path,
    *,
    start: Sequence[float] | None = None,
    emulation: Emulation | None = None,
    viewer: str | None = None,
) -> "record.RobotRecording":
    """Create the Rerun recording of a run from the pose `start`, shown live in `viewer`."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if viewer is None:
        # Rerun prints three lines for a full disk, which ends the run with a line of its own.
        os.environ.setdefault("RUST_LOG", "off")
    about = _about(task)
    cells = cells_of(task) if emulation is None else emulation.cells
    robot = record.RecordedRobot(start=start)
    if emulation is not None:
        trace, touches = emulation.robot.trace, emulation.touches
        robot = dataclasses.replace(robot, trace=trace, radius=emulation.radius, touches=touches)
    filter = task.filter if isinstance(task, FilterTask) else None
    return record.RobotRecording(
        path,
        [robot],
        cells=cells,
        filter=task.policy if isinstance(task, PolicyTask) else filter,
        belief=task.belief if isinstance(task, BeliefTask) else None,
        filter_of_cells=cells is not None and _is_map(cells, about),
        viewer=viewer,
        spec={"file": name_in_results(task.path), **about},
    )


def _about(task: AnyTask) -> Mapping[str, Any]:
    """Return the metadata of a filter, policy or belief, with its map; `{}` for other tasks."""
    match task:
        case FilterTask():
            return task.filter.metadata
        case PolicyTask():
            return task.policy.metadata
        case BeliefTask():
            return task.belief.hidden.metadata
    return {}


def cells_of(task: AnyTask) -> CellSpace | None:
    """Divide the map of a task into cells; `None` if the task names no map, or it is not found."""
    about = _about(task)
    with contextlib.suppress(OSError, ValueError, KeyError):
        map = Workspace.load(with_path(str(about["map"])))
        workspace = dataclasses.replace(map, robot_radius=task.radius)
        cells = CellSpace.of(workspace, task.cell, task.directions)
        return cells if _is_map(cells, about) else None
    return None


def own_cells(task: AnyTask, emulated: CellSpace) -> CellSpace | None:
    """Return the cells of a task: those of its emulation if the map is the same, or its own."""
    return emulated if _is_map(emulated, _about(task)) else cells_of(task)


def _is_map(cells: CellSpace, about: Mapping[str, Any]) -> bool:
    assert cells.workspace is not None
    expected = {
        "name": cells.workspace.name,
        "positions": cells.positions,
        "robot_radius_m": cells.workspace.robot_radius,
    }
    return all(about.get(key, value) == value for key, value in expected.items())
