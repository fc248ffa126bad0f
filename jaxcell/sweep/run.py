"""Sweeps: run, gone on with, looked at."""

import contextlib
import dataclasses
import errno
import os
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from pathlib import Path

import numpy as np
import xarray as xr

from .engines import engine_named
from .frame import DONE
from .spec import Chunk, Spec
from .store import DAMAGED, Failure, SweepStore, made_with, reading, running
from .work import Failed, Job, check_parameters, failure, jax_is_wide


@dataclasses.dataclass(frozen=True)
class SweepStatus:
    """How far a sweep is."""

    task: str
    dimensions: Mapping[str, int]
    members: int
    chunks: int
    done: int
    "Chunks that are done."
    failures: tuple[Failure, ...]
    damaged: int
    "Chunks that were done and have lost a file; [`verify_sweep`][] looks into the files too."
    running: str | None
    "Which process is at work on it, if any."

    @property
    def complete(self) -> bool:
        return self.done == self.chunks


@dataclasses.dataclass(frozen=True)
class Progress:
    """How far a run is."""

    chunks: int
    "All chunks of the sweep."
    done: int
    "Chunks that are done, those of former runs included."
    failed: int
    "Chunks that failed in this run."
    rate: float
    "Members computed in this run a second, those that failed included."
    left: float
    "Seconds that the rest will take at this rate."
    failure: Failure | None
    "The failure of the chunk that ended just now, if it failed."


def run_sweep(
    spec: Spec,
    out: str | os.PathLike[str],
    *,
    engine: str = "local",
    workers: int | None = None,
    resume: bool = False,
    anyway: bool = False,
    chunks: Collection[int] | None = None,
    progress: Callable[[Progress], None] | None = None,
) -> SweepStatus:
    """Runs a sweep.

    A chunk is in the store whole or not at all, so a run may end at any moment, and another one
    goes on with what is missing. What comes out does not depend on the engine, the order of chunks,
    or on interruptions: the bytes in the store are the same.

    **Arguments:**

    - `spec`: what to run.
    - `out`: the folder of the store. One run at a time can be at work on it.
    - `engine`: `local`, `processes`, `dask` or `dask://host:port`; see [`engine_named`][].
    - `workers`: how many processes, for `processes` and `dask`.
    - `resume`: go on with the sweep that is there, if there is one: chunks that are done stay,
        those that failed are tried again. If `spec` has all members of that sweep and others, it
        grows to these: members that are done stay.
    - `anyway`: resume although versions, the task, or files that members read are others now; the
        attribute `resumed_anyway` of the result tells which.
    - `chunks`: the numbers of chunks to compute; by default all that are not done.
    - `progress`: called when the work begins and with each chunk that ends.

    **Returns:** how far the sweep is. A chunk that fails does not stop the others.

    **Raises:** `ValueError` for an unknown task or engine, for parameters that a built-in task does
    not take, or if the sweep that is there is of another specification, or was begun with another
    version of jaxcell or JAX, another task, or other files; `FileExistsError` if one is there and
    `resume` was not asked for; `BlockingIOError` if another run is at work on it; `OSError` if the
    store cannot be written, or the scheduler of a cluster cannot be reached.

    The periodic groups of two angles on one map:

        >>> import pathlib, tempfile
        >>> from jaxcell import sweep
        >>> from jaxcell.bundled import bundled
        >>> lab = bundled("maps/lab_a.json")
        >>> lines = 'task = "groups"', "[grid]", "bounce = [45, 135]", "[fixed]", f'map = "{lab}"'
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path, out = pathlib.Path(folder, "spec.toml"), pathlib.Path(folder, "out")
        ...     _ = path.write_text("\\n".join(lines))
        ...     found = sweep.run_sweep(sweep.Spec.load(path), out)
        >>> found.complete, found.members, found.done
        (True, 2, 1)
    """
    folder = Path(out)
    start = engine_named(engine, workers)
    try:
        check_parameters(spec)
    except ValueError as error:
        raise ValueError(f"{spec.path}: {error}") from error
    wide = jax_is_wide()
    made = made_with(spec, wide)
    with SweepStore.opened(folder, spec, resume, made, anyway) as store:
        states = store.states()
        for number in np.flatnonzero(states == DAMAGED):
            store.forget(spec.chunk(int(number)))
        numbers = np.flatnonzero(states != DONE)
        if chunks is not None:
            numbers = np.intersect1d(numbers, [*chunks])
        count = _Count(spec.chunk_count, spec.chunk_count - numbers.size)
        jobs = (_job(store, int(number), wide) for number in numbers)
        if progress is not None:
            progress(count.told(None))
        with contextlib.closing(start(jobs)) as outcomes:
            for job, outcome in outcomes:
                chunk = spec.chunk(job.number)
                failed = None
                with _writing(folder):
                    if not isinstance(outcome, Failed):
                        try:
                            store.write(chunk, outcome)
                        except ValueError as error:
                            outcome = failure(error)
                    if isinstance(outcome, Failed):
                        failed = store.fail(chunk, outcome)
                count.add(chunk, failed is not None)
                if progress is not None:
                    progress(count.told(failed))
    return sweep_status(folder)


def sweep_status(out: str | os.PathLike[str]) -> SweepStatus:
    """How far the sweep in a folder is; while it runs, too.

    **Arguments:**

    - `out`: the folder of the store.

    **Returns:** [`SweepStatus`][].

    **Raises:** `ValueError` if there is none, or it is damaged.

    A sweep that is done:

        >>> import pathlib, tempfile
        >>> from jaxcell import sweep
        >>> from jaxcell.bundled import bundled
        >>> lab = bundled("maps/lab_a.json")
        >>> lines = 'task = "groups"', "[grid]", "bounce = [45, 135]", "[fixed]", f'map = "{lab}"'
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path, out = pathlib.Path(folder, "spec.toml"), pathlib.Path(folder, "out")
        ...     _ = path.write_text("\\n".join(lines))
        ...     _ = sweep.run_sweep(sweep.Spec.load(path), out)
        ...     found = sweep.sweep_status(out)
        >>> found.task, found.dimensions, found.complete, found.running
        ('groups', {'bounce': 2}, True, None)
    """
    folder = Path(out)
    if not (folder / "spec.toml").is_file():
        raise ValueError(f"{folder}: expected the folder of a sweep; it has no spec.toml")
    spec = Spec.load(folder / "spec.toml")
    store = SweepStore(folder, spec, {})
    states = store.states()
    return SweepStatus(
        spec.task,
        spec.dimensions,
        spec.members,
        spec.chunk_count,
        int((states == DONE).sum()),
        tuple(store.failures(states)),
        int((states == DAMAGED).sum()),
        running(folder),
    )


def open_sweep(out: str | os.PathLike[str]) -> xr.Dataset:
    """The result of a sweep, as far as it is: arrays are read when they are used.

    Where `status` is not 1, floats are NaN, integers -1 (or, without a sign, their greatest), and
    booleans `False`.

    **Arguments:**

    - `out`: the folder of the store.

    **Returns:** a dataset with a dimension for each parameter of a grid, or `member` or `sample`;
    its `status` is 1 where a member is done.

    **Raises:** `ValueError` if there is none, no chunk of it is done yet, or it is damaged.

    The number of periodic groups for two angles on one map:

        >>> import pathlib, tempfile
        >>> from jaxcell import sweep
        >>> from jaxcell.bundled import bundled
        >>> lab = bundled("maps/lab_a.json")
        >>> lines = 'task = "groups"', "[grid]", "bounce = [45, 135]", "[fixed]", f'map = "{lab}"'
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path, out = pathlib.Path(folder, "spec.toml"), pathlib.Path(folder, "out")
        ...     _ = path.write_text("\\n".join(lines))
        ...     _ = sweep.run_sweep(sweep.Spec.load(path), out)
        ...     with sweep.open_sweep(out) as dataset:
        ...         print(dataset["count"].values.tolist(), dataset.status.values.tolist())
        [1, 1] [1, 1]
    """
    path = Path(out) / "sweep.zarr"
    told = sweep_status(out)
    if not path.is_dir():
        raise ValueError(f"{path}: no chunk is done yet, of {told.chunks}")
    if told.damaged:
        raise ValueError(
            f"{path}: {told.damaged} of {told.chunks} chunks are damaged; to mend them: "
            f"jaxcell sweep verify {out}"
        )
    with reading(Path(out)):
        return xr.open_zarr(path, consolidated=True)


class _Count:
    """What a run has done so far."""

    def __init__(self, chunks: int, done: int) -> None:
        self.chunks, self.done, self.failed = chunks, done, 0
        self._left, self._ended, self._members = chunks - done, 0, 0
        self._began = time.monotonic()

    def add(self, chunk: Chunk, failed: bool) -> None:
        self.done += not failed
        self.failed += failed
        self._ended += 1
        self._members += int(np.prod(chunk.shape))

    def told(self, failed: Failure | None) -> Progress:
        seconds = max(time.monotonic() - self._began, 1e-9)
        each = seconds / self._ended if self._ended else float("nan")
        return Progress(
            self.chunks,
            self.done,
            self.failed,
            self._members / seconds,
            (self._left - self._ended) * each,
            failed,
        )


def _job(store: SweepStore, number: int, wide: bool) -> Job:
    """The members of a chunk that are missing, as a job."""
    spec, chunk = store.spec, store.spec.chunk(number)
    batch = spec.batch(chunk, store.missing(chunk))
    return Job(number, spec.task, batch, spec.fixed, spec.seed, wide)


@contextlib.contextmanager
def _writing(folder: Path) -> Iterator[None]:
    """Says where there was no room."""
    try:
        yield
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
            raise OSError(
                error.errno,
                f"{os.strerror(error.errno)}; what is written is whole, and a run with resume "
                "goes on with it",
                str(folder),
            ) from error
        raise
