import cmath
import dataclasses
import itertools
import json
import math
import shlex
from pathlib import Path
from typing import TypeAlias

from ...robot.create.motion import Moved
from ...robot.run_log import LoggedRun, read_log
from ...robot.tasks.files import AnyTask
from ..output import option_words
from ..terminal import own_command
from .options import RunOptions
from .outcome import replayed


Place: TypeAlias = tuple[float, float, float]
"""A pose relative to the start of a run: metres ahead and to the left, and the turn in radians."""


def run_before(log: Path, task: AnyTask) -> LoggedRun:
    """Read the log of the run to resume, and check that it is an unfinished run of the task."""
    run = read_log(log)
    for name, ours in json.loads(json.dumps(task.header)).items():
        theirs = run.header.get(name)
        # The files of a run may have been moved.
        if name == "file" or theirs == ours:
            continue
        if name == "sha256":
            raise ValueError(
                f"--resume {log}: it is the log of another {task.kind} than {task.path}"
            )
        raise ValueError(f"--resume {log}: {name}: the log has {theirs}, {task.path} has {ours}")
    if "direction" not in run.header:
        raise ValueError(f"--resume {log}: direction is missing")
    try:
        outcome = replayed(run, task.path)
    except (ValueError, KeyError) as error:
        raise ValueError(f"--resume {log}: {error}") from error
    if not run.observations:
        raise ValueError(f"--resume {log}: it has no observation; start again without --resume")
    if outcome.result not in ("unfinished", "stopped"):
        raise ValueError(f"--resume {log}: that run is complete: {outcome.reason}")
    return run


class Standing:
    """A stand-in for a robot while its log is replayed: a move raises `StandingStill`."""

    def forward(self, distance: float, *, tolerance: float) -> Moved:
        raise StandingStill

    def turn(self, angle: float, *, tolerance: float) -> Moved:
        raise StandingStill


class StandingStill(Exception):  # noqa: N818 (a signal as StopIteration, no error)
    """Raised if a program drives a robot that cannot move."""


def resume_command(options: RunOptions, log: Path, start: str | None) -> str:
    """Return the command that resumes a stopped run in a new folder."""
    assert options.out is not None
    resumed = dataclasses.replace(
        options,
        heading=None,
        confirm=None,
        start=start,
        resume=log,
        out=_new_directory(options.out, log.name),
    )
    names = {field.name for field in dataclasses.fields(resumed)} - {"file"}
    command = own_command("robot", "run", options.file)
    return f"{command} {shlex.join(option_words(resumed, names))}"


def _new_directory(out: Path, log: str) -> Path:
    """Choose a folder without a log for the next run, by adding a number to the name `out`."""
    stem, dash, number = out.name.rpartition("-")
    name = stem if dash and number.isdecimal() else out.name
    numbered = (out.with_name(f"{name}-{i}") for i in itertools.count(2))
    return next(place for place in numbered if not (place / log).exists())


def start_after(pose: tuple[float, float, float], before: Place, after: Place) -> str:
    """Format the current pose of an emulated robot for `--start`: x and y in metres, and degrees.

    `pose` is its pose in the map, in metres and radians, when the emulation began. Its places,
    relative to the start of the run, are `before` (when the emulation began) and `after` (now).
    """
    x, y, heading = pose
    moved = complex(after[0] - before[0], after[1] - before[1])
    there = complex(x, y) + moved * cmath.rect(1.0, heading - before[2])
    degrees = round(math.degrees(heading + after[2] - before[2]), 6) % 360
    # Adding 0 removes the sign of a zero.
    return ",".join(f"{round(part, 6) + 0.0:.10g}" for part in (there.real, there.imag, degrees))


def place_in_words(place: Place) -> str:
    """Describe in words a place relative to the start of a run."""
    ahead, left, turned = place
    turned = math.degrees(math.remainder(turned, 2 * math.pi))
    parts = [_aside(ahead, "m ahead of", "m behind"), _aside(left, "m left of", "m right of")]
    where = " and ".join(part for part in parts if part) or "0 m from"
    facing = _aside(round(turned, 2), "degrees to the left", "degrees to the right")
    return f"{where} its first place, turned by {facing or '0 degrees'} from its first heading"


def _aside(amount: float, one: str, other: str) -> str:
    size = f"{abs(amount):.4g}"
    return "" if round(amount, 4) == 0 else f"{size} {one if amount > 0 else other}"
