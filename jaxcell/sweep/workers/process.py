"""Processes that compute jobs: one may die, or be ended, without harm to this process."""

import contextlib
import os
import queue
import subprocess
import sys
import threading
from collections.abc import Mapping
from multiprocessing import Pipe
from multiprocessing.connection import Connection

from .work import Computed, Failed, Job, compute


# The number of workers that a job may kill before it has failed.
_MAX_DEATHS = 3


class Worker:
    """A process that computes jobs. It ends with this one, however this one ends.

    The output of its tasks goes to standard error.
    """

    def __init__(self, environment: Mapping[str, str]) -> None:
        self._connection, theirs = Pipe()
        self._ready = False
        path = os.pathsep.join(folder or os.getcwd() for folder in sys.path)
        with theirs:
            number = theirs.fileno()
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-c", f"from {__name__} import serve; serve({number})"],
                env={**os.environ, **environment, "PYTHONPATH": path},
                pass_fds=(number,),
                stdin=subprocess.DEVNULL,
                stdout=2,
                # Ctrl-C goes to all processes of a terminal, and is for the driver.
                start_new_session=True,
            )

    def compute(self, job: Job, timeout: float | None) -> Computed | Failed:
        """Compute a job. The seconds of the timeout begin when the process has started."""
        try:
            if not self._ready:
                self._connection.recv()
                self._ready = True
            self._connection.send(job)
            if not self._connection.poll(timeout):
                raise TimeoutError
            return self._connection.recv()
        except ConnectionError as error:
            raise EOFError from error

    def end(self) -> None:
        self._process.kill()
        self._process.wait()


class Team:
    """Workers for threads: one for each thread that computes jobs, replaced when it dies."""

    def __init__(self, environment: Mapping[str, str], timeout: float | None) -> None:
        self._environment, self._timeout = environment, timeout
        self._workers: dict[int, Worker] = {}
        self._lock = threading.Lock()
        self._closed = False

    def compute(self, job: Job) -> Computed | Failed:
        """Compute a job by the worker of this thread."""
        for _ in range(_MAX_DEATHS):
            worker = self._worker()
            try:
                return worker.compute(job, self._timeout)
            except TimeoutError:
                self._remove(worker)
                return Failed(f"TimeoutError: it was not done after {self._timeout:g} s")
            except EOFError:
                self._remove(worker)
        return Failed(f"its worker died each of {_MAX_DEATHS} times: out of memory?")

    def close(self) -> None:
        """Kill all workers."""
        with self._lock:
            self._closed = True
            for worker in self._workers.values():
                worker.end()

    def _worker(self) -> Worker:
        with self._lock:
            if self._closed:
                raise EOFError("the workers are closed")
            thread = threading.get_ident()
            if thread not in self._workers:
                self._workers[thread] = Worker(self._environment)
            return self._workers[thread]

    def _remove(self, worker: Worker) -> None:
        worker.end()
        with self._lock:
            self._workers.pop(threading.get_ident(), None)


def serve(descriptor: int) -> None:
    """Compute jobs in a worker process, until the other end of the connection is closed."""
    connection = Connection(descriptor)
    jobs: queue.SimpleQueue[Job] = queue.SimpleQueue()

    def read() -> None:
        with contextlib.suppress(EOFError, OSError):
            while True:
                jobs.put(connection.recv())
        os._exit(1)

    threading.Thread(target=read, daemon=True).start()
    # Every result is a dataset. The second that its import takes is not part of a job's time.
    import xarray as xr

    xr.Dataset({"x": ("x", [0])})
    connection.send(None)
    while True:
        connection.send(compute(jobs.get()))
