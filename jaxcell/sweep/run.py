"""Sweeps: run, gone on with, looked at."""

import contextlib
import dataclasses
import errno
import json
import math
import os
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path

import numpy as np
import xarray as xr

from ..files import replacing
from .engines import engine_named
from .halving import Halving
from .spec import Chunk, Spec
from .store import DONE, Failure, SweepStore, made_with, reading, running
from .work import Computed, Job, check_parameters, failure, jax_is_wide, with_files_found


# How far a run is, for those who ask meanwhile.
_PROGRESS = "progress.json"
_SECONDS_BETWEEN = 1.0


@dataclasses.dataclass(frozen=True)
class SweepStatus:
    """How far a sweep is."""

    task: str
    dimensions: Mapping[str, int]
    members: int
    chunks: int
    done: int
    "Chunks all of whose members are done."
    failures: tuple[Failure, ...]
    "Members that failed."
    running: str | None
    "Which process is at work on it, if any."
    rate: float | None
    "Members that it computes a second, if that is known yet."
    left: float | None
    "Seconds that the rest will take at this rate."

    @property
    def complete(self) -> bool:
        return self.done == self.chunks


@dataclasses.dataclass(frozen=True)
class Progress:
    """How far a run is."""

    chunks: int
    "All chunks of the sweep."
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


def run_sweep(
    spec: Spec,
    out: str | os.PathLike[str],
    *,
    engine: str = "local",
    workers: int | None = None,
    resume: bool = False,
    timeout: float | None = None,
    max_failures: int | None = None,
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
        those of which members failed are tried again.
    - `timeout`: seconds after which a chunk is ended and has failed; not for `local`.
    - `max_failures`: the run ends when more members than that have failed.
    - `progress`: called when the work begins and with each chunk that ends.

    **Returns:** how far the sweep is. A chunk that fails is computed again in halves, and these in
    halves, so that only the members fail that do so alone. They do not stop the others.

    **Raises:** `ValueError` for an unknown task or engine, for parameters that a built-in task does
    not take, or if the sweep that is there is of another specification, or was begun with another
    version of jaxcell or JAX; `FileExistsError` if one is there and `resume` was not asked for;
    `BlockingIOError` if another run is at work on it; `OSError` if the store cannot be written, or
    the scheduler of a cluster cannot be reached.

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
    start = engine_named(engine, workers, timeout)
    if max_failures is not None and max_failures < 0:
        raise ValueError(f"max_failures: expected 0 or more, got {max_failures}")
    try:
        check_parameters(spec)
        found = with_files_found(spec)
    except ValueError as error:
        raise ValueError(f"{spec.path}: {error}") from error
    wide = jax_is_wide()
    with SweepStore.opened(folder, spec, resume, made_with(wide)) as store:
        numbers = np.flatnonzero(store.states() != DONE)
        count = _Count(spec.chunk_count, spec.chunk_count - numbers.size)
        work = Halving(spec, (_job(found, int(number), wide) for number in numbers))
        with (
            _written_down(folder) as write_down,
            contextlib.closing(start(work.take)) as outcomes,
            _writing(folder),
        ):

            def tell(failures: Iterable[Failure]) -> None:
                told = count.told(tuple(failures))
                write_down(told)
                if progress is not None:
                    progress(told)

            tell(())
            for job, outcome in outcomes:
                if isinstance(outcome, Computed):
                    try:
                        store.check(outcome)
                    except ValueError as error:
                        outcome = failure(error)
                parts = work.settle(job, outcome)
                if parts is not None:
                    count.add(parts.chunk)
                    tell(store.write(parts))
                if max_failures is not None and work.failed > max_failures:
                    # Of chunks that are not whole, what failed is kept.
                    for parts in work.begun.values():
                        tell(store.write(parts))
                    break
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
    at_work = running(folder)
    rate, left = _read_down(folder) if at_work is not None else (None, None)
    return SweepStatus(
        spec.task,
        spec.dimensions,
        spec.members,
        spec.chunk_count,
        int((states == DONE).sum()),
        tuple(store.failures(states)),
        at_work,
        rate,
        left,
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
    if not path.is_dir():
        told = sweep_status(out)
        raise ValueError(f"{path}: no chunk is done yet, of {told.chunks}")
    with reading(path):
        return xr.open_zarr(path, consolidated=True)


class _Count:
    """What a run has done so far."""

    def __init__(self, chunks: int, done: int) -> None:
        self.chunks, self.done, self.failed = chunks, done, 0
        self._left, self._ended, self._members = chunks - done, 0, 0
        self._began = time.monotonic()

    def add(self, chunk: Chunk) -> None:
        self.done += 1
        self._ended += 1
        self._members += int(np.prod(chunk.shape))

    def told(self, failures: tuple[Failure, ...]) -> Progress:
        self.failed += len(failures)
        seconds = max(time.monotonic() - self._began, 1e-9)
        each = seconds / self._ended if self._ended else float("nan")
        return Progress(
            self.chunks,
            self.done,
            self.failed,
            self._members / seconds,
            (self._left - self._ended) * each,
            failures,
        )


def _job(spec: Spec, number: int, wide: bool) -> Job:
    batch = spec.batch(spec.chunk(number))
    places = np.arange(len(next(iter(batch.values()))))
    return Job(number, places, spec.task, batch, spec.fixed, spec.seed, wide)


@contextlib.contextmanager
def _written_down(folder: Path) -> Iterator[Callable[[Progress], None]]:
    """Keeps in the folder how fast a run is."""
    path = folder / _PROGRESS
    path.unlink(missing_ok=True)
    last = -math.inf

    def write(progress: Progress) -> None:
        nonlocal last
        if math.isfinite(progress.left) and time.monotonic() >= last + _SECONDS_BETWEEN:
            last = time.monotonic()
            with replacing(path) as temporary:
                now = {"rate": progress.rate, "left": progress.left, "at": time.time()}
                temporary.write_text(json.dumps(now), encoding="utf-8")

    try:
        yield write
    finally:
        path.unlink(missing_ok=True)


def _read_down(folder: Path) -> tuple[float | None, float | None]:
    """Members a second and seconds left of the run at work, once it knows."""
    try:
        with reading(folder):
            kept = json.loads((folder / _PROGRESS).read_text(encoding="utf-8"))
            since = max(time.time() - float(kept["at"]), 0.0)
            return float(kept["rate"]), max(float(kept["left"]) - since, 0.0)
    except FileNotFoundError:
        return None, None


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
