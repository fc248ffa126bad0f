"""The jobs of a run: chunks, and after failures halves of chunks, down to single members."""

from collections import Counter
from collections.abc import Iterator

import numpy as np

from .work import Job


class Halving:
    """A queue of the jobs of a run, which splits failed jobs into halves."""

    def __init__(self, jobs: Iterator[Job]) -> None:
        self._jobs = jobs
        self._halves: list[Job] = []
        # The number of open jobs of each chunk, less one.
        self._open: Counter[int] = Counter()

    def take(self) -> Job | None:
        """Return the next job, or `None` if there is none now; a failure may add jobs later."""
        return self._halves.pop() if self._halves else next(self._jobs, None)

    def split(self, job: Job) -> None:
        """Replace a job by two jobs with half of its members each."""
        halves = np.array_split(job.places, 2)
        self._halves += [job.part(half) for half in reversed(halves)]
        self._open[job.number] += 1

    def end(self, job: Job) -> bool:
        """Count a job as done; return true if it was the last job of its chunk."""
        self._open[job.number] -= 1
        return self._open[job.number] < 0
