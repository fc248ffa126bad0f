"""Workers that are forked in milliseconds, from a process that has imported what they need.

A worker starts in a second, and sweeps whose workers die or are ended start many.
"""

import contextlib
import multiprocessing
import os
from multiprocessing import forkserver
from multiprocessing.connection import Connection

from jaxcell.sweep.workers.process import serve


CONTEXT = multiprocessing.get_context("forkserver")
_IMPORTED = ["__main__", "dask.array", "distributed", "jaxcell.sweep.workers.process"]


class Forked:
    """A process of a worker, in place of `subprocess.Popen`."""

    def __init__(self, command, *, env, pass_fds, **_):
        (number,) = pass_fds
        with Connection(os.dup(number)) as theirs:
            self._process = CONTEXT.Process(target=_served, args=(theirs, env))
            self._process.start()
        self.kill, self.wait = self._process.kill, self._process.join


def _served(connection, environment):
    os.environ.update(environment)
    serve(connection.fileno())


@contextlib.contextmanager
def server():
    """The process from which those of workers and of Dask are forked, and which ends with it."""
    CONTEXT.set_forkserver_preload(_IMPORTED)
    forkserver.ensure_running()
    try:
        yield
    finally:
        forkserver._forkserver._stop()
