import dataclasses
from typing import Literal

from ..base.shown import Shown


@dataclasses.dataclass(frozen=True)
class RunOutcome(Shown):
    """The outcome of a run: its result, the observations, and the possible cells at the end."""

    result: Literal[
        "localized", "arrived", "patrolled", "reported", "refuted", "stopped", "unfinished"
    ]
    """The robot is `"localized"` if a single configuration is left, the filter is in a knowledge
    cycle, the policy has ended, or the belief is concentrated on few cells. It has `"arrived"` if
    its plan or trajectory is done, or its goal is reached. It has `"patrolled"` if it has visited
    the wanted number of cells, and `"reported"` if it saw an intruder. The map is `"refuted"` if
    the observations contradict it. The run is `"stopped"` if the driver or a person stopped it.
    Otherwise it is `"unfinished"`."""
    observations: str
    "The observations of the robot: 0 for a step, 1 for a bump."
    reason: str
    "A sentence that explains the result."
    colors: tuple[int, ...] = ()
    """The output (colour) of the filter or policy after each observation; 0 after an impossible
    observation, if a filter has no trap state."""
    cells: tuple[int, ...] = ()
    "The possible cells of the robot according to the filter, policy or belief."


def count_agreed(agreed: int | None, known: bool) -> int | None:
    """Count an observation since the place of a robot was first known; `None` before.

    `agreed` is the count before the observation, and `known` says if the place is known after it.
    """
    if agreed is not None:
        return agreed + 1
    return 0 if known else None


def observed(reason: str, observations: str) -> str:
    """Append the observations of the robot to the sentence `reason`."""
    return f"{reason}; the robot observed {observations}"


def actions_outcome(observations: str, done: int, actions: int, problem: str = "") -> RunOutcome:
    """Compute the outcome of a run that has done the first `done` of its `actions`.

    `problem` is a sentence about the step that contradicted the next action, or empty.
    """
    if problem:
        reason = observed(f"action {done} of {actions}: {problem}", observations)
        return RunOutcome("refuted", observations, reason)
    if done < actions:
        return RunOutcome("unfinished", observations, f"{done} of {actions} actions are done")
    return RunOutcome("arrived", observations, f"all {actions} actions are done")
