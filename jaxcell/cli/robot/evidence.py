"""Notes before a run on the confirmation of its answer, and on walls that the robot touches."""

import math

import numpy as np

from ...robot.followers import Follower
from ...robot.tasks.files import FilterTask, PolicyTask
from ...space import CellSpace, Motion
from ...space.steps import Steps
from ...space.touching import touching_steps
from ..terminal import note
from .emulation import Emulation
from .options import RunOptions


def note_evidence(
    task: FilterTask | PolicyTask, options: RunOptions, emulation: Emulation | None
) -> None:
    """Print notes if the answer of a robot cannot be confirmed, or if its path touches a wall."""
    source = task.policy if isinstance(task, PolicyTask) else task.filter
    if isinstance(task, PolicyTask) and task.policy.onward is None and options.confirm != 0:
        note(
            f"{options.file.name}: a policy of an earlier version cannot confirm its answer; "
            "make it again with `jaxcell localize`"
        )
    count = source.metadata.get("touching_starts")
    if emulation is not None:
        motion = Motion(task.step, source.metadata.get("collision", "swept"))
        if touches_wall(task.follower(), task.bounces, emulation.cells, motion, emulation.start):
            note(
                "From this start the robot touches a corner or a wall that it passes; if it bumps "
                "there, the map is refuted"
            )
    elif count:
        note(
            f"From {count:,} of {int(source.uncertainty[0]):,} starts the robot touches a corner "
            "or a wall that it passes; if it bumps there, the map is refuted"
        )


def touches_wall(
    follower: Follower,
    bounces: tuple[float, ...],
    cells: CellSpace,
    motion: Motion,
    start: int,
) -> bool:
    """Check whether a robot without errors touches a wall that it passes, until its run ends."""
    touches = touching_steps(cells, motion)
    if not touches.any():
        return False
    steps = Steps.of(cells, motion)
    targets = steps.targets(cells)[steps.way]
    shifts = np.round(np.array(bounces) * cells.directions / math.tau).astype(int).tolist()
    direction, position = divmod(start, cells.positions)
    while follower.result is None:
        if touches[direction, position]:
            return True
        there = int(targets[direction, position])
        follower.observe(int(there == position))
        position = there
        if follower.turn is not None:
            direction = (direction + shifts[follower.turn]) % cells.directions
    return False
