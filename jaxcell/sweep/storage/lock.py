"""One run at a time on a store."""

import contextlib
import fcntl
import os
import socket
import time
from collections.abc import Iterator
from pathlib import Path


_PATIENCE = 0.5


@contextlib.contextmanager
def locked(path: Path) -> Iterator[None]:
    """Hold a lock on a file, made if need be, which says who holds it.

    The system lets go of it when the process ends, however it ends.

    **Raises:** `BlockingIOError` that names the process that holds it.
    """
    with open(path, "a+", encoding="utf-8") as file:
        # Whoever only asks whether there is a run holds the lock too, for an instant.
        limit = time.monotonic() + _PATIENCE
        while not _taken(file.fileno(), fcntl.LOCK_EX):
            if time.monotonic() > limit:
                raise BlockingIOError(f"{path.parent}: {_holder_named(path)} is at work on it")
            time.sleep(0.02)
        file.truncate(0)
        file.write(f"process {os.getpid()} on {socket.gethostname()}\n")
        file.flush()
        try:
            yield
        finally:
            # The file stays: to remove it would let two others lock two files of its name.
            file.truncate(0)


def holder(path: Path) -> str | None:
    """Who holds a lock, if anybody."""
    if not path.exists():
        return None
    with open(path, encoding="utf-8") as file:
        return None if _taken(file.fileno(), fcntl.LOCK_SH) else _holder_named(path)


def _taken(descriptor: int, kind: int) -> bool:
    try:
        fcntl.flock(descriptor, kind | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def _holder_named(path: Path) -> str:
    return path.read_text(encoding="utf-8").strip() or "another process"
