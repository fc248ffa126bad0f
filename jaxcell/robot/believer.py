from collections.abc import Sequence
from typing import Any

from ..automata import Belief
from ..automata.belief import NOWHERE, SMALL
from .following import Follower, follow, replay
from .outcome import RunOutcome
from .run_log import LoggedRun, RunLog
from .walker import Walker


def run_belief(
    walker: Walker,
    belief: Belief,
    bounces: Sequence[float],
    *,
    log: RunLog | None = None,
    limit: int = 10_000,
) -> RunOutcome:
    """Let a robot that slips bounce until its belief knows where it is, or that it is nowhere.

    It is localized when the credible set has at most four configurations. It stops when it is
    nowhere on the map with a probability of 0.99.

    **Arguments:**

    - `walker`: the robot, at the centre of an unknown cell.
    - `belief`: that of a map.
    - `bounces`: the angles that it chooses from, or its one, in radians, counter-clockwise.
    - `log`: where to write each observation as it comes.
    - `limit`: how many observations to make at most.

    **Returns:** [`RunOutcome`][]: `"refuted"` where it is nowhere.

    A point robot in a corridor of three cells, without a serial line, and a map of robots that go
    West in it and bump at the end:

        >>> import numpy as np
        >>> from jaxcell import automata, examples, robot
        >>> walker = examples.walker()
        >>> never = automata.HiddenMap.of(np.zeros((6, 6)), np.eye(6), np.arange(6), np.ones(6) / 6)
        >>> robot.run_belief(walker, automata.Belief(never), [0.0]).result
        'refuted'
    """
    return follow(walker, BeliefFollower(belief), bounces, log, limit)


def replay_belief(run: LoggedRun, belief: Belief) -> RunOutcome:
    """Give a belief what a robot sensed in a logged run.

    **Arguments:**

    - `run`: the log of a run of a belief.
    - `belief`: the belief that was run.

    **Returns:** [`RunOutcome`][], that of the run if it was not cut off.

    The log of a robot that bumped where none can:

        >>> import numpy as np
        >>> from jaxcell import automata, robot
        >>> free = automata.HiddenMap.of(np.eye(6), np.zeros((6, 6)), np.arange(6), np.ones(6) / 6)
        >>> events = ({"event": "observation", "observation": 1},)
        >>> robot.replay_belief(robot.LoggedRun({}, events, True), automata.Belief(free)).result
        'refuted'
    """
    return replay(run, BeliefFollower(belief))


class BeliefFollower(Follower):
    """A belief along a run."""

    kind = "belief"

    def __init__(self, belief: Belief) -> None:
        super().__init__()
        self._belief, self._state = belief, belief.start()
        self._estimate = belief.estimate(self._state)

    def observe(self, observation: int) -> None:
        self.observations += str(observation)
        self._state = self._belief.observe(self._state, observation)
        self._estimate = self._belief.estimate(self._state)
        if self._estimate.nowhere > NOWHERE:
            self.result = "refuted"
        elif self._estimate.cells.size <= SMALL:
            self.result = "localized"

    @property
    def turn(self) -> int | None:
        return None if self.result == "refuted" else self._state.turn

    @property
    def cells(self) -> list[int]:
        return self._estimate.cells.tolist()

    @property
    def fields(self) -> dict[str, Any]:
        cells = self._estimate.cells
        return {
            "credible": int(cells.size),
            "nowhere": round(self._estimate.nowhere, 6),
            "likeliest": int(cells[0]) if cells.size else None,
        }

    @property
    def localized(self) -> str:
        return (
            f"localized after {len(self.observations)} observations to {self.places}, which hold "
            f"the robot with probability {float(self._estimate.probability.sum()):.3g}"
        )

    @property
    def refuted(self) -> str:
        return (
            f"the belief is nowhere on the map after {len(self.observations)} observations, with "
            f"probability {self._estimate.nowhere:.3g}: the map is another, or the robot slips more"
        )
