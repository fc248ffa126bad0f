import dataclasses
from typing import Literal


@dataclasses.dataclass(frozen=True)
class RunOutcome:
    """The outcome of a run, in which a robot does its task."""

    result: Literal[
        "localized", "arrived", "patrolled", "reported", "refuted", "stopped", "unfinished"
    ]
    """`"localized"`: one configuration is left, the filter is in a knowledge cycle, the policy has
    ended, or the belief is concentrated in few cells; `"arrived"`: the plan or the trajectory is
    done, or the goal is reached; `"patrolled"`: the wanted number of cells was visited;
    `"reported"`: an intruder was seen; `"refuted"`: an observation is impossible in the map;
    `"stopped"`: the driver stopped the robot, or a person stopped the run; `"unfinished"`: the
    largest number of observations is reached."""
    observations: str
    "The observations of the robot: 0 for a step, 1 for a bump."
    reason: str
    "A sentence that explains the result."
    colors: tuple[int, ...] = ()
    """The colour of the filter after each observation; 0 after an impossible observation, if the
    filter has no trap state."""
    cells: tuple[int, ...] = ()
    "The possible cells of the robot according to the filter, policy or belief."


def observed(reason: str, observations: str) -> str:
    """Append the observations of the robot to the sentence `reason`."""
    return f"{reason}; the robot observed {observations}"
