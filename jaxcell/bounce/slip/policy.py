import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import scipy.sparse
from jaxtyping import Bool, Float, Int
from scipy.sparse import csgraph

from ...base.certificate import Certificate


Choices = Sequence[tuple[scipy.sparse.csr_array, scipy.sparse.csr_array]]
"""For each angle to choose from, the probabilities of moves, the same for all, and of bumps."""

# A policy is improved until its mean time is known to this part, or so often.
_TOLERANCE, _MOST_SWEEPS = 1e-3, 20_000


def plan_probability(
    choices: Choices, start: Float[np.ndarray, "fine"], actions: Sequence[int]
) -> Float[np.ndarray, "fine"]:
    """Where a robot is, and how probably, that follows a plan and senses all that it foretells.

    **Arguments:**

    - `choices`: of [`jaxcell.bounce.slip_choices`][].
    - `start`: its distribution at the start.
    - `actions`: -1 for a step forward, else the angle to turn by at a bump, by its number.

    **Returns:** the probabilities, whose sum is that of sensing just what the plan foretells.

    A robot that is to make two steps, each of which meets a wall one time of ten:

        >>> import numpy as np
        >>> import scipy.sparse
        >>> from jaxcell import bounce
        >>> free = scipy.sparse.csr_array(np.array([[0, 0.9, 0], [0, 0, 0.9], [0, 0, 0.9]]))
        >>> choices = [(free, scipy.sparse.csr_array(np.eye(3) / 10))]
        >>> bounce.plan_probability(choices, np.array([1.0, 0, 0]), [-1, -1]).round(2).tolist()
        [0.0, 0.0, 0.81]
    """
    weight = start
    for action in actions:
        moves, bumps = choices[max(action, 0)]
        weight = (moves if action < 0 else bumps).T @ weight
    return weight


@dataclasses.dataclass(frozen=True, eq=False)
class SlipPolicy:
    """The angle to turn by at a bump in each cell, which gets a robot to a goal."""

    choice: Int[np.ndarray, "fine"]
    "The number of the angle."
    time: Float[np.ndarray, "fine"]
    "The least mean number of observations to the goal, `inf` where it may not be reached."
    certificate: Certificate
    "The part by which a time may be too small; iterations are sweeps."

    @property
    def sure(self) -> bool:
        """Whether the policy surely arrives."""
        return self.certificate.residual <= self.certificate.tolerance


def slip_policy(
    choices: Choices, goal: Bool[np.ndarray, "fine"], start: Float[np.ndarray, "fine"]
) -> SlipPolicy:
    """Find the policy that gets a robot to a goal for sure and soonest, by value iteration.

    It takes the robot to know its fine cell. The times are bounded from both sides: times `T` of a
    sweep are too small, and with `d` the most that one more sweep adds, `T / (1 - d)` are too large
    (and prove that the policy arrives).

    **Arguments:**

    - `choices`: of [`jaxcell.bounce.slip_choices`][].
    - `goal`: the fine cells of the goal.
    - `start`: where the robot starts; only what can be reached from there counts.

    **Returns:** [`SlipPolicy`][]; its certificate fails where no policy surely arrives.

    A robot that moves on one time of two, or bumps and stays:

        >>> import numpy as np
        >>> import scipy.sparse
        >>> from jaxcell import bounce
        >>> moves = scipy.sparse.csr_array(np.diag([0.5], k=1))
        >>> bumps = scipy.sparse.csr_array(np.diag([0.5, 1.0]))
        >>> policy = bounce.slip_policy(
        ...     [(moves, bumps)], np.array([False, True]), np.array([1.0, 0.0])
        ... )
        >>> policy.time.round(2).tolist(), policy.sure
        ([2.0, 0.0], True)
    """
    moves = choices[0][0]
    anywhere = moves + sum((bumps for _, bumps in choices[1:]), choices[0][1])
    inside = _reached(anywhere, start > 0, goal)
    time, sweeps, gap = np.zeros(goal.size), 0, 1.0
    part = [matrix[inside] for matrix in (moves, *(bumps for _, bumps in choices))]
    while gap > _TOLERANCE and sweeps < _MOST_SWEEPS:
        after = 1 + part[0] @ time + np.min([one @ time for one in part[1:]], axis=0)
        gap = float((after - time[inside]).max(initial=0))
        time[inside] = after
        sweeps += 1
    choice = np.argmin([bumps @ time for _, bumps in choices], axis=0)
    certificate = Certificate(sweeps, gap, _TOLERANCE)
    known = inside | goal
    return SlipPolicy(choice, np.where(known, time, np.inf), certificate)


def arrival_by(
    choices: Choices,
    choice: Int[np.ndarray, "fine"],
    goal: Bool[np.ndarray, "fine"],
    start: Float[np.ndarray, "fine"],
    times: int,
) -> Float[np.ndarray, "_"]:
    """How probable it is that a policy has arrived after each observation.

    **Arguments:**

    - `choices`, `goal`, `start`: as for [`slip_policy`][].
    - `choice`: the number of the angle in each cell.
    - `times`: how many observations.

    **Returns:** the probabilities, the first that at the start.

    A robot that moves on one time of two, or bumps and stays:

        >>> import numpy as np
        >>> import scipy.sparse
        >>> from jaxcell import bounce
        >>> moves = scipy.sparse.csr_array(np.diag([0.5], k=1))
        >>> bumps = scipy.sparse.csr_array(np.diag([0.5, 1.0]))
        >>> bounce.arrival_by(
        ...     [(moves, bumps)], np.zeros(2, int), np.array([False, True]), np.array([1.0, 0.0]), 2
        ... ).tolist()
        [0.0, 0.5, 0.75]
    """
    weight, found = np.where(goal, 0.0, start), [float(start[goal].sum())]
    for _ in range(times):
        after = choices[0][0].T @ weight
        for number, (_, bumps) in enumerate(choices):
            after = after + bumps.T @ np.where(choice == number, weight, 0.0)
        found.append(found[-1] + float(after[goal].sum()))
        weight = np.where(goal, 0.0, after)
    return np.array(found)


class PolicyRobot:
    """A robot that knows where it starts, and then only what it senses, and follows a policy.

    At a bump it takes the angle after which its belief has the least mean time.
    """

    def __init__(
        self, choices: Choices, policy: SlipPolicy, start: Float[np.ndarray, "fine"]
    ) -> None:
        """**Arguments:**

        - `choices`: of [`jaxcell.bounce.slip_choices`][].
        - `policy`: what it follows.
        - `start`: where it is at the start.
        """
        self.weight = start
        self._choices = choices
        self._time = np.where(np.isfinite(policy.time), policy.time, _MOST_SWEEPS)

    def turn(self, observation: int) -> int | None:
        """The number of the angle to turn by after an observation, `None` after a step."""
        if not observation:
            self.weight = _normal(self._choices[0][0].T @ self.weight, self.weight)
            return None
        beliefs = [bumps.T @ self.weight for _, bumps in self._choices]
        best = int(np.argmin([one @ self._time for one in beliefs]))
        self.weight = _normal(beliefs[best], self.weight)
        return best


def driven(
    step: Callable[[], bool],
    rotate: Callable[[float], Any],
    arrived: Callable[[], bool],
    robot: PolicyRobot,
    bounces: Sequence[float],
    limit: int,
) -> int | None:
    """Drive a robot by a policy.

    **Arguments:**

    - `step`, `rotate`: what it is driven with, as those of a walker.
    - `arrived`: whether it is at the goal.
    - `robot`: what chooses.
    - `bounces`: the angles, in radians.
    - `limit`: observations after which to give up.

    **Returns:** after how many observations it arrived, `None` if it did not.

    One that is there after its first step:

        >>> import numpy as np
        >>> import scipy.sparse
        >>> from jaxcell import bounce
        >>> from jaxcell.bounce.slip.policy import PolicyRobot, driven
        >>> free, never = scipy.sparse.eye_array(2, format="csr"), scipy.sparse.csr_array((2, 2))
        >>> start = np.array([1.0, 0.0])
        >>> policy = bounce.slip_policy([(free, never)], np.array([True, False]), start)
        >>> robot = PolicyRobot([(free, never)], policy, start)
        >>> driven(lambda: False, print, lambda: True, robot, [0.0], 5)
        1
    """
    for count in range(1, limit + 1):
        bumped = step()
        choice = robot.turn(int(bumped))
        if choice is not None:
            rotate(bounces[choice])
        if arrived():
            return count
    return None


def _reached(
    matrix: scipy.sparse.csr_array, start: Bool[np.ndarray, "fine"], goal: Bool[np.ndarray, "fine"]
) -> Bool[np.ndarray, "fine"]:
    """The cells that can be reached before the goal, from one more node before all the start."""
    size = start.size
    edges = matrix.tocoo()
    row, column = edges.coords
    kept = ~goal[row] & ~goal[column]
    begin = np.flatnonzero(start & ~goal)
    row = np.concatenate([row[kept], np.full(begin.size, size)])
    column = np.concatenate([column[kept], begin])
    graph = scipy.sparse.csr_array((np.ones(row.size), (row, column)), shape=(size + 1, size + 1))
    order = csgraph.breadth_first_order(graph, size, return_predecessors=False)
    found = np.zeros(size + 1, bool)
    found[order] = True
    return found[:size]


def _normal(
    weight: Float[np.ndarray, "fine"], before: Float[np.ndarray, "fine"]
) -> Float[np.ndarray, "fine"]:
    """The distribution, or that before where none is left: then it goes on as if nothing were."""
    total = weight.sum()
    return weight / total if total > 0 else before
