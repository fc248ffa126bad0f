"""Lock a store, so that only one run at a time writes to it."""

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
    """Hold a lock on a file inside a `with` block, and write the name of this process to the file.

    A missing file is created. The system releases the lock when the process ends, even if it is
    killed.
    """
    with open(path, "a+", encoding="utf-8") as file:
        # Retry, because `holder` may take the lock for a moment.
        limit = time.monotonic() + _PATIENCE
        while not _taken(file.fileno(), fcntl.LOCK_EX):
            if time.monotonic() > limit:
                raise BlockingIOError(f"{path.parent}: {_holder_named(path)} writes to it")
            time.sleep(0.02)
        file.truncate(0)
        file.write(f"process {os.getpid()} on {socket.gethostname()}\n")
        file.flush()
        try:
            yield
        finally:
            # The file stays, because two processes could lock two files of the same name.
            file.truncate(0)


def holder(path: Path) -> str | None:
    """Return the name of the process that has locked a file; `None` if it is not locked."""
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
