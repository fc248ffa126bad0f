"""Jobs of a run: chunks, and, after failures, their halves, down to single members."""

import dataclasses
from collections.abc import Iterator

import numpy as np

from ..spec import Chunk, Spec
from .work import Computed, Failed, Job


@dataclasses.dataclass
class Parts:
    """The outcomes of the jobs of a chunk. The place of a member is its index in the chunk."""

    chunk: Chunk
    members: int
    "The number of members of the chunk that the run computes."
    computed: list[tuple[np.ndarray, Computed]] = dataclasses.field(default_factory=list)
    "The places of the members of each job, and its result."
    failed: dict[int, Failed] = dataclasses.field(default_factory=dict)
    "The failures of members, by the place of the member."
    open: int = 1
    "The number of jobs that have not ended."


class Halving:
    """A queue of the jobs of a run, which splits a failed job into halves."""

    def __init__(self, spec: Spec, jobs: Iterator[Job]) -> None:
        self.begun: dict[int, Parts] = {}
        "Unfinished chunks with some outcomes, by their numbers."
        self.failed = 0
        "The number of members that failed."
        self._spec, self._jobs = spec, jobs
        self._halves: list[Job] = []

    def take(self) -> Job | None:
        """Take the next job; return `None` if there is none now. A failure may add jobs later."""
        return self._halves.pop() if self._halves else next(self._jobs, None)

    def settle(self, job: Job, outcome: Computed | Failed) -> Parts | None:
        """Add the outcome of a job. Returns the chunk if all its jobs have ended, or `None`."""
        if job.number not in self.begun:
            self.begun[job.number] = Parts(self._spec.chunk(job.number), job.places.size)
        parts = self.begun[job.number]
        parts.open -= 1
        if isinstance(outcome, Computed):
            parts.computed.append((job.places, outcome))
        elif job.places.size == 1:
            parts.failed[job.places.item()] = outcome
            self.failed += 1
        else:
            halves = np.array_split(job.places, 2)
            self._halves += [job.part(half) for half in reversed(halves)]
            parts.open += len(halves)
        return None if parts.open else self.begun.pop(job.number)
