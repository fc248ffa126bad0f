"""Kills and resumes sweeps, and compares their results. Run by tests.

It imports once what a sweep needs and forks a process for each run, so that many fit in seconds.
"""

import contextlib
import hashlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

from waiting import wait_until

import jaxcell.sweep.storage.digests
from jaxcell.sweep import Spec, run_sweep
from jaxcell.sweep.storage.journal import Journal, Kind
from jaxcell.sweep.storage.store import DONE, SweepStore


# The source may change while tests run.
jaxcell.sweep.storage.digests.git_revision = lambda: "a revision"

_EVENTS = ("open", "os.rename", "os.mkdir", "os.remove", "os.truncate")


def tree(folder: Path) -> dict[str, str]:
    """Every file of the result, with its hash."""
    root = folder / "sweep.zarr"
    return {
        str(path.relative_to(root)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in root.rglob("*")
        if path.is_file()
    }


def flip(path, place):
    """Flips a bit of a file."""
    content = bytearray(path.read_bytes())
    content[place // 8] ^= 1 << place % 8
    path.write_bytes(content)


def records(out):
    """The records of a journal, by kind and number."""
    journal = Journal(out / "sweep.journal")
    found = {(record.kind, record.number): record for record in journal.records()}
    journal.close()
    return found


def damage_chunk(out, number):
    """Flips a bit of the content of a chunk."""
    flip(out / "sweep.journal", records(out)[Kind.CHUNK, number].start * 8 + 77)


def forked(spec: Spec, folder: Path, engine: str, events: int | None = None) -> int:
    """Starts a run; it kills itself when it is about to do the given number of file operations."""
    process = os.fork()
    if process:
        return process
    status = 1
    with contextlib.suppress(BaseException):
        if events is not None:
            _kill_after(events, folder)
        workers = None if engine == "local" else 1
        run_sweep(spec, folder, engine=engine, workers=workers, resume=True)
        status = 0
    os._exit(status)


def _kill_after(events: int, folder: Path) -> None:
    left = [events]
    lock = threading.Lock()
    start, write = str(folder), os.write

    def is_last():
        with lock:
            left[0] -= 1
            return left[0] < 0

    def hook(event, arguments):
        if event in _EVENTS and str(arguments[0]).startswith(start) and is_last():
            os.kill(os.getpid(), signal.SIGKILL)

    def write_or_die(descriptor, content):
        if is_last():
            # Half a record is on the disk.
            write(descriptor, content[: len(content) // 2])
            os.kill(os.getpid(), signal.SIGKILL)
        return write(descriptor, content)

    sys.addaudithook(hook)
    os.write = write_or_die


def ended(process: int) -> int:
    """Waits for a run, and gives the signal that killed it, or 0."""
    code = os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])
    assert code in (0, -signal.SIGKILL), f"a run ended with {code}"
    return -code


def chunks_done(folder: Path) -> int:
    """The number of chunks done, in a process that must not start threads."""
    if not (folder / "sweep.journal").exists():
        return 0
    with SweepStore(folder) as store:
        return int((store.states == DONE).sum())


def await_chunks(folder: Path, count: int) -> None:
    """Waits until at least `count` chunks are done."""
    wait_until(lambda: chunks_done(folder) >= count)


def kill(
    file: str,
    base: str,
    kills: int,
    engine: str = "local",
    begun: str | None = None,
) -> dict[str, int]:
    """Kills runs of a sweep, and counts the kills and the rounds in which it was done.

    `begun` is a smaller sweep to grow.
    """
    spec, rng = Spec.load(file), random.Random(1)
    base = Path(base)
    base.mkdir(exist_ok=True)
    whole, folder = base / "whole", base / "killed"
    began = time.monotonic()
    assert ended(forked(spec, whole, "local")) == 0
    lasts = time.monotonic() - began
    expected = tree(whole)
    done, rounds, partial = 0, 0, 0
    while done < kills or not partial:
        if begun and not folder.exists():
            shutil.copytree(begun, folder)
        # Half of the kills at a moment, half at an operation on a file.
        if engine == "local" and rng.random() < 0.5:
            # Chunks are computed by the first few operations; then the result is written.
            computing = chunks_done(folder) < spec.chunk_count
            events = rng.randrange(200 if begun else 20 if computing else 60)
            killed = ended(forked(spec, folder, engine, events))
        else:
            process = forked(spec, folder, engine)
            if engine == "local":
                # Every third run ends before its moment.
                time.sleep(rng.uniform(0, 1.5 * lasts))
            else:
                # Its workers take a long and unknown time to start.
                await_chunks(folder, rng.randrange(spec.chunk_count))
                time.sleep(rng.uniform(0, 0.05))
            os.kill(process, signal.SIGKILL)
            killed = ended(process)
        done += killed == signal.SIGKILL
        partial += 0 < chunks_done(folder) < spec.chunk_count
        if not killed:
            assert tree(folder) == expected, "a different result"
            rounds += 1
            shutil.rmtree(folder)
    # A sweep of any engine can be resumed by another.
    assert ended(forked(spec, folder, "local")) == 0
    assert tree(folder) == expected, "a different result"
    return {"kills": done, "rounds": rounds + 1, "partial": partial}


def kill_apart(*sweeps: dict[str, Any]) -> list[dict[str, int]]:
    """Kills sweeps, one after the other, in a process without threads."""
    found = subprocess.run(
        [sys.executable, __file__, *map(json.dumps, sweeps)],
        check=False,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert found.returncode == 0, found.stderr
    return json.loads(found.stdout)


if __name__ == "__main__":
    import dask.array  # noqa: F401  xarray imports it when it makes its first dataset.

    print(json.dumps([kill(**json.loads(one)) for one in sys.argv[1:]]))
