"""The progress of a run: for its caller, and in the store for those who ask meanwhile."""

import contextlib
import dataclasses
import json
import math
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from ...base.paths import replacing
from ..failures import Failure


_FILE = "progress.json"
_SECONDS_BETWEEN = 1.0


@dataclasses.dataclass(frozen=True)
class Progress:
    """The progress of a run."""

    chunks: int
    "All chunks that the run is to see done."
    done: int
    "Chunks that have been computed, those of former runs included."
    failed: int
    "Members that failed in this run."
    rate: float
    "Members computed in this run a second, those that failed included."
    left: float
    "Seconds that the rest will take at this rate."
    failures: tuple[Failure, ...]
    "Those in the chunk that ended just now."


class Count:
    """The work that a run has done so far, by a clock in seconds."""

    def __init__(self, chunks: int, done: int, clock: Callable[[], float] = time.monotonic) -> None:
        self.chunks, self.done, self.failed = chunks, done, 0
        self._left, self._ended, self._members = chunks - done, 0, 0
        self._clock = clock
        self._began = clock()

    def add(self, members: int) -> None:
        """Count a chunk that has ended, of which so many members were computed."""
        self.done += 1
        self._ended += 1
        self._members += members

    def progress(self, failures: tuple[Failure, ...]) -> Progress:
        self.failed += len(failures)
        seconds = max(self._clock() - self._began, 1e-9)
        each = seconds / self._ended if self._ended else float("nan")
        return Progress(
            self.chunks,
            self.done,
            self.failed,
            self._members / seconds,
            (self._left - self._ended) * each,
            failures,
        )


@contextlib.contextmanager
def written_down(
    folder: Path, clock: Callable[[], float] = time.time
) -> Iterator[Callable[[Progress], None]]:
    """Keep the rate of a run in its folder."""
    path = folder / _FILE
    path.unlink(missing_ok=True)
    last = -math.inf

    def write(progress: Progress) -> None:
        nonlocal last
        if math.isfinite(progress.left) and time.monotonic() >= last + _SECONDS_BETWEEN:
            last = time.monotonic()
            with replacing(path) as temporary:
                now = {"rate": progress.rate, "left": progress.left, "at": clock()}
                temporary.write_text(json.dumps(now), encoding="utf-8")

    try:
        yield write
    finally:
        path.unlink(missing_ok=True)


def read_down(
    folder: Path, clock: Callable[[], float] = time.time
) -> tuple[float | None, float | None]:
    """Read the members per second and the seconds left of the run at work, once it knows."""
    try:
        kept = json.loads((folder / _FILE).read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None, None
    since = max(clock() - float(kept["at"]), 0.0)
    return float(kept["rate"]), max(float(kept["left"]) - since, 0.0)
