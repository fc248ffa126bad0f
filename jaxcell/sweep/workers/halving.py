"""Which jobs a run has: its chunks, and halves of those that fail, until a member is alone."""

import dataclasses
from collections.abc import Iterator

import numpy as np

from ..spec import Chunk, Spec
from .work import Computed, Failed, Job


@dataclasses.dataclass
class Parts:
    """What is known of a chunk. Places are those in its batch."""

    chunk: Chunk
    members: int
    "How many of its members the run is to compute."
    computed: list[tuple[np.ndarray, Computed]] = dataclasses.field(default_factory=list)
    "Places, and their results."
    failed: dict[int, Failed] = dataclasses.field(default_factory=dict)
    "The members that failed, by their places."
    open: int = 1
    "Jobs whose outcomes are missing."


class Halving:
    """The jobs of a run, one after the other."""

    def __init__(self, spec: Spec, jobs: Iterator[Job]) -> None:
        self.begun: dict[int, Parts] = {}
        "Chunks of which something is known, but not all, by their numbers."
        self.failed = 0
        "Members that failed."
        self._spec, self._jobs = spec, jobs
        self._halves: list[Job] = []

    def take(self) -> Job | None:
        """The next job, if there is one now. A failure may bring others."""
        return self._halves.pop() if self._halves else next(self._jobs, None)

    def settle(self, job: Job, outcome: Computed | Failed) -> Parts | None:
        """Take the outcome of a job, and give the chunk if all of it is known now."""
        chunk = self._spec.chunk(job.number)
        inside = np.intersect1d(job.places, self._spec.places(chunk), assume_unique=True)
        if job.number not in self.begun:
            self.begun[job.number] = Parts(chunk, inside.size)
        parts = self.begun[job.number]
        parts.open -= 1
        if isinstance(outcome, Computed):
            parts.computed.append((job.places, outcome))
        elif inside.size == 1:
            parts.failed[int(inside[0])] = outcome
            self.failed += 1
        else:
            halves = np.array_split(inside, 2)
            self._halves += [job.part(half) for half in reversed(halves)]
            parts.open += len(halves)
        return None if parts.open else self.begun.pop(job.number)
