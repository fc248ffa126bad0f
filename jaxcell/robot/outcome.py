import dataclasses
from typing import Literal


@dataclasses.dataclass(frozen=True)
class RunOutcome:
    """The outcome of a run."""

    result: Literal[
        "localized", "arrived", "patrolled", "reported", "refuted", "stopped", "unfinished"
    ]
    """`"localized"`: one configuration is left, or the filter is in a knowledge cycle, the policy
    at an end, or the belief in few cells; `"arrived"`: the plan, or the trajectory, is done;
    `"patrolled"`: the number of cells was visited; `"reported"`: an intruder was seen;
    `"refuted"`: what was sensed cannot be; `"stopped"`: the driver has stopped the robot, or a
    person the run; `"unfinished"`: none of these, after as many observations as were allowed."""
    observations: str
    "The observations of the robot: 0 for a step, 1 for a bump."
    reason: str
    "A sentence for people."
    colors: tuple[int, ...] = ()
    "Colour of the filter after each observation; 0 if a filter without a trap has no state for it."
    cells: tuple[int, ...] = ()
    "The cells where the robot may be, by the filter."


def observed(reason: str, observations: str) -> str:
    """Add the observations of the robot to a reason."""
    return f"{reason}; the robot observed {observations}"
