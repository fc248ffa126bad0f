"""Where chunks are computed: in this process, in others, or by Dask.

An engine takes jobs as it can work on them, so that only a few are on their way at a time, and
gives back outcomes in the order in which they come. Closing its generator ends its workers at once.
"""

import asyncio
import contextlib
import functools
import importlib.util
import itertools
import json
import logging
import math
import multiprocessing.connection
import os
import queue
import re
import secrets
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterator
from pathlib import Path
from typing import Any

from .process import Worker
from .work import Computed, Failed, Job, compute, failure


Outcomes = Generator[tuple[Job, Computed | Failed], None, None]
Take = Callable[[], Job | None]
Engine = Callable[[Take], Outcomes]

# While one is computed the next waits beside it.
_JOBS_EACH = 2
# How often a chunk may take its worker with it.
_MAX_DEATHS = 3
_DIED = Failed(f"its worker died each of {_MAX_DEATHS} times: out of memory?")
# A word to the scheduler for each job would be more than a thousand workers leave time for.
_TOGETHER = 16
# So often we look whether workers of a cluster have come.
_LOOK_SECONDS = 1.0
_GONE = (
    "{}: the scheduler of the cluster cannot be reached, or is gone; what is done is kept for a "
    "run with resume"
)
# The parts of Dask that log a lost connection.
_CONNECTION = ("batched", "client", "comm", "core")
# Ours does not wait for Dask's half a minute.
_CONNECT_SECONDS = 10
# Two clusters on a machine would quarrel about the usual one.
_ANY_PORT = "127.0.0.1:0"
# Ctrl-C goes to all processes of a terminal. This is run in each worker.
_LEAVE_CTRL_C = "import signal\nsignal.signal(signal.SIGINT, signal.SIG_IGN)"


def engine_named(name: str, workers: int | None = None, timeout: float | None = None) -> Engine:
    """The engine of a name.

    **Arguments:**

    - `name`: `local`, in this process; `processes`, in processes of their own; `dask`, on a cluster
        of this machine that is started for it; or `dask://host:port`, on the cluster of that
        scheduler, whose workers can import jaxcell and the task. Its address as Dask has it will
        do too: `tcp://host:port`, or `tls://host:port` with what the configuration of Dask says.
    - `workers`: the number of processes of `processes` and `dask`; by default one for each
        processor that this process may run on.
    - `timeout`: seconds after which a job is ended and has failed. `local` cannot end any.

    **Returns:** a function that takes jobs and gives back their outcomes as they come. It asks for
    jobs until it is given `None`, and again after each outcome.

    **Raises:** `ValueError` for another name, for a timeout of `local`, or if `distributed` is not
    installed.

    A name that is none:

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
    """Read the address of a cluster, which is the name of an engine, from a file of its scheduler.

    **Arguments:**

    - `file`: what `dask scheduler --scheduler-file FILE` wrote.

    **Returns:** the address, as `tcp://host:port`, which [`engine_named`][] takes.

    **Raises:** `ValueError` if it is no such file; `FileNotFoundError`.

    The file of a scheduler:

        >>> import pathlib, tempfile
        >>> from jaxcell import sweep
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = pathlib.Path(folder, "scheduler.json")
        ...     _ = path.write_text('{"type": "Scheduler", "address": "tcp://10.0.0.7:8786"}')
        ...     sweep.scheduler_address(path)
        'tcp://10.0.0.7:8786'
    """
    try:
        return str(json.loads(Path(file).read_bytes())["address"])
    except (ValueError, KeyError, TypeError, RecursionError):
        raise ValueError(f"{file}: expected the file that a scheduler of Dask wrote") from None


def local(take: Take) -> Outcomes:
    """This process."""
    for job in iter(take, None):
        yield job, compute(job)


def _processes(take: Take, workers: int, timeout: float | None) -> Outcomes:
    """Processes that end with this one. One that dies is replaced, and its job tried again."""
    environment = worker_environment(workers)
    deaths: Counter[int] = Counter()
    again: deque[Job] = deque()
    team: list[Worker] = []
    try:
        while True:
            while sum(len(worker.jobs) for worker in team) < workers * _JOBS_EACH:
                job = again.popleft() if again else take()
                if job is None:
                    break
                idlest = min(team, key=lambda worker: len(worker.jobs), default=None)
                if idlest is None or (idlest.jobs and len(team) < workers):
                    idlest = Worker(environment)
                    team.append(idlest)
                idlest.give(job)
            if not any(worker.jobs for worker in team):
                return
            heard = multiprocessing.connection.wait(
                [worker.connection for worker in team], _patience(team, timeout)
            )
            for worker in list(team):
                outcome = None
                job = worker.jobs[0] if worker.jobs else None
                try:
                    if worker.connection in heard:
                        outcome = worker.receive()
                    elif _patience([worker], timeout) == 0 and not worker.connection.poll():
                        raise TimeoutError
                except (EOFError, TimeoutError) as error:
                    team.remove(worker)
                    worker.end()
                    again.extendleft(reversed(worker.jobs))
                    if job is None:
                        continue
                    deaths[id(job)] += 1
                    if isinstance(error, TimeoutError):
                        outcome = _late(timeout)
                    elif deaths[id(job)] >= _MAX_DEATHS:
                        outcome = _DIED
                    if outcome is not None:
                        again.popleft()
                if job is not None and outcome is not None:
                    deaths.pop(id(job), None)
                    yield job, outcome
    finally:
        for worker in team:
            worker.end()


def _patience(team: list[Worker], timeout: float | None) -> float | None:
    """Seconds until the first worker is late; `None` if that may never be."""
    began = [worker.began for worker in team if worker.began is not None]
    if timeout is None or not began:
        return None
    return max(min(began) + timeout - time.monotonic(), 0.0)


def _late(timeout: float | None) -> Failed:
    return Failed(f"TimeoutError: it was not done after {timeout:g} s")


def _dask_here(take: Take, workers: int, timeout: float | None) -> Outcomes:
    """A cluster of this machine."""
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
    """A cluster that is there. Dask itself tries again what was on a worker that died."""
    from distributed import Client

    run = secrets.token_hex(8)
    work = compute if timeout is None else functools.partial(_apart, run, timeout)
    pending: dict[Any, Job] = {}
    ended: queue.SimpleQueue[Any] = queue.SimpleQueue()
    most, looked = 0, -math.inf
    with contextlib.ExitStack() as stack:
        stack.enter_context(_without_log())
        with _reaching(address):
            client = Client(address, timeout=_CONNECT_SECONDS, set_as_default=False)
        stack.enter_context(client)
        try:
            while True:
                if time.monotonic() >= looked + _LOOK_SECONDS:
                    # Workers come and go.
                    with _reaching(address):
                        threads = sum(client.nthreads().values())
                    most, looked = max(threads, 1) * _JOBS_EACH, time.monotonic()
                while jobs := _some(take, min(most - len(pending), _TOGETHER)):
                    with _reaching(address):
                        begun = client.map(work, jobs, pure=False)
                    for job, future in zip(jobs, begun, strict=True):
                        pending[future] = job
                        future.add_done_callback(ended.put)
                if not pending:
                    return
                futures = _waiting(ended)
                with _reaching(address):
                    found = client.gather({one.key: one for one in futures}, errors="skip")
                for future in futures:
                    if future.cancelled():
                        raise ConnectionError(_GONE.format(address))
                    outcome = found[future.key] or failure(future.exception())
                    yield pending.pop(future), outcome
        finally:
            if timeout is not None:
                with contextlib.suppress(OSError):
                    client.run(_end_apart, run)


def _some(take: Take, most: int) -> list[Job]:
    """So many jobs, or as many as there are now."""
    return [*itertools.islice(iter(take, None), max(most, 0))]


def _waiting(ended: "queue.SimpleQueue[Any]") -> list[Any]:
    """All that is in a queue; if nothing is, what comes within a moment."""
    found = []
    with contextlib.suppress(queue.Empty):
        found.append(ended.get(timeout=_LOOK_SECONDS))
        while True:
            found.append(ended.get_nowait())
    return found


@contextlib.contextmanager
def _reaching(address: str) -> Iterator[None]:
    """Raise `ConnectionError` of one line if the scheduler is not reached in the block."""
    try:
        yield
    except (OSError, RuntimeError, asyncio.CancelledError) as error:
        raise ConnectionError(_GONE.format(address)) from error


@contextlib.contextmanager
def _without_log() -> Iterator[None]:
    """Keep Dask from printing tracebacks of a lost scheduler, of which our error says enough."""
    loggers = [logging.getLogger(f"distributed.{part}") for part in _CONNECTION]
    kept = [logger.disabled for logger in loggers]
    for logger in loggers:
        logger.disabled = True
    try:
        yield
    finally:
        for logger, disabled in zip(loggers, kept, strict=True):
            logger.disabled = disabled


# The processes beside the threads of a worker of Dask, by run and thread: a thread cannot be ended.
_beside: dict[tuple[str, int], Worker] = {}


def _apart(run: str, timeout: float, job: Job) -> Computed | Failed:
    """Compute a chunk in a process of its own, which is kept for the next one."""
    place = run, threading.get_ident()
    for _ in range(_MAX_DEATHS):
        worker = _beside.pop(place, None) or Worker({})
        try:
            outcome = worker.outcome(job, timeout)
        except TimeoutError:
            worker.end()
            return _late(timeout)
        except EOFError:
            worker.end()
        else:
            _beside[place] = worker
            return outcome
    return _DIED


def _end_apart(run: str) -> None:
    for place in [place for place in _beside if place[0] == run]:
        _beside.pop(place).end()


def worker_environment(workers: int) -> dict[str, str]:
    """The environment of processes that share this machine.

    Each gets its part of the processors: JAX heeds `PJRT_NPROC`, and nothing else that limits
    threads.
    """
    share = str(max(len(os.sched_getaffinity(0)) // workers, 1))
    names = ("PJRT_NPROC", "NPROC", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    return {name: os.environ.get(name, share) for name in names}
