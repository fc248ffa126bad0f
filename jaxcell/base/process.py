"""Control this process: display, output, signals, and threads of linear algebra."""

import _thread
import collections
import contextlib
import ctypes
import errno
import functools
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
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


def guarded(command: Sequence[str]) -> list[str]:
    """Return a command that runs `command`, and ends it when its standard input is closed.

    Started with `stdin=PIPE` in a session of its own, it ends when this process ends or is killed.
    """
    return [sys.executable, "-c", _GUARD, *command]


_GUARD = """
import os, signal, subprocess, sys, threading
child = subprocess.Popen(sys.argv[1:], stdin=subprocess.DEVNULL)
def end():
    sys.stdin.buffer.read()
    os.killpg(0, signal.SIGTERM)
threading.Thread(target=end, daemon=True).start()
os._exit(child.wait())
"""


@contextlib.contextmanager
def signals_deferred() -> Iterator[None]:
    """Deliver SIGINT, SIGTERM and SIGHUP only after a `with` block.

    Libraries in the block are never interrupted between two of their steps: xarray, for example,
    takes two locks one after the other, and waits forever if only one of them was taken.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    received: list[int] = []
    deferred = {
        number: signal.signal(number, lambda number, _: received.append(number))
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    }
    try:
        yield
    finally:
        for number, handler in deferred.items():
            signal.signal(number, handler)
        for first in received[:1]:
            signal.raise_signal(first)


@contextlib.contextmanager
def library_writes(name: str) -> Iterator[None]:
    """Defer signals while a library writes the file `name`, and raise `OSError` if it fails.

    If a disk is full, HDF5 says only "HDF error", as `RuntimeError` or as `OSError`, or "Permission
    denied".
    """
    with signals_deferred():
        try:
            yield
        except (RuntimeError, PermissionError) as error:
            reason = getattr(error, "strerror", error)
            raise OSError(
                errno.EIO, f"{name}: it cannot be written, the disk may be full: {reason}"
            ) from error


def end_by_signals() -> list[signal.Signals]:
    """Let SIGTERM and SIGHUP raise `SystemExit`, so that `with` blocks clean up.

    These signals and SIGINT wait until a module is imported, at most a few seconds.
    **Returns:** the signals that now have a new handler; an empty list outside the main thread.
    """
    handled = []
    if threading.current_thread() is threading.main_thread():
        for number, default in _DEFAULTS.items():
            if signal.getsignal(number) == default:
                signal.signal(number, _end)
                handled.append(number)
    return handled


def leave_signals(handled: Sequence[signal.Signals]) -> None:
    """Restore the default handlers of the signals that [`end_by_signals`][] returned."""
    for number in handled:
        signal.signal(number, _DEFAULTS[number])
    if handled:
        # The program may have caught the exception of a signal, and go on.
        _received.clear()


def _end(number: int, frame: FrameType | None) -> None:
    again = number in _sent_again
    _sent_again.discard(number)
    if again and _is_ended_by(sys.exc_info()[1]):
        _send_again(number, _LATER, _watch)
        return
    while frame is not None and _postponed[number] < _MOST:
        if frame.f_code.co_name in _UNINTERRUPTED:
            _postponed[number] += 1
            _send_again(number, _SOON)
            return
        frame = frame.f_back
    _postponed[number] = 0
    if _watch is not None:
        _raised.append(number)
        _send_again(number, _LATER, _watch)
    if number == signal.SIGINT:
        raise KeyboardInterrupt
    _received.append(number)
    raise SystemExit(128 + number)


_DEFAULTS: dict[signal.Signals, Any] = {
    signal.SIGINT: signal.default_int_handler,
    signal.SIGTERM: signal.SIG_DFL,
    signal.SIGHUP: signal.SIG_DFL,
}
# Compiled code calls two methods in hash tables, and Python a function to import a module. JAX and
# modules make another error of an exception there, and C++ may abort. JAX never repairs a file of
# its cache that was not written completely.
_UNINTERRUPTED = ("__eq__", "__hash__", "_find_and_load", "write_bytes")
_received: list[int] = []
# Seconds after which a postponed signal is sent again, and the most times that it is.
_SOON, _MOST = 0.05, 100
# Seconds after which a signal is sent again if its exception was discarded.
_LATER = 1.0
_postponed: collections.Counter[int] = collections.Counter()
# Signals whose exceptions were raised, and perhaps discarded.
_raised: list[int] = []
_sent_again: set[int] = set()
_watch: object | None = None
# The exit statuses of signals that ended a part of a command early; `None` if parts are not kept.
_stopped: list[int] | None = None


def _send_again(number: int, seconds: float, watch: object | None = None) -> None:
    """Send a signal to this process after some seconds, unless the `watch` has ended then."""

    def send() -> None:
        time.sleep(seconds)
        if watch is None or watch is _watch:
            _sent_again.add(number)
            os.kill(os.getpid(), number)

    # `threading.Thread` takes a lock, which the interrupted code may have taken.
    _thread.start_new_thread(send, ())


def _is_ended_by(error: BaseException | None) -> bool:
    """Check whether the exception of a signal is being handled."""
    while error is not None and not isinstance(error, (KeyboardInterrupt, SystemExit)):
        error = error.__context__
    return error is not None


def exit_status(error: KeyboardInterrupt | SystemExit) -> int:
    """Return the exit status of a process that a signal ends."""
    return 130 if isinstance(error, KeyboardInterrupt) else int(error.code or 0)


def is_ending() -> bool:
    """Check whether this process has got SIGTERM or SIGHUP, and ends."""
    return bool(_received)


@contextlib.contextmanager
def signals_sent_again() -> Iterator[None]:
    """Send a signal again if its exception is lost: after a second, and after the `with` block.

    JAX discards all exceptions in some places, and Python those of callbacks and destructors.
    """
    global _watch
    before = sys.unraisablehook

    def hook(discarded: Any) -> None:
        if not isinstance(discarded.exc_value, (KeyboardInterrupt, SystemExit)):
            before(discarded)

    sys.unraisablehook, _watch = hook, object()
    try:
        yield
        raise_lost_signal()
    finally:
        sys.unraisablehook, _watch = before, None
        _raised.clear()


@contextlib.contextmanager
def parts_kept() -> Iterator[list[int]]:
    """Let Ctrl-C or SIGTERM end only blocks of [`stoppable`][]; yields their exit statuses."""
    global _stopped
    _stopped = []
    try:
        yield _stopped
    finally:
        _stopped = None


@contextlib.contextmanager
def stoppable(has_parts: Callable[[], object] = lambda: True) -> Iterator[None]:
    """End a `with` block early at Ctrl-C or SIGTERM if a command keeps parts and there are some.

    In a program, or without parts, the exception goes on.
    """
    try:
        yield
    except (KeyboardInterrupt, SystemExit) as error:
        if _stopped is None or not has_parts():
            raise
        _stopped.append(exit_status(error))
        _received.clear()
        keep_running()


def raise_lost_signal() -> None:
    """Raise the exception of a signal again if a library has discarded it."""
    if (
        _raised
        and threading.current_thread() is threading.main_thread()
        and not _is_ended_by(sys.exc_info()[1])
    ):
        signal.raise_signal(_raised.pop())


def keep_running() -> None:
    """Do not send a signal again whose exception was caught on purpose."""
    global _watch
    if _watch is not None:
        _watch = object()
        _raised.clear()


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
