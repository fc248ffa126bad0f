"""Control this process: display, output, signals, and threads of linear algebra."""

import contextlib
import ctypes
import functools
import os
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from types import FrameType
from typing import Any


def has_display() -> bool:
    """Check whether this process can open a window."""
    if not sys.platform.startswith("linux"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


@contextlib.contextmanager
def output_to(descriptor: int) -> Iterator[None]:
    """Redirect standard output of Python and compiled code to `descriptor` in a `with` block."""
    _flush()
    kept = os.dup(1)
    os.dup2(descriptor, 1)
    try:
        yield
    finally:
        _flush()
        os.dup2(kept, 1)
        os.close(kept)


@contextlib.contextmanager
def no_output() -> Iterator[None]:
    """Discard standard output inside a `with` block."""
    with open(os.devnull, "wb") as nothing, output_to(nothing.fileno()):
        yield


def _flush() -> None:
    sys.stdout.flush()
    # The output buffer of C.
    with contextlib.suppress(TypeError, OSError):
        ctypes.CDLL(None).fflush(None)


def end_by_signals() -> list[signal.Signals]:
    """Let SIGTERM and SIGHUP raise `SystemExit`, so that `with` blocks clean up.

    **Returns:** the signals that now have a new handler; an empty list outside the main thread.
    """
    handled = []
    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGTERM, signal.SIGHUP):
            if signal.getsignal(number) == signal.SIG_DFL:
                signal.signal(number, _exit)
                handled.append(number)
    return handled


def leave_signals(handled: Sequence[signal.Signals]) -> None:
    """Restore the default handlers of the signals that [`end_by_signals`][] returned."""
    for number in handled:
        signal.signal(number, signal.SIG_DFL)


def _exit(number: int, _: FrameType | None) -> None:
    raise SystemExit(128 + number)


@contextlib.contextmanager
def one_blas_thread() -> Iterator[None]:
    """Limit BLAS and LAPACK to one thread inside a `with` block.

    A second thread does not speed up the factorization of matrices with a few hundred rows. Threads
    of OpenBLAS spin while they wait, so that a factorization takes up to twenty times longer if JAX
    or another process runs too.
    """
    with _controller().limit(limits=1, user_api="blas"):
        yield


@functools.cache
def _controller() -> Any:
    # Imported here because the computer of a robot may lack these modules. The controller knows
    # only libraries that were loaded before it was made.
    import numpy  # noqa: F401
    import scipy.linalg  # noqa: F401
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()
