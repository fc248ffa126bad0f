"""Workers that are forked in milliseconds, from a process that has imported what they need.

A worker starts in a second, and sweeps whose workers die or are ended start many.
"""

import contextlib
import multiprocessing
import os
import types
from multiprocessing import forkserver
from multiprocessing.connection import Connection

from waiting import is_running, wait_until

from jaxcell.sweep.workers import process


CONTEXT = multiprocessing.get_context("forkserver")
_IMPORTED = ["__main__", "dask.array", "distributed", "jaxcell.sweep.workers.process"]


class Forked:
    """A process of a worker, in place of `subprocess.Popen`."""

    def __init__(self, command, *, env, pass_fds, **_):
        (number,) = pass_fds
        with Connection(os.dup(number)) as theirs:
            self._process = CONTEXT.Process(target=_served, args=(theirs, env))
            self._process.start()
        self.pid, self.wait = self._process.pid, self._process.join
        # Like a session of its own, which a worker has before `Popen` returns.
        wait_until(lambda: not is_running(self.pid) or os.getpgid(self.pid) == self.pid)


FORKED = types.SimpleNamespace(Popen=Forked, DEVNULL=None)
"In place of `subprocess`."


def _served(connection, environment):
    os.setsid()
    os.environ.update(environment)
    process.serve(connection.fileno())


def dask_setup(worker):
    """Workers of Dask, which preload this, start theirs so too."""
    process.subprocess = FORKED


@contextlib.contextmanager
def server():
    """The process from which those of workers and of Dask are forked, and which ends with it."""
    CONTEXT.set_forkserver_preload(_IMPORTED)
    forkserver.ensure_running()
    try:
        yield
    finally:
        forkserver._forkserver._stop()
