"""The option `--heading` of `jaxcell robot run` and `jaxcell robot sketch`."""

import math

from ...robot.tasks.task import Task


def direction_at(heading: float, directions: int) -> int:
    """Convert the option `--heading`, in degrees, to the index of a direction of the task."""
    turn = heading * directions / 360
    if not math.isfinite(turn) or abs(turn - round(turn)) > 1e-6:
        raise ValueError(
            f"--heading {heading:g}: expected a multiple of the {360 / directions:g} degrees "
            "between the directions"
        )
    return round(turn) % directions


def check_heading(task: Task) -> None:
    """Require the option `--heading` if the steps of a task differ between directions."""
    if task.needs_heading:
        raise ValueError(
            f"--heading: expected the heading of the robot at the start in degrees, because the "
            f"steps of {task.path} differ between directions"
        )
