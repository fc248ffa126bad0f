"""Report the progress of a run to its caller, and to other processes through a file."""

import contextlib
import dataclasses
import json
import math
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from ...base.paths import replacing
from .work import Failure


_FILE = "progress.json"
SECONDS_BETWEEN = 1.0
"""Minimum time in seconds between two updates of the progress file."""


@dataclasses.dataclass(frozen=True)
class Progress:
    """The progress of a run."""

    chunks: int
    "The number of chunks of the sweep, or of those chosen for the run."
    done: int
    "The number of these chunks that have ended, in this run or in earlier runs."
    failed: int
    "The number of members that failed in this run."
    rate: float
    "Members computed per second in this run, including failed members."
    left: float
    "Estimated seconds until the end of the run."
    failures: tuple[Failure, ...]
    "The failed members of the chunk that has just ended."
    waiting: str = ""
    "The reason why the run waits; empty if it does not wait."


class Count:
    """A counter of finished chunks and members, to estimate the rate and the time left."""

    def __init__(self, chunks: int, done: int, clock: Callable[[], float] = time.monotonic) -> None:
        self.chunks, self.done, self.failed, self._members = chunks, done, 0, 0
        self._first, self._clock, self._began = done, clock, clock()

    def add(self, members: int, ended: int = 1) -> None:
        """Count computed members, and chunks that have ended with them."""
        self.done += ended
        self._members += members

    def progress(self, failures: tuple[Failure, ...], waiting: str = "") -> Progress:
        self.failed += len(failures)
        seconds = max(self._clock() - self._began, 1e-9)
        each = seconds / ended if (ended := self.done - self._first) else math.nan
        rate, left = self._members / seconds, (self.chunks - self.done) * each
        return Progress(self.chunks, self.done, self.failed, rate, left, failures, waiting)


@contextlib.contextmanager
def written_down(
    folder: Path, clock: Callable[[], float] = time.time
) -> Iterator[Callable[[Progress], None]]:
    """Yield a function that writes the progress of a run to a file, at most once per second.

    What a run waits for, and the end of the wait, are written at once.
    """
    path = folder / _FILE
    path.unlink(missing_ok=True)
    last, waiting = -math.inf, ""

    def write(progress: Progress) -> None:
        nonlocal last, waiting
        usual = math.isfinite(progress.left) and time.monotonic() >= last + SECONDS_BETWEEN
        if usual or progress.waiting != waiting:
            last, waiting = time.monotonic(), progress.waiting
            known = math.isfinite(progress.left) and not waiting
            pace = {"rate": progress.rate, "left": progress.left} if known else {}
            with replacing(path) as temporary:
                now = {**pace, "waiting": waiting, "at": clock()}
                temporary.write_text(json.dumps(now), encoding="utf-8")

    try:
        yield write
    finally:
        path.unlink(missing_ok=True)


def read_down(
    folder: Path, clock: Callable[[], float] = time.time
) -> tuple[float | None, float | None, str]:
    """Read the rate of a run in members per second, the seconds left, and what the run waits for.

    The rate and the time are `None` if they are unknown.
    """
    try:
        kept = json.loads((folder / _FILE).read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None, None, ""
    if "rate" not in kept:
        return None, None, str(kept["waiting"])
    since = max(clock() - float(kept["at"]), 0.0)
    return float(kept["rate"]), max(float(kept["left"]) - since, 0.0), ""
