"""Run and resume sweeps."""

import contextlib
import errno
import os
from collections.abc import Callable, Collection, Iterable, Iterator
from pathlib import Path

import numpy as np

from .failures import Failure, write_failures
from .results import SweepStatus, sweep_status
from .spec import Spec
from .storage.digests import made_with
from .storage.export import export
from .storage.lock import locked
from .storage.opening import opened
from .storage.store import DONE, SweepStore
from .workers.engines import Engine, Outcomes, engine_named
from .workers.halving import Halving, Parts
from .workers.progress import Count, Progress, written_down
from .workers.work import Computed, Job, failure, jax_is_wide, prepared


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
    """Run a sweep.

    A chunk is in the store whole or not at all, so a run may end at any moment, and another one
    goes on with what is missing. A kill loses the chunks that ended in the last second, or where
    these take long to write in ten times as long. What comes out does not depend on the engine, the
    order of chunks, or on interruptions: the bytes in the store are the same.

    **Arguments:**

    - `spec`: what to run.
    - `out`: the folder of the store. One run at a time can be at work on it.
    - `engine`: `local`, `processes`, `dask` or `dask://host:port`, or an engine itself; see
        [`engine_named`][].
    - `workers`: how many processes, for `processes` and `dask`.
    - `resume`: go on with the sweep that is there, if there is one: members that are done stay,
        those that failed are tried again. If `spec` has all members of that sweep and others, it
        grows to these.
    - `anyway`: resume although versions, the task, or files that members read are others now; the
        attribute `resumed_anyway` of the result says which.
    - `chunks`: the numbers of chunks to compute; by default all that are not done.
    - `timeout`: seconds after which a chunk is ended and has failed; not for `local`.
    - `max_failures`: the run ends when more members than that have failed.
    - `progress`: called when the work begins and with each chunk that ends.

    **Returns:** the progress of the sweep. A chunk that fails is computed again in halves, and
    these in halves, so that only the members fail that do so alone. They do not stop the others.

    **Raises:** `ValueError` for an unknown task or engine, for parameters that a built-in task does
    not take, or if the sweep that is there is of another specification, or was begun with another
    version of jaxcell or JAX, another task, or other files; `FileExistsError` if one is there and
    `resume` was not asked for; `BlockingIOError` if another run is at work on it; `OSError` if the
    store cannot be written, or the scheduler of a cluster cannot be reached.

    The periodic groups of two angles on one map:

        >>> import pathlib, tempfile
        >>> from jaxcell import examples, sweep
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     out = pathlib.Path(folder, "out")
        ...     found = sweep.run_sweep(examples.angles(), out)
        >>> found.complete, found.members, found.done
        (True, 2, 1)
    """
    folder = Path(out)
    start = engine_named(engine, workers, timeout) if isinstance(engine, str) else engine
    if max_failures is not None and max_failures < 0:
        raise ValueError(f"max_failures: expected 0 or more, got {max_failures}")
    found = prepared(spec)
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
        asked = spec.chunk_count if chunks is None else len(chunks)
        count = Count(asked, asked - numbers.size)
        work = Halving(spec, (_job(store, found, int(number), wide) for number in numbers))
        with (
            written_down(folder) as write_down,
            contextlib.closing(start(work.take)) as outcomes,
        ):

            def report(failures: Iterable[Failure]) -> None:
                now = count.progress(tuple(failures))
                write_down(now)
                if progress is not None:
                    progress(now)

            report(())
            for parts in _ended(store, work, outcomes, max_failures):
                failures = store.write(parts)
                if not parts.open:
                    count.add(parts.members)
                report(failures)
        finish(store, whole=chunks is None)
    return sweep_status(folder)


def finish(store: SweepStore, whole: bool = True) -> None:
    """Write the members that failed and, for a whole sweep, the result, unless it is current."""
    write_failures(store.folder / "failures.json", [*store.failures()])
    if (
        whole
        and store.frame is not None
        and (store.contents.exported is None or store.lost_files())
    ):
        export(store)


def _ended(
    store: SweepStore, work: Halving, outcomes: Outcomes, max_failures: int | None
) -> Iterator[Parts]:
    """The chunks of a run as they end; if too many members fail, what is known of the others."""
    for job, outcome in outcomes:
        if isinstance(outcome, Computed):
            try:
                store.check(outcome)
            except ValueError as error:
                outcome = failure(error)
        parts = work.settle(job, outcome)
        if parts is not None:
            yield parts
        if max_failures is not None and work.failed > max_failures:
            yield from work.begun.values()
            return


def _job(store: SweepStore, spec: Spec, number: int, wide: bool) -> Job:
    """The members of a chunk that are missing."""
    chunk = spec.chunk(number)
    job, missing = Job.of(spec, chunk, wide), (store.read(number)[0] != DONE).ravel()
    # One that is whole has those too that stand in for others, so that it is of the usual length.
    return job if missing.all() else job.part(spec.places(chunk)[missing])


@contextlib.contextmanager
def no_room_reported(folder: Path) -> Iterator[None]:
    """Say in an error of a full disk that what is written is kept."""
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
