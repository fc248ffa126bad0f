import dataclasses

import numpy as np
import scipy.sparse
from jaxtyping import Bool, Float, Int

from ...automata import HiddenMap
from ...base.certificate import Certificate
from ...base.shown import Shown
from ...mapping.classes import reaching


# Sweeps end when the relative gap of the mean times is this small, or after this number.
_TOLERANCE, _MOST_SWEEPS = 1e-3, 20_000


@dataclasses.dataclass(frozen=True, eq=False)
class SlipPolicy(Shown):
    """A choice of angles at bumps that brings a slipping robot to a goal."""

    choice: Int[np.ndarray, "fine"]
    "For each fine cell, the index of the angle to turn by at a bump."
    time: Float[np.ndarray, "fine"]
    "The least mean number of observations to the goal; `inf` if the robot may fail to reach it."
    certificate: Certificate
    "The largest relative error of `time`, whose values are lower bounds."

    @property
    def sure(self) -> bool:
        """True if a robot with this policy is certain to arrive."""
        return self.certificate.converged


def slip_policy(
    hidden: HiddenMap, goal: Bool[np.ndarray, "fine"], start: Float[np.ndarray, "fine"]
) -> SlipPolicy:
    """Find the policy that is certain to bring a robot to a goal, in the least mean time.

    The robot is assumed to know its fine cell. Value iteration bounds the times from both sides.
    The times `T` after a sweep are lower bounds. If another sweep adds at most `d < 1` to each
    time, `T / (1 - d)` are upper bounds, and prove that the robot arrives.

    **Arguments:** a hidden map, a mask of the goal, and the distribution of the start; cells that
    cannot be reached from the start are ignored. **Returns:** the policy. Its certificate fails if
    no policy is certain to bring the robot to the goal.

    A robot that moves with a probability of 1/2, and otherwise bumps and stays:

        >>> import numpy as np
        >>> from jaxcell import automata, bounce
        >>> moves, bumps, start = np.diag([0.5], k=1), np.diag([0.5, 1.0]), np.array([1.0, 0.0])
        >>> hidden = automata.HiddenMap.of(moves, bumps, np.arange(2), start)
        >>> policy = bounce.slip_policy(hidden, np.array([False, True]), start)
        >>> policy.time.round(2).tolist(), policy.sure
        ([2.0, 0.0], True)
    """
    anywhere = sum(hidden.bumps, hidden.moves)
    # The cells that can be reached before the goal.
    on = scipy.sparse.diags_array((~goal).astype(float), format="csr")
    inside = reaching((on @ anywhere @ on).T.tocsr(), (start > 0) & ~goal)
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
    """Compute the probability that a robot has reached its goal after each observation.

    **Arguments:** a hidden map; the policy, as the index of an angle for each cell of the map; a
    mask of the goal, the distribution of the start, and a number of observations. **Returns:** the
    probabilities at the start and after each observation.

    A robot that moves with a probability of 1/2, and otherwise bumps and stays:

        >>> import numpy as np
        >>> from jaxcell import automata, bounce
        >>> moves, bumps, start = np.diag([0.5], k=1), np.diag([0.5, 1.0]), np.array([1.0, 0.0])
        >>> hidden = automata.HiddenMap.of(moves, bumps, np.arange(2), start)
        >>> goal = np.array([False, True])
        >>> bounce.arrival_by(hidden, np.zeros(2, int), goal, start, 2).tolist()
        [0.0, 0.5, 0.75]
    """
    weight, arrived = np.where(goal, 0.0, start), [float(start[goal].sum())]
    for _ in range(times):
        after = hidden.after(0, weight)
        for number in range(hidden.angles):
            after = after + hidden.after(1 + number, np.where(choice == number, weight, 0.0))
        arrived.append(arrived[-1] + float(after[goal].sum()))
        weight = np.where(goal, 0.0, after)
    return np.array(arrived)


class PolicyRobot:
    """A robot that follows a policy, and knows its cell only as a belief from its observations.

    At a bump it takes the angle with the least mean time to the goal, averaged over its belief.
    """

    def __init__(
        self, hidden: HiddenMap, policy: SlipPolicy, start: Float[np.ndarray, "fine"]
    ) -> None:
        self.weight = start
        self._hidden = hidden
        self._time = np.where(np.isfinite(policy.time), policy.time, _MOST_SWEEPS)

    def turn(self, observation: int) -> int | None:
        """Choose the index of the angle to turn by after an observation; `None` for no turn."""
        events = range(1, 1 + self._hidden.angles) if observation else [0]
        beliefs = [self._hidden.after(event, self.weight) for event in events]
        best = int(np.argmin([belief @ self._time for belief in beliefs]))
        # The belief stays if the observation cannot occur on the map.
        if (total := beliefs[best].sum()) > 0:
            self.weight = beliefs[best] / total
        return best if observation else None
