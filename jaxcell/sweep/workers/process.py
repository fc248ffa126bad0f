"""A process of its own for chunks: it may die, or be ended, and takes no other with it."""

import contextlib
import os
import queue
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Mapping
from multiprocessing import Pipe
from multiprocessing.connection import Connection

from .work import Computed, Failed, Job, compute


class Worker:
    """A process that computes jobs in their order. It ends with this one, however this one ends.

    What its tasks print goes to standard error.
    """

    def __init__(self, environment: Mapping[str, str]) -> None:
        self.connection, theirs = Pipe()
        self.jobs: deque[Job] = deque()
        self.began: float | None = None
        "When it began with its first job; it does not before it has started."
        self._ready = False
        path = os.pathsep.join(one or os.getcwd() for one in sys.path)
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

    def give(self, job: Job) -> None:
        """Hand it a job, which may wait beside others."""
        self.jobs.append(job)
        if len(self.jobs) == 1:
            self._begin()
        # That it died shows when an outcome is awaited.
        with contextlib.suppress(OSError):
            self.connection.send(job)

    def receive(self) -> Computed | Failed | None:
        """What it says next: the outcome of its first job, or `None` when it has started.

        **Raises:** `EOFError` if it died.
        """
        try:
            said: Computed | Failed | None = self.connection.recv()
        except OSError as error:
            raise EOFError from error
        if said is None:
            self._ready = True
        else:
            self.jobs.popleft()
        self._begin()
        return said

    def outcome(self, job: Job, timeout: float) -> Computed | Failed:
        """Compute a job while this process waits.

        **Raises:** `TimeoutError`; `EOFError` if it died.
        """
        self.give(job)
        while True:
            left = None if self.began is None else self.began + timeout - time.monotonic()
            if not self.connection.poll(left if left is None else max(left, 0)):
                raise TimeoutError
            if (said := self.receive()) is not None:
                return said

    def end(self) -> None:
        """End it at once."""
        self._process.kill()
        self._process.wait()
        self.connection.close()

    def _begin(self) -> None:
        self.began = time.monotonic() if self._ready and self.jobs else None


def serve(descriptor: int) -> None:
    """What the process does: it computes until nobody holds the other end any more."""
    connection = Connection(descriptor)
    jobs: queue.SimpleQueue[Job] = queue.SimpleQueue()

    def read() -> None:
        with contextlib.suppress(EOFError, OSError):
            while True:
                jobs.put(connection.recv())
        os._exit(1)

    threading.Thread(target=read, daemon=True).start()
    # What any result is made of takes a second to import, some of it at the first dataset, and that
    # is not the time of a job.
    import xarray as xr

    xr.Dataset({"x": ("x", [0])})
    connection.send(None)
    while True:
        connection.send(compute(jobs.get()))
