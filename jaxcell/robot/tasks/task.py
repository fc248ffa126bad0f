import dataclasses
import json
import math
import os
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float

from ...base.documents import Fields, checked_number
from ...base.paths import digest, replacing
from ...base.results import current_run
from ...base.shown import Shown
from ..walker import cell_strides


VERSION = 1
"""The newest version of the files of tasks."""
_MIN_LENGTH = 1e-6
_MAX_DIRECTIONS = 1_000_000


@dataclasses.dataclass(frozen=True)
class Task(Shown):
    """The base class of the tasks that robots read from files."""

    kind: ClassVar[str]
    path: Path
    cell: float
    "The side of a cell, in metres."
    directions: int
    "The number of directions in which the robot can face."
    step: float
    "The length of a step, in metres."
    radius: float
    "The radius of the robot, in metres."

    @property
    def strides(self) -> Float[np.ndarray, "directions 2"] | None:
        """The displacement of a step in each direction; `None` for a task without cells."""
        return cell_strides(self.directions, self.cell, self.step)

    @property
    def needs_heading(self) -> bool:
        """True if steps differ between directions, so that the robot must know its heading."""
        strides = self.strides
        return strides is not None and bool(np.ptp(strides, axis=0).max() > 1e-9 * self.cell)

    @property
    def start_direction(self) -> int | None:
        """The number of the robot's direction at the start; `None` for any direction."""
        return None

    @property
    def header(self) -> dict[str, Any]:
        """The fields that describe the task in the header of a log."""
        return {
            "kind": self.kind,
            "file": str(self.path.absolute()),
            "sha256": digest(self.path),
            "cell_m": self.cell,
            "directions": self.directions,
            "step_m": self.step,
        }


def write_task(path: str | os.PathLike[str], kind: str, **fields: Any) -> None:
    """Write a task with its kind and fields as JSON. An existing file is replaced."""
    run = {} if current_run() is None else {"run_id": current_run()}
    head = {"format": "jaxcell-robot-task", "version": VERSION, "kind": kind, **run}
    text = json.dumps({**head, **fields})
    with replacing(path) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")


def common_fields(path: Path, fields: Fields) -> dict[str, Any]:
    """Read the fields that every [`Task`][jaxcell.robot.tasks.task.Task] has."""
    return {
        "path": path,
        "cell": fields.number("cell_m", _MIN_LENGTH),
        "directions": fields.whole("directions", 1, _MAX_DIRECTIONS),
        "step": fields.number("step_m", _MIN_LENGTH),
        "radius": fields.number("robot_radius_m", 0.0),
    }


def angles(path: Path, fields: Fields, name: str, source: str, count: int) -> tuple[float, ...]:
    """Read at least `count` angles in degrees from a file, and return them in radians.

    A number is a list of one angle.
    Error messages name `source`, the command of `jaxcell` that writes such files.
    """
    values = fields.get(name)
    values = [values] if isinstance(values, float | int) else values
    least = f"at least {count} " if count else ""
    expected = f"a list of {least}angles, as `jaxcell {source} --out` writes it"
    if not isinstance(values, list) or len(values) < count:
        raise fields.refused(name, expected)
    for angle in values:
        checked_number(f"{path}: {name}", angle, expected)
    return tuple(map(math.radians, values))


def robot_fields(path: Path, fields: Fields, robot: int) -> Fields:
    """Return the fields of robot number `robot` (from 0) in the file of a team or patrol."""
    robots = fields.parts("robots")
    if not 0 <= robot < len(robots):
        raise ValueError(f"{path}: there is no robot {robot}; robots are 0 to {len(robots) - 1}")
    return robots[robot]
