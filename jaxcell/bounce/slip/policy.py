import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import scipy.sparse
from jaxtyping import Bool, Float, Int
from scipy.sparse import csgraph

from ...automata import HiddenMap
from ...base.certificate import Certificate


# A policy is improved until its mean time is known to this part, or so often.
_TOLERANCE, _MOST_SWEEPS = 1e-3, 20_000


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
    hidden: HiddenMap, goal: Bool[np.ndarray, "fine"], start: Float[np.ndarray, "fine"]
) -> SlipPolicy:
    """Find the policy that gets a robot to a goal for sure and soonest, by value iteration.

    It takes the robot to know its fine cell. The times are bounded from both sides: times `T` of a
    sweep are too small, and with `d` the most that one more sweep adds, `T / (1 - d)` are too large
    (and prove that the policy arrives).

    **Arguments:**

    - `hidden`: of [`jaxcell.bounce.slip_map`][].
    - `goal`: the fine cells of the goal.
    - `start`: where the robot starts; only what can be reached from there counts.

    **Returns:** [`SlipPolicy`][]; its certificate fails where no policy surely arrives.

    A robot that moves on one time of two, or bumps and stays:

        >>> import numpy as np
        >>> from jaxcell import automata, bounce
        >>> moves, bumps, start = np.diag([0.5], k=1), np.diag([0.5, 1.0]), np.array([1.0, 0.0])
        >>> hidden = automata.HiddenMap.of(moves, bumps, np.arange(2), start)
        >>> policy = bounce.slip_policy(hidden, np.array([False, True]), start)
        >>> policy.time.round(2).tolist(), policy.sure
        ([2.0, 0.0], True)
    """
    anywhere = sum(hidden.bumps, hidden.moves)
    inside = _reached(anywhere, start > 0, goal)
    time, sweeps, gap = np.zeros(goal.size), 0, 1.0
    part = [matrix[inside] for matrix in (hidden.moves, *hidden.bumps)]
    while gap > _TOLERANCE and sweeps < _MOST_SWEEPS:
        after = 1 + part[0] @ time + np.min([one @ time for one in part[1:]], axis=0)
        gap = float((after - time[inside]).max(initial=0))
        time[inside] = after
        sweeps += 1
    choice = np.argmin([bumps @ time for bumps in hidden.bumps], axis=0)
    certificate = Certificate(sweeps, gap, _TOLERANCE)
    known = inside | goal
    return SlipPolicy(choice, np.where(known, time, np.inf), certificate)


def arrival_by(
    hidden: HiddenMap,
    choice: Int[np.ndarray, "fine"],
    goal: Bool[np.ndarray, "fine"],
    start: Float[np.ndarray, "fine"],
    times: int,
) -> Float[np.ndarray, "_"]:
    """How probable it is that a policy has arrived after each observation.

    **Arguments:**

    - `hidden`, `goal`, `start`: as for [`slip_policy`][].
    - `choice`: the number of the angle in each cell.
    - `times`: how many observations.

    **Returns:** the probabilities, the first that at the start.

    A robot that moves on one time of two, or bumps and stays:

        >>> import numpy as np
        >>> from jaxcell import automata, bounce
        >>> moves, bumps, start = np.diag([0.5], k=1), np.diag([0.5, 1.0]), np.array([1.0, 0.0])
        >>> hidden = automata.HiddenMap.of(moves, bumps, np.arange(2), start)
        >>> goal = np.array([False, True])
        >>> bounce.arrival_by(hidden, np.zeros(2, int), goal, start, 2).tolist()
        [0.0, 0.5, 0.75]
    """
    weight, found = np.where(goal, 0.0, start), [float(start[goal].sum())]
    for _ in range(times):
        after = hidden.after(0, weight)
        for number in range(hidden.angles):
            after = after + hidden.after(1 + number, np.where(choice == number, weight, 0.0))
        found.append(found[-1] + float(after[goal].sum()))
        weight = np.where(goal, 0.0, after)
    return np.array(found)


class PolicyRobot:
    """A robot that knows where it starts, and then only what it senses, and follows a policy.

    At a bump it takes the angle after which its belief has the least mean time.
    """

    def __init__(
        self, hidden: HiddenMap, policy: SlipPolicy, start: Float[np.ndarray, "fine"]
    ) -> None:
        """**Arguments:**

        - `hidden`: of [`jaxcell.bounce.slip_map`][].
        - `policy`: what it follows.
        - `start`: where it is at the start.
        """
        self.weight = start
        self._hidden = hidden
        self._time = np.where(np.isfinite(policy.time), policy.time, _MOST_SWEEPS)

    def turn(self, observation: int) -> int | None:
        """The number of the angle to turn by after an observation, `None` after a step."""
        if not observation:
            self.weight = _normal(self._hidden.after(0, self.weight), self.weight)
            return None
        beliefs = [self._hidden.after(1 + i, self.weight) for i in range(self._hidden.angles)]
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
        >>> from jaxcell import automata, bounce
        >>> from jaxcell.bounce.slip.policy import PolicyRobot, driven
        >>> start = np.array([1.0, 0.0])
        >>> hidden = automata.HiddenMap.of(np.eye(2), np.zeros((2, 2)), np.arange(2), start)
        >>> policy = bounce.slip_policy(hidden, np.array([True, False]), start)
        >>> robot = PolicyRobot(hidden, policy, start)
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
