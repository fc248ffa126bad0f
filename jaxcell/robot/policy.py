from collections.abc import Sequence
from typing import Any

from ..automata import Policy
from .following import Follower, follow, replay
from .outcome import RunOutcome
from .run_log import LoggedRun, RunLog
from .walker import Walker


def run_policy(
    walker: Walker,
    policy: Policy,
    bounces: Sequence[float],
    *,
    log: RunLog | None = None,
    limit: int = 10_000,
) -> RunOutcome:
    """Let a robot choose its angle at each bump until it knows where it is, or cannot be.

    **Arguments:**

    - `walker`: the robot, at the centre of an unknown cell.
    - `policy`: a localization policy.
    - `bounces`: the angles that it chooses from, in radians, counter-clockwise.
    - `log`: where to write each observation as it comes.
    - `limit`: how many observations to make at most.

    **Returns:** [`RunOutcome`][]. Where the robot is localized it has not turned after its last
    bump: its cells have the heading that it came with.

    A point robot in a corridor of three cells, and a policy for robots that go West or East in it,
    which learn at the second bump which way they went at first:

        >>> import math
        >>> import numpy as np
        >>> from jaxcell import examples, robot
        >>> from jaxcell.automata import Policy
        >>> walker = examples.walker(x=1.5)
        >>> policy = Policy(
        ...     turn=np.int32([-1, 0, -1]), first=np.int32([0, 1, 2, 2]),
        ...     steps=np.int32([1, 2]), target=np.int32([1, 2]),
        ...     offsets=np.int32([0, 2, 3, 4]), members=np.int32([0, 1, 2, 3]),
        ... )
        >>> outcome = robot.run_policy(walker, policy, [math.pi])
        >>> outcome.result, outcome.observations, outcome.cells
        ('localized', '01001', (3,))
    """
    return follow(walker, PolicyFollower(policy), bounces, log, limit)


def replay_policy(run: LoggedRun, policy: Policy) -> RunOutcome:
    """Give a policy what a robot sensed in a logged run.

    **Arguments:**

    - `run`: the log of a run of a policy.
    - `policy`: the policy that was run.

    **Returns:** [`RunOutcome`][], that of the run if it was not cut off.

    **Raises:** `ValueError`, with the index of the observation, if the log has another colour for
    it, or goes on after the end of the run: it is of another policy.

    The log of a robot that bumped at once, where the policy has two steps:

        >>> import numpy as np
        >>> from jaxcell import robot
        >>> from jaxcell.automata import Policy
        >>> policy = Policy(
        ...     turn=np.int32([-1, -1]), first=np.int32([0, 1, 1]), steps=np.int32([2]),
        ...     target=np.int32([1]), offsets=np.int32([0, 2, 3]), members=np.int32([0, 1, 1]),
        ... )
        >>> events = ({"event": "observation", "observation": 1},)
        >>> robot.replay_policy(robot.LoggedRun({}, events, True), policy).result
        'refuted'
    """
    return replay(run, PolicyFollower(policy))


class PolicyFollower(Follower):
    """A policy along a run."""

    kind = "policy"

    def __init__(self, policy: Policy) -> None:
        super().__init__()
        self._state = policy.start()

    def observe(self, observation: int) -> None:
        self.observations += str(observation)
        self._state = self._state.observe(observation)
        self.colors.append(self._state.color)
        if self._state.refuted:
            self.result = "refuted"
        elif self._state.localized:
            self.result = "localized"

    @property
    def turn(self) -> int | None:
        return self._state.turn

    @property
    def cells(self) -> list[int]:
        return self._state.cells.tolist()

    @property
    def fields(self) -> dict[str, Any]:
        # It has a state only at a bump.
        state = self._state
        known = not state.refuted and not state.steps
        return {
            "color": state.color,
            "state": state.index if known else None,
            "uncertainty": state.uncertainty,
        }
