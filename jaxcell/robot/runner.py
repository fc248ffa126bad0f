from collections.abc import Sequence
from typing import Any, Literal, TypeAlias

from ..automata import Filter
from .following import Follower, follow, replay
from .outcome import RunOutcome, observed
from .run_log import LoggedRun, RunLog, finished
from .walker import Walker


Until: TypeAlias = Literal["known", "cycle"]
"""The end of a run of a filter: one configuration left or a knowledge cycle, or only the cycle."""


def run_filter(
    walker: Walker,
    filter: Filter,
    bounce: float,
    *,
    log: RunLog | None = None,
    limit: int = 10_000,
    until: Until = "known",
) -> RunOutcome:
    """Let a robot bounce until a filter knows where it is, or that it cannot be in the map.

    At each bump the robot turns by the bouncing angle (Alam 2018, section 2.4).

    **Arguments:**

    - `walker`: the robot, at the centre of an unknown cell.
    - `filter`: a localization filter of either kind: an observation that cannot occur refutes it
        also where it has no trap.
    - `bounce`: the bouncing angle that the filter is for, in radians, counter-clockwise.
    - `log`: where to write each observation as it comes.
    - `limit`: how many observations to make at most.
    - `until`: `"known"` ends the run when one configuration is left, or in a knowledge cycle;
        `"cycle"` ends it only in a knowledge cycle.

    **Returns:** [`RunOutcome`][].

    A point robot in a corridor of three cells, without a serial line, and a filter for robots that
    go West in it and stay at the end:

        >>> from jaxcell import examples, robot
        >>> walker = examples.walker(x=2.5, direction=2)
        >>> import numpy as np
        >>> from jaxcell.automata import Filter, subset_construction
        >>> image, bumped = np.int32([0, 0, 1]), np.array([True, False, False])
        >>> filter = Filter.of(subset_construction(image, bumped))
        >>> outcome = robot.run_filter(walker, filter, 0.0)
        >>> outcome.result, outcome.observations, outcome.cells
        ('localized', '00', (0,))
    """
    return follow(walker, FilterFollower(filter, until), [bounce], log, limit)


def run_plan(
    walker: Walker, actions: Sequence[float | int], *, log: RunLog | None = None
) -> RunOutcome:
    """Let a robot follow the action string of a navigation plan (Alam 2018, section 3.4.1).

    **Arguments:**

    - `walker`: the robot, at the centre of the plan's first cell, in its direction.
    - `actions`: 0 for a step forward, else the angle to turn by at a bump, in radians,
        counter-clockwise; as `jaxcell.bounce.Plan.actions`.
    - `log`: where to write each observation as it comes.

    **Returns:** [`RunOutcome`][]: `"refuted"` at the first step that meets a wall where none can
    be, or none where one must be.

    A point robot in a corridor of three cells, without a serial line; it goes to the end and turns:

        >>> import math
        >>> from jaxcell import examples, robot
        >>> walker = examples.walker()
        >>> outcome = robot.run_plan(walker, [0.0, 0.0, math.pi / 2])
        >>> outcome.result, outcome.observations
        ('arrived', '001')
    """
    for index, action in enumerate(actions):
        bumped = walker.step()
        if log is not None:
            log.observation(walker, action=index)
        if bumped != (action != 0):
            break
        if bumped:
            walker.rotate(action)
    return finished(plan_outcome(actions, walker.observations), log)


def plan_outcome(actions: Sequence[float | int], observations: str) -> RunOutcome:
    """How a plan ended, or stands, by what the robot sensed on it.

    **Arguments:**

    - `actions`: as for [`run_plan`][].
    - `observations`: 0 for a step and 1 for a bump, one for each action that was tried.

    **Returns:** [`RunOutcome`][].

    The second step met a wall where none can be:

        >>> from jaxcell import robot
        >>> robot.plan_outcome([0.0, 0.0], "01").result
        'refuted'
    """
    for index, (action, observation) in enumerate(zip(actions, observations, strict=False)):
        if (observation == "1") != (action != 0):
            slip = (
                "the robot bumped where the plan has free space"
                if observation == "1"
                else "the robot met no wall where the plan has one"
            )
            reason = observed(f"action {index} of {len(actions)}: {slip}", observations)
            return RunOutcome("refuted", observations, reason)
    if len(observations) < len(actions):
        reason = f"{len(observations)} of {len(actions)} actions are done"
        return RunOutcome("unfinished", observations, reason)
    return RunOutcome("arrived", observations, f"all {len(actions)} actions are done")


def replay_filter(run: LoggedRun, filter: Filter) -> RunOutcome:
    """Give a filter what a robot sensed in a logged run.

    **Arguments:**

    - `run`: the log of a run of a filter.
    - `filter`: the filter that was run.

    **Returns:** [`RunOutcome`][], that of the run if it was not cut off. It is localized where
    one configuration is left, unless `until` in the header of the log is `"cycle"`.

    **Raises:** `ValueError`, with the index of the observation, if the log has another colour for
    it, or goes on after a knowledge cycle was reached or the filter refuted: it is of another
    filter.

    The log of a robot that met a wall, and a filter for robots that go to cell 0 and stay:

        >>> from jaxcell import robot
        >>> import numpy as np
        >>> from jaxcell.automata import Filter, subset_construction
        >>> image, bumped = np.int32([0, 0, 1]), np.array([True, False, False])
        >>> filter = Filter.of(subset_construction(image, bumped))
        >>> events = ({"event": "observation", "observation": 1},)
        >>> robot.replay_filter(robot.LoggedRun({}, events, True), filter).result
        'localized'
    """
    return replay(run, FilterFollower(filter, run.header.get("until", "known")))


class FilterFollower(Follower):
    """A filter along a run."""

    kind = "filter"

    def __init__(self, filter: Filter, until: Until = "known") -> None:
        super().__init__()
        self._filter, self._state, self._until = filter, filter.start(), until

    def observe(self, observation: int) -> None:
        self.observations += str(observation)
        if self._filter.transition[self._state.index, observation] < 0:
            self.result = "refuted"
            self.colors.append(0)
            return
        self._state = self._state.observe(observation)
        self.colors.append(self._state.color)
        if self._state.refuted:
            self.result = "refuted"
        elif self._state.localized or (self._until == "known" and self._state.uncertainty == 1):
            self.result = "localized"

    @property
    def over(self) -> bool:
        # A run until the cycle goes on from where one configuration is left.
        return self.result == "refuted" or self._state.localized

    @property
    def turn(self) -> int | None:
        return 0 if self.observations[-1] == "1" and self.result != "refuted" else None

    @property
    def cells(self) -> list[int]:
        return self._state.cells.tolist()

    @property
    def fields(self) -> dict[str, Any]:
        refuted = self.result == "refuted"
        return {
            "color": self.colors[-1],
            "state": None if refuted else self._state.index,
            "uncertainty": 0 if refuted else self._state.uncertainty,
        }
