"""Where chunks are computed: in this process, in others, or by Dask.

An engine takes jobs as it can work on them, so that only a few are on their way at a time, and
gives back outcomes in the order in which they come. Closing its generator ends its workers at once.
"""

import contextlib
import importlib.util
import multiprocessing
import os
import re
import threading
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import Connection
from typing import Any

from .work import Computed, Failed, Job, compute, failure


Outcomes = Generator[tuple[Job, Computed | Failed], None, None]
Engine = Callable[[Iterator[Job]], Outcomes]

# While one is computed the next waits beside it.
_JOBS_EACH = 2
# How often a chunk may take its worker with it.
_MOST_DEATHS = 3
# Ours does not wait for Dask's half a minute.
_CONNECT_SECONDS = 10
# Two clusters on a machine would quarrel about the usual one.
_ANY_PORT = "127.0.0.1:0"
# Ctrl-C goes to all processes of a terminal. This is run in each worker.
_LEAVE_CTRL_C = "import signal\nsignal.signal(signal.SIGINT, signal.SIG_IGN)"


def engine_named(name: str, workers: int | None = None) -> Engine:
    """The engine of a name.

    **Arguments:**

    - `name`: `local`, in this process; `processes`, in processes of their own; `dask`, on a cluster
        of this machine that is started for it; or `dask://host:port`, on the cluster of that
        scheduler, whose workers can import jaxcell and the task.
    - `workers`: the number of processes of `processes` and `dask`; by default one for each
        processor that this process may run on.

    **Returns:** a function that takes jobs and gives back their outcomes as they come.

    **Raises:** `ValueError` for another name, or if `distributed` is not installed.

    A name that is none:

        >>> from jaxcell import sweep
        >>> sweep.engine_named("threads")
        Traceback (most recent call last):
            ...
        ValueError: engine: expected local, processes, dask or dask://host:port, got 'threads'
    """
    address = re.fullmatch(r"dask://([^/\s]+:\d+)", name)
    if name not in ("local", "processes", "dask") and address is None:
        raise ValueError(
            f"engine: expected local, processes, dask or dask://host:port, got {name!r}"
        )
    if workers is not None and name not in ("processes", "dask"):
        raise ValueError(f"workers: the engine {name} is not told how many, got {workers}")
    count = len(os.sched_getaffinity(0)) if workers is None else workers
    if count < 1:
        raise ValueError(f"workers: expected at least 1, got {count}")
    if name == "local":
        return _local
    if name == "processes":
        return lambda jobs: _processes(jobs, count)
    if importlib.util.find_spec("distributed") is None:
        raise ValueError(
            f"engine: {name} needs distributed, the extra `cluster` of jaxcell: "
            "pip install 'jaxcell[cluster]'"
        )
    if address is not None:
        return lambda jobs: _dask(jobs, f"tcp://{address[1]}")
    return lambda jobs: _dask_here(jobs, count)


def _local(jobs: Iterator[Job]) -> Outcomes:
    for job in jobs:
        yield job, compute(job)


def _processes(jobs: Iterator[Job], workers: int) -> Outcomes:
    """Spawned processes. Those that die are replaced, and the jobs they had are tried again."""
    deaths: Counter[int] = Counter()
    suspects: deque[Job] = deque()
    with _environment(worker_environment(workers)):
        while True:
            # A pool breaks as a whole: which of its jobs did it shows when one is there at a time.
            alone = bool(suspects)
            given = _taken_from(suspects) if alone else jobs
            with _Pool(1 if alone else workers) as pool:
                for job, outcome in pool.run(given, 1 if alone else workers * _JOBS_EACH):
                    if outcome is not None:
                        yield job, outcome
                        continue
                    deaths[job.number] += 1
                    if alone and deaths[job.number] >= _MOST_DEATHS:
                        message = f"its worker died each of {_MOST_DEATHS} times: out of memory?"
                        yield job, Failed(message)
                    else:
                        suspects.append(job)
                broken = pool.broken
            if not broken and not alone:
                return


def _taken_from(jobs: deque[Job]) -> Iterator[Job]:
    while jobs:
        yield jobs.popleft()


class _Pool:
    """A pool of spawned processes that die with this one, or with the pool."""

    def __init__(self, workers: int) -> None:
        # A process with threads, as JAX's, cannot fork.
        context = multiprocessing.get_context("spawn")
        reader, self._writer = context.Pipe(duplex=False)
        self._reader = reader
        self._executor = ProcessPoolExecutor(
            workers, mp_context=context, initializer=_begin_worker, initargs=(reader,)
        )
        self.broken = False

    def __enter__(self) -> "_Pool":
        return self

    def __exit__(self, *_: object) -> None:
        # Workers end when they see that nobody holds the other end any more.
        self._writer.close()
        self._executor.shutdown(wait=True, cancel_futures=True)
        self._reader.close()

    def run(self, jobs: Iterator[Job], most: int) -> Iterator[tuple[Job, Computed | Failed | None]]:
        """The outcomes of jobs; `None` for those that were on their way when a worker died."""
        pending: dict[Future[Computed | Failed], Job] = {}
        while True:
            while len(pending) < most and not self.broken:
                job = next(jobs, None)
                if job is None:
                    break
                try:
                    pending[self._executor.submit(compute, job)] = job
                except BrokenProcessPool:
                    self.broken = True
                    yield job, None
            if not pending:
                return
            for future in wait(pending, return_when=FIRST_COMPLETED).done:
                job = pending.pop(future)
                try:
                    outcome: Computed | Failed | None = future.result()
                except BrokenProcessPool:
                    self.broken = True
                    outcome = None
                except Exception as error:
                    outcome = failure(error)
                yield job, outcome


def _begin_worker(reader: Connection) -> None:
    """Makes a worker leave Ctrl-C to its driver, and end with it."""
    import signal

    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def watch() -> None:
        with contextlib.suppress(EOFError, OSError):
            reader.recv()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _dask_here(jobs: Iterator[Job], workers: int) -> Outcomes:
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
        contextlib.closing(_dask(jobs, cluster.scheduler_address)) as outcomes,
    ):
        yield from outcomes


def _dask(jobs: Iterator[Job], address: str) -> Outcomes:
    """A cluster that is there. Dask itself tries again what was on a worker that died."""
    from distributed import Client, as_completed

    with Client(address, timeout=_CONNECT_SECONDS, set_as_default=False) as client:
        threads = sum(client.nthreads().values())
        pending: dict[Any, Job] = {}
        arrived = as_completed(loop=client.loop)

        def submit(most: int) -> None:
            while len(pending) < most and (job := next(jobs, None)) is not None:
                future = client.submit(compute, job, pure=False)
                pending[future] = job
                arrived.add(future)

        submit(max(threads, 1) * _JOBS_EACH)
        most = len(pending)
        while pending:
            future = next(arrived)
            job = pending.pop(future)
            if future.cancelled():
                raise ConnectionError(f"{address}: the scheduler of the cluster is gone")
            error = future.exception()
            outcome = future.result() if error is None else failure(error)
            future.release()
            submit(most)
            yield job, outcome


def worker_environment(workers: int) -> dict[str, str]:
    """What processes that share this machine are told before they start.

    Each gets its part of the processors: JAX heeds `PJRT_NPROC`, and nothing else that limits
    threads.
    """
    share = str(max(len(os.sched_getaffinity(0)) // workers, 1))
    names = ("PJRT_NPROC", "NPROC", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    return {name: os.environ.get(name, share) for name in names}


@contextlib.contextmanager
def _environment(variables: dict[str, str]) -> Iterator[None]:
    """Sets variables for processes that are spawned meanwhile."""
    kept = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, value in kept.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
