"""Times the engines of sweeps: members a second against the size of chunks, and what they cost.

Run `python experiments/benchmarks/bench_sweep_engine.py`; it takes about 45 s.

The first table is of periodic groups of random maps, the second of a task that only waits, so that
what is left is the engine's: the jobs on their way, the results on theirs, the files. *Steady* is
from the end of the first chunk to that of the last; *start* is from the call to the end of the
first chunk, less what that takes. With `--full` the task waits for 5 s, and not for 0.5 s.

The third is of the one process that hands chunks to a thousand workers, here threads that sleep,
and writes their results. Its time of the processor is what limits the number of workers; it
computes the chunks, too, which on a cluster it does not.

The peer is a plain loop over the batches of the task in this process, which keeps nothing. Imports
and compilation in this process are in neither; those of workers are in the start of their sweep.
"""

import queue
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
from timing import begin, line

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


class Run(NamedTuple):
    """A sweep that was timed: seconds from the call."""

    total: float
    ends: list[float]
    "When each chunk was done."

    @property
    def steady(self) -> float:
        """Seconds a chunk, after the first."""
        return (self.ends[-1] - self.ends[0]) / (len(self.ends) - 1)


def spec(folder: Path, task: str, members: int, chunk: int, **fixed: float) -> Spec:
    path = folder / "spec.toml"
    told = "\n".join(f"{name} = {value}" for name, value in fixed.items())
    path.write_text(
        f'task = "sweep_tasks:{task}"\nchunk = {chunk}\n'
        f"[fixed]\n{told}\n[grid]\nnumber = {{count = {members}}}\n"
    )
    return Spec.load(path)


def swept(folder: Path, what: Spec, engine: str, workers: int | None) -> Run:
    moments = []

    def note(progress: Progress) -> None:
        moments.append(time.perf_counter())

    shutil.rmtree(folder / "out", ignore_errors=True)
    began = time.perf_counter()
    found = run_sweep(what, folder / "out", engine=engine, workers=workers, progress=note)
    total = time.perf_counter() - began
    if not found.complete:
        raise RuntimeError(f"{engine}: {found.failures[0].message}")
    # The first moment is that of the beginning.
    return Run(total, [moment - began for moment in moments[1:]])


def throughput(folder: Path, chunks: Sequence[int], repeats: int) -> list[Row]:
    """Periodic groups of random maps, by engine and size of chunks."""
    line("engine", "workers", "chunk", "total, s", "start, s", "steady, 10^6 cells/s", "members/s")
    line("---", *["--:"] * 6)
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
        told = (f"{min(plain):.2f}", "", f"{rate * CELLS / 1e6:.1f}", f"{rate:,.0f}")
        line("plain loop", 1, chunk, *told)
        for engine, workers in ENGINES:
            if workers is None:
                swept(folder, what, engine, workers)
            runs = [swept(folder, what, engine, workers) for _ in range(repeats)]
            with open_sweep(folder / "out") as result:
                if not np.array_equal(result.groups.values, expected):
                    raise RuntimeError(f"{engine}: other groups than those of the plain loop")
            best = min(runs, key=lambda run: run.steady)
            rate = chunk / best.steady
            start = best.ends[0] - best.steady * (workers or 1)
            told = (f"{best.total:.2f}", f"{start:.2f}")
            line(engine, workers or 1, chunk, *told, f"{rate * CELLS / 1e6:.1f}", f"{rate:,.0f}")
            if chunk == chunks[-1] and workers != 1:
                name = engine if workers is None else f"{workers} {engine} workers"
                rows.append(
                    Row(
                        "sweep_engine",
                        f"sweep of random maps, {name}, start included",
                        f"{MEMBERS:,} maps of {CELLS:,} cells",
                        statistics.median(run.total for run in runs),
                        "plain loop, nothing kept",
                        statistics.median(plain),
                    )
                )
    return rows


def costs(folder: Path, seconds: float) -> None:
    """Measure the cost of an engine per chunk, for empty chunks and chunks of some seconds."""
    takes = f"chunk of {seconds:g} s takes, s"
    line("engine", "workers", "start, s", takes, "overhead", "empty chunk, ms")
    line("---", *["--:"] * 5)
    for engine, workers in ENGINES:
        count = workers or 1
        slow = SLOW_CHUNKS * count
        what = spec(folder, "wait", slow + EMPTY_CHUNKS, 1, seconds=seconds, slow=slow)
        ends = swept(folder, what, engine, workers).ends
        # From a chunk to the next of the same worker: they take turns, but do not begin together.
        each = statistics.median(ends[i + count] - ends[i] for i in range(slow - count))
        empty = (ends[-1] - ends[slow]) / (EMPTY_CHUNKS - 1)
        told = (f"{ends[0] - seconds:.2f}", f"{each:.3f}", f"{each / seconds - 1:.1%}")
        line(engine, count, *told, f"{empty * 1e3:.1f}")


def crowd(take: Take) -> Outcomes:
    """An engine of a thousand threads."""
    outcomes: queue.SimpleQueue[tuple[Job, Computed | Failed]] = queue.SimpleQueue()
    with ThreadPoolExecutor(CROWD) as team:
        on_their_way = 0
        while True:
            while on_their_way < CROWD and (job := take()) is not None:
                team.submit(lambda job: outcomes.put((job, compute(job))), job)
                on_their_way += 1
            if not on_their_way:
                return
            yield outcomes.get()
            on_their_way -= 1


def driver(folder: Path, seconds: float) -> None:
    """Measure the time per chunk of the process that feeds the workers and writes."""
    line("workers", "chunks", "each waits, s", "at best, s", "took, s", "processor, ms a chunk")
    line(*["--:"] * 6)
    chunks = CROWD * ROUNDS
    what = spec(folder, "wait", chunks, 1, seconds=seconds, slow=chunks)
    shutil.rmtree(folder / "out", ignore_errors=True)
    began, used = time.perf_counter(), time.process_time()
    run_sweep(what, folder / "out", engine=crowd)
    took, used = time.perf_counter() - began, time.process_time() - used
    told = (f"{ROUNDS * seconds:.0f}", f"{took:.1f}", f"{used / chunks * 1e3:.2f}")
    line(f"{CROWD:,}", f"{chunks:,}", f"{seconds:g}", *told)


def main() -> None:
    arguments = options(__doc__, repeats=1, full="more sizes, chunks of 5 s: 4 min").parse_args()
    begin("jax", "numpy", "xarray", "zarr", "distributed")
    # Workers find the tasks where this process does.
    sys.path.append(str(Path(__file__).parent))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        chunks = MORE_CHUNKS if arguments.full else CHUNKS
        rows = throughput(folder, chunks, arguments.repeats)
        print()
        costs(folder, 5.0 if arguments.full else 0.5)
        print()
        driver(folder, 2.0)
    write_rows(arguments.rows, rows)


if __name__ == "__main__":
    main()
