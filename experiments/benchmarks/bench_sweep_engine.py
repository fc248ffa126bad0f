"""Time the engines of sweeps: members per second by the size of chunks, and costs per chunk.

Run `python experiments/benchmarks/bench_sweep_engine.py`; it takes about 45 s.

The first table is for periodic groups of random maps. The second is for a task that only waits, so
its overhead is the cost of the engine: messages and files. *Steady* is the time from the end of the
first chunk to the end of the last. *Start* is the time from the call to the end of the first chunk,
less the time of a chunk. With `--full` the task waits for 5 s in place of 0.5 s.

The third table is for the process that sends chunks to a thousand workers and writes their results.
Its processor time limits the number of workers. Here the workers are threads that sleep, so the
process also computes the chunks, unlike on a cluster.

The fourth table is for whole sweeps of rooms, 25,000 members, or 10^6 with `--full`. It has times
of processors, also of the workers, with their imports and compilation.

The peer is a loop over the batches of the task in this process, which stores nothing. Neither time
includes imports and compilation in this process. The start of a sweep includes those of its
workers.
"""

import queue
import resource
import shutil
import statistics
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import numpy as np
import sweep_tasks
from rows import Row, options, write_rows
from timing import begin, header, line

from jaxcell.sweep import Progress, Spec, open_sweep, run_sweep
from jaxcell.sweep.workers.engines import Outcomes, Take
from jaxcell.sweep.workers.work import Computed, Failed, Job, compute


ENGINES = (("local", None), ("processes", 1), ("processes", 2), ("dask", 1), ("dask", 2))
CELLS = 10_000
MEMBERS = 512
CHUNKS = (64,)
MORE_CHUNKS = (2, 8, 32, 128)
SLOW_CHUNKS = 4
EMPTY_CHUNKS = 100
CROWD, ROUNDS = 1000, 4
_WHO = resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN
ROOMS, MORE_ROOMS = 3125, 125_000
WHOLE = """
task = "rooms"
results = ["count", "longest_period", "longest_transient"]
[fixed]
columns = 24
rows = 18
obstacles = 3
directions = 8
[grid]
room = {{ count = {rooms} }}
bounce = {{ start = 0, stop = 360, step = 45 }}
"""


class Run(NamedTuple):
    """The times of a sweep, in seconds from the call."""

    total: float
    ends: list[float]
    "The end of each chunk."

    @property
    def steady(self) -> float:
        """Seconds per chunk after the first."""
        return (self.ends[-1] - self.ends[0]) / (len(self.ends) - 1)


def spec(folder: Path, task: str, members: int, chunk: int, **fixed: float) -> Spec:
    """Write and load the specification of a sweep."""
    path = folder / "spec.toml"
    values = "\n".join(f"{name} = {value}" for name, value in fixed.items())
    path.write_text(
        f'task = "sweep_tasks:{task}"\nchunk = {chunk}\n'
        f"[fixed]\n{values}\n[grid]\nnumber = {{count = {members}}}\n"
    )
    return Spec.load(path)


def swept(folder: Path, what: Spec, engine: str, workers: int | None) -> Run:
    """Time a sweep from an empty store."""
    moments = []

    def note(progress: Progress) -> None:
        moments.append(time.perf_counter())

    shutil.rmtree(folder / "out", ignore_errors=True)
    began = time.perf_counter()
    status = run_sweep(what, folder / "out", engine=engine, workers=workers, progress=note)
    total = time.perf_counter() - began
    if not status.complete:
        raise RuntimeError(f"{engine}: {status.failures[0].message}")
    # The first moment is before the first chunk.
    return Run(total, [moment - began for moment in moments[1:]])


def throughput(folder: Path, chunks: Sequence[int], repeats: int) -> list[Row]:
    """Time periodic groups of random maps, by engine and size of chunks."""
    times = ("total, s", "start, s", "steady, 10^6 cells/s", "members/s")
    header("engine", "workers", "chunk", *times)
    rows = []
    for chunk in chunks:
        what = spec(folder, "random_maps", MEMBERS, chunk, cells=CELLS)
        batches = [what.batch(what.chunk(number)) for number in range(what.chunk_count)]
        sweep_tasks.random_maps(batches[0], what.fixed, what.seed)
        plain = []
        for _ in range(repeats):
            began = time.perf_counter()
            found = [sweep_tasks.random_maps(batch, what.fixed, what.seed) for batch in batches]
            plain.append(time.perf_counter() - began)
        expected = np.concatenate([one.groups.values for one in found])
        rate = MEMBERS / min(plain)
        rates = (f"{rate * CELLS / 1e6:.1f}", f"{rate:,.0f}")
        line("plain loop", 1, chunk, f"{min(plain):.2f}", "", *rates)
        for engine, workers in ENGINES:
            if workers is None:
                swept(folder, what, engine, workers)
            runs = [swept(folder, what, engine, workers) for _ in range(repeats)]
            with open_sweep(folder / "out") as result:
                if not np.array_equal(result.groups.values, expected):
                    raise RuntimeError(f"{engine}: its groups differ from those of the plain loop")
            best = min(runs, key=lambda run: run.steady)
            rate = chunk / best.steady
            start = best.ends[0] - best.steady * (workers or 1)
            times = (f"{best.total:.2f}", f"{start:.2f}", f"{rate * CELLS / 1e6:.1f}")
            line(engine, workers or 1, chunk, *times, f"{rate:,.0f}")
            if chunk == chunks[-1] and workers != 1:
                name = engine if workers is None else f"{workers} {engine} workers"
                title = f"sweep of random maps, {name}, start included"
                size = f"{MEMBERS:,} maps of {CELLS:,} cells"
                ours, theirs = (
                    statistics.median(run.total for run in runs),
                    statistics.median(plain),
                )
                row = Row("sweep_engine", title, size, ours, "plain loop, nothing kept", theirs)
                rows.append(row)
    return rows


def costs(folder: Path, seconds: float) -> None:
    """Measure the cost of an engine per chunk, for empty chunks and chunks of some seconds."""
    takes = f"chunk of {seconds:g} s takes, s"
    header("engine", "workers", "start, s", takes, "overhead", "empty chunk, ms")
    for engine, workers in ENGINES:
        count = workers or 1
        slow = SLOW_CHUNKS * count
        what = spec(folder, "wait", slow + EMPTY_CHUNKS, 1, seconds=seconds, slow=slow)
        ends = swept(folder, what, engine, workers).ends
        # Times between chunks of one worker; the workers alternate, but do not start together.
        each = statistics.median(ends[i + count] - ends[i] for i in range(slow - count))
        empty = (ends[-1] - ends[slow]) / (EMPTY_CHUNKS - 1)
        times = (f"{ends[0] - seconds:.2f}", f"{each:.3f}", f"{each / seconds - 1:.1%}")
        line(engine, count, *times, f"{empty * 1e3:.1f}")


def crowd(take: Take) -> Outcomes:
    """Compute jobs in a thousand threads."""
    outcomes: queue.SimpleQueue[tuple[Job, Computed | Failed]] = queue.SimpleQueue()
    with ThreadPoolExecutor(CROWD) as team:
        running = 0
        while True:
            while running < CROWD and (job := take()) is not None:
                team.submit(lambda job: outcomes.put((job, compute(job))), job)
                running += 1
            if not running:
                return
            yield outcomes.get()
            running -= 1


def driver(folder: Path, seconds: float) -> None:
    """Measure the time per chunk of the process that sends chunks and writes results."""
    times = ("each waits, s", "at best, s", "took, s", "processor, ms per chunk")
    header("workers", "chunks", *times, words=0)
    chunks = CROWD * ROUNDS
    what = spec(folder, "wait", chunks, 1, seconds=seconds, slow=chunks)
    shutil.rmtree(folder / "out", ignore_errors=True)
    began, used = time.perf_counter(), time.process_time()
    run_sweep(what, folder / "out", engine=crowd)
    took, used = time.perf_counter() - began, time.process_time() - used
    times = (f"{ROUNDS * seconds:.0f}", f"{took:.1f}", f"{used / chunks * 1e3:.2f}")
    line(f"{CROWD:,}", f"{chunks:,}", f"{seconds:g}", *times)


def whole(folder: Path, rooms: int) -> None:
    """Measure the processor time of sweeps of rooms, and extrapolate that of 10^6 members."""
    path, members = folder / "rooms.toml", 8 * rooms
    path.write_text(WHOLE.format(rooms=rooms))
    header("engine", "members", "took, s", "here, s", "workers, s", "processor, us per member")
    for engine, workers in (("local", None), ("processes", 2)):
        shutil.rmtree(folder / "out", ignore_errors=True)
        before = [resource.getrusage(who) for who in _WHO]
        began = time.perf_counter()
        run_sweep(Spec.load(path), folder / "out", engine=engine, workers=workers)
        took = time.perf_counter() - began
        after = [resource.getrusage(who) for who in _WHO]
        used = [
            b.ru_utime + b.ru_stime - a.ru_utime - a.ru_stime
            for a, b in zip(before, after, strict=True)
        ]
        each = f"{sum(used) / members * 1e6:.0f}"
        line(engine, f"{members:,}", f"{took:.1f}", *(f"{one:.1f}" for one in used), each)


def main() -> None:
    arguments = options(__doc__, repeats=1, full="more sizes, chunks of 5 s: 4 min").parse_args()
    begin("jax", "numpy", "xarray", "zarr", "distributed")
    # Workers import the tasks from this folder.
    sys.path.append(str(Path(__file__).parent))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        chunks = MORE_CHUNKS if arguments.full else CHUNKS
        rows = throughput(folder, chunks, arguments.repeats)
        print()
        costs(folder, 5.0 if arguments.full else 0.5)
        print()
        driver(folder, 2.0)
        print()
        whole(folder, MORE_ROOMS if arguments.full else ROOMS)
    write_rows(arguments.rows, rows)


if __name__ == "__main__":
    main()
