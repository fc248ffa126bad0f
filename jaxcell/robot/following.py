import abc
from collections.abc import Sequence
from typing import Any, ClassVar, Literal

from .outcome import RunOutcome, observed
from .run_log import LoggedRun, RunLog, finished
from .walker import Walker


class Follower(abc.ABC):
    """The cells where a robot may be, along a run from an unknown cell."""

    kind: ClassVar[str]
    observations: str
    "What the robot sensed: 0 for a step, 1 for a bump."
    colors: list[int]
    "The colour after each observation; empty for a belief."
    result: Literal["localized", "refuted"] | None
    "The result of the run, or `None` while it goes on."

    def __init__(self) -> None:
        self.observations, self.colors, self.result = "", [], None

    @abc.abstractmethod
    def observe(self, observation: int) -> None:
        """Take the next observation, 0 or 1."""

    @property
    def over(self) -> bool:
        """Whether the run cannot go on from here."""
        return self.result is not None

    @property
    @abc.abstractmethod
    def turn(self) -> int | None:
        """The number of the angle to turn by now, or `None`."""

    @property
    @abc.abstractmethod
    def cells(self) -> list[int]:
        """The cells where the robot may be."""

    @property
    @abc.abstractmethod
    def fields(self) -> dict[str, Any]:
        """The fields of the last observation in the log."""

    @property
    def localized(self) -> str:
        """The sentence that reports a localized robot."""
        return f"localized to {self.places} after {len(self.observations)} observations"

    @property
    def refuted(self) -> str:
        """The sentence that reports a contradiction."""
        return (
            f"observation {len(self.observations) - 1} is {self.observations[-1]}, which cannot "
            f"occur in the map of the {self.kind} after those before it: the map is another, or "
            "the robot slipped"
        )

    @property
    def places(self) -> str:
        """The number of cells that are left, in words."""
        count = len(self.cells)
        return "1 configuration" if count == 1 else f"{count} configurations"

    def outcome(self) -> RunOutcome:
        """Make the outcome of the run so far."""
        cells, colors = tuple(self.cells), tuple(self.colors)
        if self.result == "localized":
            reason = self.localized
        elif self.result == "refuted":
            reason, cells = observed(self.refuted, self.observations), ()
        else:
            count = len(self.observations)
            reason = f"not localized after {count} observations; {self.places} left"
        return RunOutcome(self.result or "unfinished", self.observations, reason, colors, cells)


def follow(
    walker: Walker, follower: Follower, bounces: Sequence[float], log: RunLog | None, limit: int
) -> RunOutcome:
    """Let a robot bounce until its follower ends the run, for at most `limit` observations."""
    while follower.result is None and len(follower.observations) < limit:
        follower.observe(int(walker.step()))
        if log is not None:
            log.observation(walker, **follower.fields)
        if follower.turn is not None:
            walker.rotate(bounces[follower.turn])
    return finished(follower.outcome(), log)


def replay(run: LoggedRun, follower: Follower) -> RunOutcome:
    """Replay the observations of a logged run through a follower.

    **Raises:** `ValueError`, with the index of the observation, if the log has another colour for
    it, or goes on after the end of the run: it is of another filter, policy or belief.
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
