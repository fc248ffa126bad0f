from typing import Any, Literal

from ..automata import Belief
from ..automata.belief import NOWHERE, SMALL
from .outcome import RunOutcome, observed
from .run_log import LoggedRun, RunLog, finished
from .walker import Walker


def run_belief(
    walker: Walker, belief: Belief, bounce: float, *, log: RunLog | None = None, limit: int = 10_000
) -> RunOutcome:
    """Lets a robot that slips bounce until its belief knows where it is, or that it is nowhere.

    It is localized when the credible set has at most four configurations. It stops when it is
    nowhere on the map with a probability of 0.99.

    **Arguments:**

    - `walker`: the robot, at the centre of an unknown cell.
    - `belief`: that of a map.
    - `bounce`: the bouncing angle that it is for, in radians, counter-clockwise.
    - `log`: where to write each observation as it comes.
    - `limit`: how many observations to make at most.

    **Returns:** [`RunOutcome`][]: `"refuted"` where it is nowhere.

    A point robot in a corridor of three cells, without a serial line, and a map of robots that go
    West in it and bump at the end:

        >>> import math
        >>> import numpy as np
        >>> from jaxcell import automata, robot, space
        >>> from jaxcell.robot.emulation.body import Body
        >>> from jaxcell.robot.emulation.simulated import SimulatedCreate
        >>> room = space.Workspace([(0, 0), (3, 0), (3, 1), (0, 1)])
        >>> body = Body(room, (0.5, 0.5, 0.0))
        >>> walker = robot.Walker(SimulatedCreate(body), 1.0)
        >>> never = automata.HiddenMap.of(np.zeros((6, 6)), np.eye(6), np.arange(6), np.ones(6) / 6)
        >>> robot.run_belief(walker, automata.Belief(never), 0.0).result
        'refuted'
    """
    follower = _Believer(belief)
    while follower.result is None and len(follower.observations) < limit:
        bumped = walker.step()
        follower.observe(int(bumped))
        if log is not None:
            log.observation(walker, **follower.fields)
        if bumped and follower.result != "refuted":
            walker.rotate(bounce)
    return finished(follower.outcome(), log)


def replay_belief(run: LoggedRun, belief: Belief) -> RunOutcome:
    """Gives a belief what a robot sensed in a logged run.

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
    follower = _Believer(belief)
    for observation in run.observations:
        follower.observe(int(observation))
    return follower.outcome()


class _Believer:
    """A belief along a run, which says when it is over."""

    def __init__(self, belief: Belief) -> None:
        self.observations = ""
        self.result: Literal["localized", "refuted"] | None = None
        self._belief, self._state = belief, belief.start()
        self._estimate = belief.estimate(self._state)

    def observe(self, observation: int) -> None:
        """Takes the next observation, 0 or 1."""
        self.observations += str(observation)
        self._state = self._belief.observe(self._state, observation)
        self._estimate = self._belief.estimate(self._state)
        if self._estimate.nowhere > NOWHERE:
            self.result = "refuted"
        elif self._estimate.cells.size <= SMALL:
            self.result = "localized"

    @property
    def fields(self) -> dict[str, Any]:
        """What the log has of the last observation."""
        cells = self._estimate.cells
        return {
            "credible": int(cells.size),
            "nowhere": round(self._estimate.nowhere, 6),
            "likeliest": int(cells[0]) if cells.size else None,
        }

    def outcome(self) -> RunOutcome:
        """How it ended, or stands."""
        count, cells = len(self.observations), self._estimate.cells.tolist()
        places = "1 configuration" if len(cells) == 1 else f"{len(cells)} configurations"
        share = float(self._estimate.probability.sum())
        if self.result == "localized":
            reason = (
                f"localized after {count} observations to {places}, which hold the robot with "
                f"probability {share:.3g}"
            )
        elif self.result == "refuted":
            reason = observed(
                f"the belief is nowhere on the map after {count} observations, with probability "
                f"{self._estimate.nowhere:.3g}: the map is another, or the robot slips more",
                self.observations,
            )
            cells = []
        else:
            reason = f"not localized after {count} observations; {places} left"
        return RunOutcome(
            self.result or "unfinished", self.observations, reason, cells=tuple(cells)
        )
