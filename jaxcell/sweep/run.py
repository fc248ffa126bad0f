"""Run and resume sweeps."""

import contextlib
import errno
import math
import os
from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator
from pathlib import Path

import numpy as np

from .results import SweepStatus, sweep_status
from .spec import Spec
from .storage.digests import made_with
from .storage.export import update_result
from .storage.journal import JOURNAL
from .storage.lock import locked
from .storage.opening import opened
from .storage.store import DONE, SweepStore
from .workers.engines import Engine, engine_named
from .workers.progress import Count, Progress, written_down
from .workers.work import (
    Computed,
    Failed,
    Failure,
    Job,
    Waiting,
    failure,
    jax_is_wide,
    prepared,
)


def run_sweep(
    spec: Spec,
    out: str | os.PathLike[str],
    *,
    engine: str | Engine = "local",
    workers: int | None = None,
    resume: bool = False,
    anyway: bool = False,
    chunks: Collection[int] | None = None,
    timeout: float | None = None,
    max_failures: int | None = None,
    progress: Callable[[Progress], None] | None = None,
) -> SweepStatus:
    """Run or resume a sweep: compute all members that are not done yet.

    The results of each chunk are appended to a journal in the store. A run may end at any moment,
    for example when it is killed, and the next run computes the remaining members. The final result
    is written when a run ends; its bytes do not depend on the engine, the order of chunks, or
    interruptions.

    **Arguments:**

    - `spec`: the specification.
    - `out`: the folder of the store, to which only one run at a time can write.
    - `engine`: `local`, `processes`, `dask` or `dask://host:port`, or an engine that
        [`engine_named`][] returned.
    - `workers`: the number of processes of the engines `processes` and `dask`.
    - `resume`: if true, continue an existing sweep in the folder, and try failed members again. If
        `spec` adds members to the existing sweep, the sweep is enlarged.
    - `anyway`: resume although versions, the task, or files that members read have changed; the
        attribute `resumed_anyway` of the result lists the changes.
    - `chunks`: the numbers of the chunks to compute, without writing the final result; by default
        all chunks are computed, and the result is written.
    - `timeout`: seconds after which a chunk is stopped and counts as failed; not for `local`.
    - `max_failures`: the run ends when more than this number of members have failed.
    - `progress`: a function that is called when the work begins, and after each chunk.

    **Returns:** the progress of the sweep. A chunk that fails is split into halves repeatedly, so
    that only members that fail alone count as failed. Failures do not stop other members.

    **Raises:** `ValueError` if the sweep in the folder has another specification, or was made with
    other versions of jaxcell or JAX, another task, or other files; `FileExistsError` if the folder
    has a sweep and `resume` is false; `BlockingIOError` if another run writes to it; `OSError` if
    the disk is full, or the scheduler of a cluster cannot be reached.

    The periodic groups of two angles on one map:

        >>> from jaxcell import examples, sweep
        >>> status = sweep.run_sweep(examples.angles(), examples.folder())
        >>> status.complete, status.members, status.done
        (True, 2, 1)
    """
    folder = Path(out)
    start = engine_named(engine, workers, timeout) if isinstance(engine, str) else engine
    if max_failures is not None and max_failures < 0:
        raise ValueError(f"max_failures: expected 0 or more, got {max_failures}")
    checked = prepared(spec)
    wide = jax_is_wide()
    made = made_with(spec, wide)
    folder.mkdir(parents=True, exist_ok=True)
    with (
        no_room_reported(folder),
        locked(folder / "lock"),
        opened(folder, spec, resume, made, anyway) as store,
    ):
        numbers = np.flatnonzero(store.states != DONE)
        if chunks is not None:
            numbers = np.intersect1d(numbers, [*chunks])
        wanted = spec.chunk_count if chunks is None else len(chunks)
        count = Count(wanted, wanted - numbers.size)
        work = _Jobs(store, checked, numbers, wide)
        # The failures in chunks that have not ended.
        failures: defaultdict[int, list[Failure]] = defaultdict(list)
        with (
            written_down(folder) as write_down,
            contextlib.closing(start(work.take)) as outcomes,
        ):

            def report(failures: Iterable[Failure], waiting: str = "") -> None:
                now = count.progress(tuple(failures), waiting)
                write_down(now)
                if progress is not None:
                    progress(now)

            report(())
            for item in outcomes:
                if isinstance(item, Waiting):
                    report((), item.what)
                    continue
                job, outcome = item
                outcome = _checked(store, outcome)
                if isinstance(outcome, Failed) and outcome.wrong_results:
                    if not store.contents.chunks:
                        # The corrected specification may have the same folder.
                        (folder / JOURNAL).unlink()
                    raise ValueError(f"{spec.path}: {outcome.wrong_results}")
                if isinstance(outcome, Failed) and job.places.size > 1:
                    work.split(job)
                    continue
                for failed in store.write(job, outcome):
                    failures[failed.chunk].append(failed)
                ended = work.end(job, outcome)
                count.add(job.places.size, len(ended))
                if ended:
                    report([one for number in ended for one in failures.pop(number, ())])
                known = count.failed + sum(map(len, failures.values()))
                if max_failures is not None and known > max_failures:
                    break
            for some in failures.values():
                report(some)
        if chunks is None:
            update_result(store)
    return sweep_status(folder)


class _Jobs:
    """The jobs of a run: one chunk each or, if the specification gives no size, several.

    A job that fails is split into halves, down to single members.
    """

    def __init__(self, store: SweepStore, spec: Spec, numbers: np.ndarray, wide: bool) -> None:
        self._store, self._spec, self._numbers, self._wide = store, spec, numbers, wide
        self._halves: list[Job] = []
        # The number of chunks of a job, and the number that would take a second.
        self._together, self._in_a_second = 1, 1.0
        self._open = 0
        # The number of members of each chunk that are taken and have not ended.
        self._left: Counter[int] = Counter()

    def take(self) -> Job | None:
        """Return the next job, or `None` if no job is left; a later failure may add jobs."""
        numbers = self._numbers[: self._together].tolist()
        if not self._halves and not numbers:
            return None
        self._open += 1
        if self._halves:
            return self._halves.pop()
        self._numbers = self._numbers[self._together :]
        chunks = [self._spec.chunk(number) for number in numbers]
        job = Job.of(self._spec, chunks, self._together, self._wide)
        if not self._store.contents.chunks.keys().isdisjoint(numbers):
            states = [self._store.read(chunk)[0].ravel() for chunk in chunks]
            if (known := np.concatenate(states) == DONE).any():
                job = job.part(np.flatnonzero(~known))
        self._left.update(_sizes(job))
        return job

    def split(self, job: Job) -> None:
        halves = np.array_split(np.arange(job.places.size), 2)
        self._halves += [job.part(half) for half in reversed(halves)]
        self._open -= 1

    def end(self, job: Job, outcome: Computed | Failed) -> list[int]:
        """Count a job as done, fit the size of later jobs, and return the chunks that ended."""
        self._left.subtract(sizes := _sizes(job))
        if isinstance(outcome, Computed) and "chunk" not in self._spec.document:
            self._fit(job.length // math.prod(self._spec.lengths.values()), outcome.room)
        self._open -= 1
        return [number for number in sizes if not self._left[number]]

    def _fit(self, chunks: int, room: float) -> None:
        """Fit the size of later jobs to a job of `chunks` chunks that could be larger by `room`."""
        # A small difference is not worth another compilation.
        wanted = max(chunks * room, 1.0)
        if chunks != self._together or 0.5 < wanted / self._in_a_second < 2.0:
            return
        self._in_a_second = wanted
        jobs = max(math.ceil(self._numbers.size / self._in_a_second), self._open)
        self._together = max(1, -(-self._numbers.size // jobs))


def _sizes(job: Job) -> dict[int, int]:
    """Return the number of members of each chunk in a job."""
    return {number: rows.stop - rows.start for number, rows in job.by_chunk()}


def _checked(store: SweepStore, outcome: Computed | Failed) -> Computed | Failed:
    """Return an outcome, or a failure if its variables differ from those of the first result."""
    if isinstance(outcome, Computed):
        try:
            store.check(outcome)
        except ValueError as error:
            return failure(error)
    return outcome


@contextlib.contextmanager
def no_room_reported(folder: Path) -> Iterator[None]:
    """Add advice to the `OSError` that a `with` block raises if the disk is full."""
    try:
        yield
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
            raise OSError(
                error.errno,
                f"{os.strerror(error.errno)}; chunks that ended are kept; make room, and resume "
                "the sweep",
                str(folder),
            ) from error
        raise
