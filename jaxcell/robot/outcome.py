import dataclasses
from typing import Literal


@dataclasses.dataclass(frozen=True)
class RunOutcome:
    """How a run ended."""

    result: Literal[
        "localized", "arrived", "patrolled", "reported", "refuted", "stopped", "unfinished"
    ]
    """`"localized"`: one configuration is left, or the filter is in a knowledge cycle, the policy
    at an end, or the belief in few cells; `"arrived"`: the plan, or the trajectory, is done;
    `"patrolled"`: as many cells were visited as were asked for; `"reported"`: an intruder was seen;
    `"refuted"`: what was sensed cannot be; `"stopped"`: the driver has stopped the robot, or a
    person the run; `"unfinished"`: none of these, after as many observations as were allowed."""
    observations: str
    "What the robot sensed: 0 for a step, 1 for a bump."
    reason: str
    "A sentence for people."
    colors: tuple[int, ...] = ()
    "Of the filter after each observation; 0 where a filter without a trap has no state for it."
    cells: tuple[int, ...] = ()
    "The cells where the robot may be, by the filter."


def observed(reason: str, observations: str) -> str:
    """A reason with what the robot sensed, as where it disagrees with the map."""
    return f"{reason}; the robot observed {observations}"
