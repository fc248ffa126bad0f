import signal
import threading
from collections.abc import Sequence
from types import FrameType


def end_by_signals() -> list[signal.Signals]:
    """Let SIGTERM and SIGHUP raise `SystemExit`, so that `with` blocks end.

    **Returns:** the signals whose handlers were set; none outside of the main thread.
    """
    handled = []
    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGTERM, signal.SIGHUP):
            if signal.getsignal(number) == signal.SIG_DFL:
                signal.signal(number, _exit)
                handled.append(number)
    return handled


def leave_signals(handled: Sequence[signal.Signals]) -> None:
    """Restore the default handlers of signals."""
    for number in handled:
        signal.signal(number, signal.SIG_DFL)


def _exit(number: int, _: FrameType | None) -> None:
    raise SystemExit(128 + number)
