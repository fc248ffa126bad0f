import json
import math
from pathlib import Path
from typing import TYPE_CHECKING

from .replay import replayed


if TYPE_CHECKING:
    from ...robot.create.motion import Moved
    from ...robot.run_log import LoggedRun
    from ...robot.tasks.files import AnyTask
    from ...robot.walker import Walker


def run_before(log: Path, task: "AnyTask") -> "LoggedRun":
    """The run that is to go on, by its log.

    **Raises:** `ValueError` if the log is of another task, or if its run has come to its end.
    """
    from ...robot.run_log import read_log

    run = read_log(log)
    for name, ours in json.loads(json.dumps(task.header)).items():
        theirs = run.header.get(name)
        # A file may have moved.
        if name == "file" or theirs == ours:
            continue
        if name == "sha256":
            raise ValueError(
                f"--resume {log}: it is of another {task.header['kind']} than {task.path}"
            )
        raise ValueError(f"--resume {log}: {name}: the log has {theirs}, {task.path} has {ours}")
    if "direction" not in run.header:
        raise ValueError(f"--resume {log}: direction: it is missing")
    try:
        outcome = replayed(run, task.path)
    except (ValueError, KeyError) as error:
        raise ValueError(f"--resume {log}: {error}") from error
    if not run.observations:
        raise ValueError(f"--resume {log}: it has no observation; expected a run without --resume")
    if outcome.result not in ("unfinished", "stopped"):
        raise ValueError(f"--resume {log}: that run has come to its end: {outcome.reason}")
    return run


class Standing:
    """A robot that does not move: what has it drive is told so."""

    def forward(self, distance: float, *, tolerance: float) -> "Moved":
        """Raise `StandingStill`."""
        raise StandingStill

    def turn(self, angle: float, *, tolerance: float) -> "Moved":
        """Raise `StandingStill`."""
        raise StandingStill


class StandingStill(Exception):  # noqa: N818 (it says what happened, as StopIteration does)
    """A robot that does not move was to drive."""


def place_in_words(walker: "Walker") -> str:
    """Where the robot of a run stands that goes on, for people."""
    ahead, left, turned = walker.place
    turned = math.degrees(math.remainder(turned, 2 * math.pi))
    parts = [_aside(ahead, "m ahead of", "m behind"), _aside(left, "m left of", "m right of")]
    place = " and ".join(part for part in parts if part) or "0 m from"
    facing = _aside(round(turned, 2), "degrees to the left", "degrees to the right")
    return f"{place} where it first stood, turned by {facing or '0 degrees'} since"


def _aside(amount: float, one: str, other: str) -> str:
    size = f"{abs(amount):.4g}"
    return "" if round(amount, 4) == 0 else f"{size} {one if amount > 0 else other}"
