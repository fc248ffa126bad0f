from collections.abc import Sequence
from typing import Any, Literal

from ..automata import Policy
from .outcome import RunOutcome, observed
from .run_log import LoggedRun, RunLog, finished
from .walker import Walker


def run_policy(
    walker: Walker,
    policy: Policy,
    bounces: Sequence[float],
    *,
    log: RunLog | None = None,
    limit: int = 10_000,
) -> RunOutcome:
    """Lets a robot choose its angle at each bump until it knows where it is, or cannot be.

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
        >>> from jaxcell import robot, space
        >>> from jaxcell.automata import Policy
        >>> from jaxcell.robot.emulation.body import Body
        >>> from jaxcell.robot.emulation.simulated import SimulatedCreate
        >>> room = space.Workspace([(0, 0), (3, 0), (3, 1), (0, 1)])
        >>> body = Body(room, (1.5, 0.5, 0.0))
        >>> walker = robot.Walker(SimulatedCreate(body), 1.0)
        >>> policy = Policy(
        ...     turn=np.int32([-1, 0, -1]), first=np.int32([0, 1, 2, 2]),
        ...     steps=np.int32([1, 2]), target=np.int32([1, 2]),
        ...     offsets=np.int32([0, 2, 3, 4]), members=np.int32([0, 1, 2, 3]),
        ... )
        >>> outcome = robot.run_policy(walker, policy, [math.pi])
        >>> outcome.result, outcome.observations, outcome.cells
        ('localized', '01001', (3,))
    """
    follower = _Follower(policy)
    while follower.result is None and len(follower.colors) < limit:
        follower.observe(int(walker.step()))
        if log is not None:
            log.observation(walker, **follower.fields)
        if follower.turn is not None:
            walker.rotate(bounces[follower.turn])
    return finished(follower.outcome(), log)


def replay_policy(run: LoggedRun, policy: Policy) -> RunOutcome:
    """Gives a policy what a robot sensed in a logged run.

    **Arguments:**

    - `run`: the log of a run of a policy.
    - `policy`: the policy that was run.

    **Returns:** [`RunOutcome`][], that of the run if it was not cut off.

    **Raises:** `ValueError`, with the index of the observation, if the log has another colour for
    it, or goes on after the end of the policy: it is of another policy.

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
    follower = _Follower(policy)
    for i, observation in enumerate(run.observations):
        if follower.result is not None:
            raise ValueError(f"observation {i}: the policy has come to its end")
        follower.observe(int(observation))
    for i, (logged, color) in enumerate(zip(run.colors, follower.colors, strict=False)):
        if logged != color:
            raise ValueError(
                f"observation {i}: the log has colour {logged}, the policy {color}; the log is of "
                "another policy"
            )
    return follower.outcome()


class _Follower:
    """A policy along a run, which says when it is over."""

    def __init__(self, policy: Policy) -> None:
        self.colors: list[int] = []
        self._observations = ""
        self._state = policy.start()

    def observe(self, observation: int) -> None:
        """Takes the next observation, 0 or 1."""
        self._observations += str(observation)
        self._state = self._state.observe(observation)
        self.colors.append(self._state.color)

    @property
    def turn(self) -> int | None:
        """The angle to turn by now, by number, if any."""
        return self._state.turn

    @property
    def result(self) -> Literal["localized", "refuted"] | None:
        if self._state.refuted:
            return "refuted"
        return "localized" if self._state.localized else None

    @property
    def fields(self) -> dict[str, Any]:
        """What the log has of the last observation; a state only at a bump."""
        state = self._state
        known = not state.refuted and not state.steps
        return {
            "color": state.color,
            "state": state.index if known else None,
            "uncertainty": state.uncertainty,
        }

    def outcome(self) -> RunOutcome:
        """How it ended, or stands."""
        count, cells = len(self._observations), self._state.cells.tolist()
        if self.result == "localized":
            places = "1 configuration" if len(cells) == 1 else f"{len(cells)} configurations"
            reason = f"localized to {places} after {count} observations"
        elif self.result == "refuted":
            reason = observed(
                f"observation {count - 1} is {self._observations[-1]}, which cannot occur in the "
                "map of the policy after those before it: the map is another, or the robot slipped",
                self._observations,
            )
        else:
            left = self._state.uncertainty
            reason = f"not localized after {count} observations; {left} configurations left"
        return RunOutcome(
            self.result or "unfinished",
            self._observations,
            reason,
            tuple(self.colors),
            tuple(cells),
        )
