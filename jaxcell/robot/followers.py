import abc
from collections.abc import Sequence
from typing import Any, ClassVar, Literal, TypeAlias

from ..automata import Belief, Evidence, Filter, Policy
from ..automata.belief import NOWHERE, SMALL
from ..automata.filter import CONFIRM
from .outcome import RunOutcome, count_agreed, observed
from .run_log import LoggedRun, RunLog, finished
from .walker import Walker


Until: TypeAlias = Literal["known", "cycle"]
"""The condition that ends the run of a filter. With `"cycle"` the run ends in a knowledge cycle, a
cycle of states that no observation leaves; with `"known"` also when one configuration is left."""


class Follower(abc.ABC):
    """The state of a run in which observations localize a robot whose start is unknown.

    On a wrong map, too, the observations soon leave one configuration. So the robot goes on, and it
    is localized only when `confirm` further observations have not refuted the map. A belief needs
    evidence for its map instead.
    """

    kind: ClassVar[str]
    _state: Any
    observations: str
    "The observations of the robot: 0 for a step, 1 for a bump."
    colors: list[int]
    "The output (colour) of the filter or policy after each observation; empty for a belief."
    result: Literal["localized", "refuted"] | None
    "The result of the run, or `None` before its end."
    confirm: int
    "The number of further observations, or decibans, that confirm the place of the robot."
    agreed: int | None
    "The number of observations since the place of the robot was first known, or `None` before."

    def __init__(self, confirm: int) -> None:
        if confirm < 0:
            raise ValueError(f"confirm: expected a number of observations from 0, got {confirm}")
        self.observations, self.colors, self.result = "", [], None
        self.confirm, self.agreed = confirm, None

    def observe(self, observation: int) -> None:
        """Update the possible cells with the next observation: 0 for a step, 1 for a bump."""
        self.observations += str(observation)
        self._update(observation)
        if self.result is not None:
            return
        self.agreed = count_agreed(self.agreed, self._known)
        if self._known and self._confirmed:
            self.result = "localized"

    def _update(self, observation: int) -> None:
        """Update the state, and set the result if the observation refutes the map."""
        self._state = self._state.observe(observation)
        self.colors.append(self._state.color)
        if self._state.refuted:
            self.result = "refuted"

    @property
    @abc.abstractmethod
    def _known(self) -> bool:
        """True if the place of the robot is known now, unless the map is wrong."""

    @property
    def _confirmed(self) -> bool:
        """True if the place of the robot, once known, has been confirmed."""
        return self.agreed is not None and self.agreed >= self.confirm

    @property
    def over(self) -> bool:
        """True if the log of a run cannot contain a further observation."""
        return self.result is not None

    @property
    @abc.abstractmethod
    def turn(self) -> int | None:
        """The index of the bouncing angle by which the robot must turn now; `None` for no turn."""

    @property
    def cells(self) -> list[int]:
        """The possible cells of the robot."""
        return self._state.cells.tolist()

    @property
    @abc.abstractmethod
    def fields(self) -> dict[str, Any]:
        """The part of the state that is logged with each observation, as JSON values."""

    @property
    def localized(self) -> str:
        """A sentence that explains how the robot was localized."""
        agreed = self.agreed or 0
        known = f"localized to {self.places} after {len(self.observations) - agreed} observations"
        return f"{known}, and {agreed} more agreed" if agreed else known

    @property
    def _proof(self) -> str:
        """The evidence that confirms the place of the robot, in words."""
        return f"{self.confirm} observations"

    @property
    def refuted(self) -> str:
        """A sentence that explains the result `"refuted"`."""
        reason = (
            f"observation {len(self.observations) - 1} is {self.observations[-1]}, which cannot "
            f"occur in the map of the {self.kind} after the observations before it: the robot is "
            "on another map, or it slipped"
        )
        if self.agreed is not None:
            reason += f" (its place was known, and {self.agreed} more observations had agreed)"
        return reason

    @property
    def places(self) -> str:
        """The number of possible cells, in words."""
        count = self._count
        return "1 configuration" if count == 1 else f"{count} configurations"

    @property
    def _count(self) -> int:
        return int(self._state.uncertainty)

    def outcome(self) -> RunOutcome:
        """Return the outcome of the run so far."""
        cells, colors = tuple(self.cells), tuple(self.colors)
        if self.result == "localized":
            reason = self.localized
        elif self.result == "refuted":
            reason, cells = observed(self.refuted, self.observations), ()
        elif self.agreed is not None:
            reason = f"not confirmed by {self._proof}: {self.localized}"
        else:
            count = len(self.observations)
            reason = f"not localized after {count} observations; {self.places} left"
        return RunOutcome(self.result or "unfinished", self.observations, reason, colors, cells)


class FilterFollower(Follower):
    """The state of a localization filter during a run (Alam 2018, section 2.4).

    An impossible observation ends the run as refuted, even if the filter has no trap state.
    """

    kind = "filter"

    def __init__(self, filter: Filter, until: Until = "known", *, confirm: int = CONFIRM) -> None:
        """Start the filter; `until` is the condition that is to be confirmed."""
        super().__init__(confirm)
        self._filter, self._state, self._until = filter, filter.start(), until

    def _update(self, observation: int) -> None:
        if self._filter.transition[self._state.index, observation] < 0:
            self.colors.append(0)
            self.result = "refuted"
        else:
            super()._update(observation)

    @property
    def _known(self) -> bool:
        return self._state.localized or (self._until == "known" and self._state.uncertainty == 1)

    @property
    def over(self) -> bool:
        # With `until="cycle"`, a run continues after one configuration is left.
        return self.result == "refuted" or (self.result is not None and self._state.localized)

    @property
    def turn(self) -> int | None:
        return 0 if self.observations[-1] == "1" and self.result != "refuted" else None

    @property
    def fields(self) -> dict[str, Any]:
        refuted = self.result == "refuted"
        return {
            "color": self.colors[-1],
            "state": None if refuted else self._state.index,
            "uncertainty": 0 if refuted else self._state.uncertainty,
        }


class PolicyFollower(Follower):
    """The state of a localization policy, which chooses the bouncing angle at each bump.

    After the end of the policy the robot turns by the angle `policy.onward.turn`, and the run ends
    at a bump. A policy without the table `onward` cannot be confirmed, so `confirm` becomes 0.
    """

    kind = "policy"

    def __init__(self, policy: Policy, *, confirm: int = CONFIRM) -> None:
        super().__init__(0 if policy.onward is None else confirm)
        self._state = policy.start()

    @property
    def _known(self) -> bool:
        return self._state.localized and not self._state.steps

    @property
    def turn(self) -> int | None:
        onward = self._state.policy.onward
        if self._known and self.result is None and onward is not None:
            return int(onward.turn)
        return self._state.turn

    @property
    def fields(self) -> dict[str, Any]:
        # A policy has a numbered state only at a bump.
        state = self._state
        known = not state.refuted and not state.steps
        return {
            "color": state.color,
            "state": state.index if known else None,
            "uncertainty": state.uncertainty,
        }


class BeliefFollower(Follower):
    """The belief about the configuration of a slipping robot during a run.

    The robot is localized when its credible set, the fewest configurations with a total probability
    of at least `belief.share`, has at most four configurations, and there are `confirm` decibans of
    [`jaxcell.automata.Evidence`][] for the map. The map is refuted by 30 decibans against it, or
    when the probability that the robot is nowhere on it exceeds 0.99. With `confirm=0` the evidence
    is not used.
    """

    kind = "belief"

    def __init__(self, belief: Belief, *, confirm: int = CONFIRM) -> None:
        super().__init__(confirm)
        self._belief, self._state = belief, belief.start()
        self.evidence = Evidence()
        "The evidence for the map."
        self.estimate = belief.estimate(self._state)
        "The credible set after the last observation."

    def _update(self, observation: int) -> None:
        self._state = self._belief.observe(self._state, observation)
        self.estimate = self._belief.estimate(self._state)
        self.evidence.observe(observation, self._state.expected)
        doubted = self.confirm > 0 and self.evidence.decibans <= -CONFIRM
        if self.estimate.nowhere > NOWHERE or doubted:
            self.result = "refuted"

    @property
    def _confirmed(self) -> bool:
        return not self.confirm or self.evidence.decibans >= self.confirm

    @property
    def _proof(self) -> str:
        return f"evidence of {self.confirm} decibans"

    @property
    def _known(self) -> bool:
        return self._count <= SMALL

    @property
    def turn(self) -> int | None:
        return None if self.result == "refuted" else self._state.turn

    @property
    def cells(self) -> list[int]:
        return self.estimate.cells.tolist()

    @property
    def _count(self) -> int:
        return int(self.estimate.cells.size)

    @property
    def fields(self) -> dict[str, Any]:
        cells = self.estimate.cells
        return {
            "credible": int(cells.size),
            "nowhere": round(self.estimate.nowhere, 6),
            "decibans": round(max(self.evidence.decibans, -1e6), 2),
            "likeliest": int(cells[0]) if cells.size else None,
        }

    @property
    def localized(self) -> str:
        return (
            f"localized to {self.places}, which hold the robot with probability "
            f"{float(self.estimate.probability.sum()):.3g}, after {len(self.observations)} "
            f"observations; {self.evidence.words}"
        )

    @property
    def refuted(self) -> str:
        count = len(self.observations)
        why = f"with probability {self.estimate.nowhere:.3g}"
        if self.estimate.nowhere <= NOWHERE:
            why = self.evidence.words
        return (
            f"the belief is nowhere on the map after {count} observations, {why}: the robot is on "
            "another map, or slips more"
        )


def run_follower(
    walker: Walker,
    follower: Follower,
    bounces: Sequence[float],
    *,
    log: RunLog | None = None,
    limit: int = 10_000,
) -> RunOutcome:
    """Drive a bouncing robot until a filter, a policy or a belief ends the run.

    **Arguments:**

    - `walker`: a robot at the centre of an unknown cell.
    - `follower`: the filter, policy or belief before the first observation.
    - `bounces`: the bouncing angles to choose from, in radians counter-clockwise; one for a filter.
    - `log`: the log, to which each observation is written immediately.
    - `limit`: the largest number of observations.

    **Returns:** the outcome.

    A simulated robot in a corridor of three cells drives West, until the filter knows that it is at
    the western end:

        >>> from jaxcell import examples, robot
        >>> walker = examples.walker(x=2.5, direction=2)
        >>> import numpy as np
        >>> from jaxcell.automata import Filter, subset_construction
        >>> image, bumped = np.int32([0, 0, 1]), np.array([True, False, False])
        >>> filter = Filter.of(subset_construction(image, bumped))
        >>> follower = robot.FilterFollower(filter, confirm=3)
        >>> outcome = robot.run_follower(walker, follower, [0.0])
        >>> outcome.result, outcome.observations, outcome.cells
        ('localized', '00111', (0,))
        >>> outcome.reason
        'localized to 1 configuration after 2 observations, and 3 more agreed'
    """
    while follower.result is None and len(follower.observations) < limit:
        follower.observe(int(walker.step()))
        if log is not None:
            agreed = {} if follower.agreed is None else {"agreed": follower.agreed}
            log.observation(walker, **follower.fields, **agreed)
        if follower.turn is not None:
            walker.rotate(bounces[follower.turn])
    return finished(follower.outcome(), log)


def replay_follower(run: LoggedRun, follower: Follower) -> RunOutcome:
    """Replay the observations of a logged run through its filter, policy or belief.

    **Arguments:** a log, and a follower before the first observation. **Returns:** the outcome of
    the run so far.

    **Raises:** `ValueError`, with the index of the observation, if a colour in the log differs from
    that of the follower, or the log continues after the end of the run. Then the log belongs to
    another filter, policy or belief.

    The log of a robot that bumped in a room where no robot can bump:

        >>> import numpy as np
        >>> from jaxcell import automata, robot
        >>> free = automata.HiddenMap.of(np.eye(6), np.zeros((6, 6)), np.arange(6), np.ones(6) / 6)
        >>> run = robot.LoggedRun({}, ({"event": "observation", "observation": 1},), True)
        >>> robot.replay_follower(run, robot.BeliefFollower(automata.Belief(free))).result
        'refuted'
    """
    colors, kind = run.colors, follower.kind
    for i, observation in enumerate(run.observations):
        if follower.over:
            raise ValueError(
                f"observation {i}: the {kind} has come to its end; the log is of another {kind}"
            )
        follower.observe(int(observation))
        if i < len(colors) and colors[i] != follower.colors[i]:
            raise ValueError(
                f"observation {i}: the log has colour {colors[i]}, the {kind} "
                f"{follower.colors[i]}; the log is of another {kind}"
            )
    return follower.outcome()
