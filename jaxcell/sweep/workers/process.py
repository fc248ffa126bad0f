"""Child processes that compute jobs. They may crash or be killed without harm to this process."""

import contextlib
import os
import queue
import signal
import subprocess
import sys
import threading
from collections.abc import Mapping
from multiprocessing import Pipe
from multiprocessing.connection import Connection

from .work import Computed, Failed, Job, compute, prepare


# Number of crashed workers after which a job counts as failed.
_MAX_DEATHS = 3
START_SECONDS = 600.0
"""Seconds after which a worker that has not said its first words counts as dead."""


class Worker:
    """A child process that computes jobs. It ends when its parent process ends or is killed.

    The processes that a task starts end with it, unless they leave its process group. The standard
    output of tasks goes to standard error.
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
                # Only the driver shall get Ctrl-C, which goes to all processes of a terminal, and
                # the processes of tasks are in the group of their worker.
                start_new_session=True,
            )

    def compute(self, job: Job, timeout: float | None) -> Computed | Failed:
        """Compute a job. The timeout in seconds does not include the start of the process."""
        try:
            self._await_word()
            self._connection.send(job)
            self._await_word()
            self._ready = True
            if not self._connection.poll(timeout):
                raise TimeoutError
            return self._connection.recv()
        except ConnectionError as error:
            raise EOFError from error

    def _await_word(self) -> None:
        """Wait until a new worker has started, and until it has imported what its job needs."""
        if not self._ready:
            if not self._connection.poll(START_SECONDS):
                raise EOFError
            self._connection.recv()

    def end(self) -> None:
        """Kill the worker and the processes of its task."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()


class Team:
    """A group of workers, one for each calling thread. A worker that dies is replaced."""

    def __init__(self, environment: Mapping[str, str], timeout: float | None) -> None:
        self._environment, self._timeout = environment, timeout
        self._workers: dict[int, Worker] = {}
        self._lock = threading.Lock()
        self._closed = False

    def compute(self, job: Job) -> Computed | Failed:
        """Compute a job with the worker of this thread."""
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
        os.killpg(0, signal.SIGKILL)

    threading.Thread(target=read, daemon=True).start()
    connection.send(None)
    job = jobs.get()
    prepare(job)
    connection.send(None)
    while True:
        connection.send(compute(job))
        job = jobs.get()
