"""Engines compute chunks in this process, in other processes, or on a Dask cluster.

An engine is a generator. It takes a few jobs per worker at a time, and yields the outcome of each
job when the job ends. It yields `Waiting` when nothing can be computed, and again when that ends.
Closing the generator stops the workers at once.
"""

import asyncio
import contextlib
import functools
import importlib.util
import itertools
import json
import logging
import math
import os
import queue
import re
import secrets
import time
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from ...base.formatting import did_you_mean
from ...base.runtime import program_cache
from .process import Team
from .work import Computed, Failed, Job, Waiting, compute, failure


Outcomes = Generator[tuple[Job, Computed | Failed] | Waiting, None, None]
Take = Callable[[], Job | None]
Engine = Callable[[Take], Outcomes]

# Number of submitted jobs per worker: one is computed, and the next one waits.
_JOBS_EACH = 2
# One message per job would saturate the scheduler at 1,000 workers.
_TOGETHER = 16
LOOK_SECONDS = 1.0
"""Seconds between two counts of the workers of a cluster; workers may join or leave it."""
NO_WAIT = Waiting("")
_GONE = (
    "{}: the scheduler of the cluster cannot be reached, or is gone; chunks that ended are kept: "
    "resume the sweep with another cluster"
)
_EMPTY = "a worker: the cluster has none; start one with `dask worker`, or stop with Ctrl-C"
# The parts of Dask that log a lost connection.
_CONNECTION = ("batched", "client", "comm", "core")
CONNECT_SECONDS = 10
"""Seconds to wait for a scheduler; Dask itself waits half a minute."""
# Two clusters on one machine cannot share the default port.
_ANY_PORT = "127.0.0.1:0"
# Workers run this code to ignore Ctrl-C, which goes to all processes of a terminal.
_LEAVE_CTRL_C = "import signal\nsignal.signal(signal.SIGINT, signal.SIG_IGN)"


def engine_named(name: str, workers: int | None = None, timeout: float | None = None) -> Engine:
    """Return the engine with the given name.

    **Arguments:**

    - `name`: `local` (this process), `processes` (other processes), `dask` (a new cluster on this
        machine), or `dask://host:port` (the cluster of that scheduler, with workers that can import
        jaxcell and the task). Dask's own addresses are also accepted: `tcp://host:port`, or
        `tls://host:port` if the configuration of Dask sets up TLS.
    - `workers`: the number of processes of `processes` and `dask`; by default one for each
        processor that this process may use.
    - `timeout`: seconds after which a job is stopped and counts as failed; not for `local`.

    **Returns:** a generator function. It takes jobs from its argument, a function that returns a
    job or, if none is left, `None`. It yields each job with its outcome when the job ends.

    An unknown name:

        >>> from jaxcell import sweep
        >>> sweep.engine_named("threads")
        Traceback (most recent call last):
            ...
        ValueError: engine: expected local, processes, dask or dask://host:port, got 'threads'
    """
    address = re.fullmatch(r"(dask|tcp|tls)://([^/\s]+:\d+)", name)
    if name not in ("local", "processes", "dask") and address is None:
        raise ValueError(
            f"engine: expected local, processes, dask or dask://host:port, got {name!r}"
            f"{did_you_mean(name, ('local', 'processes', 'dask'))}"
        )
    if workers is not None and name not in ("processes", "dask"):
        raise ValueError(f"workers: the engine {name} takes none, got {workers}")
    count = len(os.sched_getaffinity(0)) if workers is None else workers
    if count < 1:
        raise ValueError(f"workers: expected at least 1, got {count}")
    if timeout is not None and not 0 < timeout < math.inf:
        raise ValueError(f"timeout: expected more than 0 s, got {timeout}")
    if name == "local":
        if timeout is not None:
            raise ValueError(
                "timeout: the engine local computes in this process and cannot end a chunk; "
                "expected another engine, as processes"
            )
        return local
    if name == "processes":
        return lambda take: _processes(take, count, timeout)
    if importlib.util.find_spec("distributed") is None:
        raise ValueError(
            f"engine: {name} needs distributed, the extra `cluster` of jaxcell: "
            "pip install 'jaxcell[cluster]'"
        )
    if address is not None:
        protocol = "tcp" if address[1] == "dask" else address[1]
        return lambda take: _dask(take, f"{protocol}://{address[2]}", timeout)
    return lambda take: _dask_here(take, count, timeout)


def scheduler_address(file: str | os.PathLike[str]) -> str:
    """Read the address of a cluster from the file of its scheduler.

    **Arguments:** the file that `dask scheduler --scheduler-file FILE` wrote. **Returns:** the
    address, such as `tcp://host:port`, for [`engine_named`][].

    The file of a scheduler:

        >>> from jaxcell import examples, sweep
        >>> path = examples.folder() / "scheduler.json"
        >>> _ = path.write_text('{"type": "Scheduler", "address": "tcp://10.0.0.7:8786"}')
        >>> sweep.scheduler_address(path)
        'tcp://10.0.0.7:8786'
    """
    try:
        return str(json.loads(Path(file).read_bytes())["address"])
    except (ValueError, KeyError, TypeError, RecursionError):
        raise ValueError(f"{file}: expected the file that a scheduler of Dask wrote") from None


def local(take: Take) -> Outcomes:
    for job in iter(take, None):
        yield job, compute(job)


def _processes(take: Take, workers: int, timeout: float | None) -> Outcomes:
    with (
        ThreadPoolExecutor(workers) as threads,
        contextlib.closing(Team(worker_environment(workers), timeout)) as team,
    ):
        yield from _in_turn(
            take,
            lambda: workers * _JOBS_EACH,
            lambda jobs: [threads.submit(team.compute, job) for job in jobs],
            lambda futures: [future.result() for future in futures],
        )


def _in_turn(
    take: Take,
    most: Callable[[], int],
    submit: Callable[[list[Job]], Iterable[Any]],
    results: Callable[[list[Any]], Iterable[Computed | Failed]],
    waiting: Callable[[], Waiting] = lambda: NO_WAIT,
) -> Outcomes:
    """Submit jobs from `take`, up to `most()` at once, and yield the outcome of each when it ends.

    `submit` returns the futures of jobs, `results` the outcomes of futures, and `waiting` what the
    jobs wait for.
    """
    pending: dict[Any, Job] = {}
    ended: queue.SimpleQueue[Any] = queue.SimpleQueue()
    said = NO_WAIT
    while True:
        while room := max(0, min(most() - len(pending), _TOGETHER)):
            if not (jobs := [*itertools.islice(iter(take, None), room)]):
                break
            for job, future in zip(jobs, submit(jobs), strict=True):
                pending[future] = job
                future.add_done_callback(ended.put)
        if not pending:
            return
        if (now := waiting()) != said:
            yield (said := now)
        futures = _ended_futures(ended)
        for future, outcome in zip(futures, results(futures), strict=True):
            yield pending.pop(future), outcome


def _dask_here(take: Take, workers: int, timeout: float | None) -> Outcomes:
    import dask
    from distributed import LocalCluster

    environment = worker_environment(workers)
    kept = dask.config.get("distributed.nanny.pre-spawn-environ", {})
    settings = {"distributed.nanny.pre-spawn-environ": {**kept, **environment}}
    with (
        dask.config.set(settings),
        LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            processes=True,
            dashboard_address=_ANY_PORT,
            preload=[_LEAVE_CTRL_C],
        ) as cluster,
        contextlib.closing(_dask(take, cluster.scheduler_address, timeout)) as outcomes,
    ):
        yield from outcomes


def _dask(take: Take, address: str, timeout: float | None) -> Outcomes:
    """Compute jobs on an existing cluster. Dask repeats a job if its worker dies."""
    from distributed import Client

    run = secrets.token_hex(8)
    work = compute if timeout is None else functools.partial(_compute_apart, run, timeout)
    threads, counted = 0, -math.inf

    def most() -> int:
        nonlocal threads, counted
        if time.monotonic() >= counted + LOOK_SECONDS:
            # The number of workers may change.
            with _reaching(address):
                threads = sum(client.nthreads().values())
            counted = time.monotonic()
        return max(threads, 1) * _JOBS_EACH

    def submit(jobs: list[Job]) -> list[Any]:
        with _reaching(address):
            return client.map(work, jobs, pure=False)

    def results(futures: list[Any]) -> Iterator[Computed | Failed]:
        with _reaching(address):
            gathered = client.gather({one.key: one for one in futures}, errors="skip")
        for future in futures:
            if future.cancelled():
                raise ConnectionError(_GONE.format(address))
            yield gathered[future.key] or failure(future.exception())

    with contextlib.ExitStack() as stack:
        stack.enter_context(_without_log())
        with _reaching(address):
            client = Client(address, timeout=CONNECT_SECONDS, set_as_default=False)
        stack.enter_context(client)
        try:
            yield from _in_turn(
                take, most, submit, results, lambda: NO_WAIT if threads else Waiting(_EMPTY)
            )
        finally:
            if timeout is not None:
                with contextlib.suppress(OSError):
                    client.run(_close_team, run)


def _ended_futures(ended: "queue.SimpleQueue[Any]") -> list[Any]:
    """Take all futures from a queue. If it is empty, wait at most `LOOK_SECONDS` for a future."""
    futures = []
    with contextlib.suppress(queue.Empty):
        futures.append(ended.get(timeout=LOOK_SECONDS))
        while True:
            futures.append(ended.get_nowait())
    return futures


@contextlib.contextmanager
def _reaching(address: str) -> Iterator[None]:
    """Raise a short `ConnectionError` if a `with` block cannot reach the scheduler."""
    try:
        yield
    except (OSError, RuntimeError, asyncio.CancelledError) as error:
        raise ConnectionError(_GONE.format(address)) from error


@contextlib.contextmanager
def _without_log() -> Iterator[None]:
    """Silence Dask's log messages about a lost scheduler; an exception reports the loss instead."""
    loggers = [logging.getLogger(f"distributed.{part}") for part in _CONNECTION]
    kept = [logger.disabled for logger in loggers]
    for logger in loggers:
        logger.disabled = True
    try:
        yield
    finally:
        for logger, disabled in zip(loggers, kept, strict=True):
            logger.disabled = disabled


# The processes that compute for a Dask worker, by run. Unlike threads, they can be stopped.
_teams: dict[str, Team] = {}


def _compute_apart(run: str, timeout: float, job: Job) -> Computed | Failed:
    """Compute a job in a child process of a Dask worker, so that a timeout can kill the child."""
    return _teams.setdefault(run, Team({}, timeout)).compute(job)


def _close_team(run: str) -> None:
    if run in _teams:
        _teams.pop(run).close()


def worker_environment(workers: int) -> dict[str, str]:
    """Return environment variables of workers: a share of the processors, and a cache of programs.

    A worker compiles no program that another process of the user has compiled before.
    """
    share = str(max(len(os.sched_getaffinity(0)) // workers, 1))
    # JAX reads only PJRT_NPROC, and libraries of linear algebra read the other variables.
    names = ("PJRT_NPROC", "NPROC", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    cache = {name.upper(): str(value) for name, value in program_cache().items()}
    settings = {**dict.fromkeys(names, share), **cache}
    return {name: os.environ.get(name, value) for name, value in settings.items()}
