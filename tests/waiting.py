"""Waiting for events, in place of sleeping for as long as they are thought to take."""

import threading
import time
from pathlib import Path


def wait_until(condition, limit=120.0):
    """Wait until a condition holds, at the pace of this machine, and raise if it never does.

    **Returns:** the value of the condition.
    """
    end = time.monotonic() + limit
    while not (found := condition()):
        if time.monotonic() > end:
            raise AssertionError(f"the condition did not hold within {limit:g} s")
        time.sleep(0.001)
    return found


def is_running(process):
    """Check that a process runs; a process whose parent has not waited for it only exists."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


def when(condition, act):
    """Act in a thread once a condition holds."""

    def wait():
        wait_until(condition)
        act()

    threading.Thread(target=wait, daemon=True).start()
