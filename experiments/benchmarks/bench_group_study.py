"""The whole of Figure 2.7 on all cores, side by side with a Numba pass over the same rooms.

    python experiments/benchmarks/bench_group_study.py --runs 100

Both get the same rooms, and give the number of periodic groups and the longest transient of each,
which have to be equal; rooms are shared out to a thread for each core in both. The peer is Alg. 2.1
as in `bench_groups.py`, in its faster form, on a table of the steps of all positions.
"""

import argparse
import functools
import math
import os
import sys
import threading
import time
from collections.abc import Callable
from multiprocessing.pool import ThreadPool
from pathlib import Path

import numba
import numpy as np
from bench_groups import tabulate, walk_on_table

from jaxcell import bounce
from jaxcell.space import CellSpace, stencil
from jaxcell.sweep.tasks.rooms import DIRECTIONS, ENVIRONMENTS, place


sys.path.insert(0, str(Path(__file__).parents[1]))
from ch2_group_study import BATCH, BOUNCE_DEG, groups_and_transients


SHIFT = BOUNCE_DEG * DIRECTIONS // 360


@numba.njit(cache=False, nogil=True)
def peer_room(position, square, offset, crossed, beside, ways, shift, image, group, step, path):
    target = tabulate(position, square, offset, crossed, beside)
    count = walk_on_table(target, ways, shift, image, group, step, path)
    return count, step.max()


@functools.cache
def peer_arrays(_thread: int, size: int) -> list[np.ndarray]:
    """Arrays over the cells of a room; a thread uses its own again and again."""
    return [np.empty(size, np.int32) for _ in range(4)]


def peer(free: np.ndarray) -> tuple[int, int]:
    cells = CellSpace.of_grid(free, DIRECTIONS)
    # A margin of blocked squares makes every look-up of a neighbour safe.
    position = np.pad(cells.position_of_square, 1, constant_values=-1)
    square = np.flatnonzero(position.ravel() >= 0)
    shape = stencil(DIRECTIONS, 1.0, "endpoint")
    weights = np.array([position.shape[1], 1])
    offset, look = shape.offset @ weights, shape.square @ weights
    none = look[shape.crossed][:, :0], look[shape.beside][:, :0]
    arrays = [x[: cells.size] for x in peer_arrays(threading.get_ident(), free.size * DIRECTIONS)]
    count, longest = peer_room(position.ravel(), square, offset, *none, shape.way, SHIFT, *arrays)
    return int(count), int(longest)


def peer_study(free: np.ndarray, threads: int) -> np.ndarray:
    with ThreadPool(threads) as pool:
        return np.array(pool.map(peer, free, chunksize=1)).T


def our_study(free: np.ndarray, threads: int) -> np.ndarray:
    batches = [free[i : i + BATCH] for i in range(0, len(free), BATCH)]
    with ThreadPool(threads) as pool:
        return np.concatenate(pool.map(groups_and_transients, batches, chunksize=1), axis=1)


def one_at_a_time(free: np.ndarray, _threads: int) -> np.ndarray:
    """By way of the full section of each room, in JAX."""
    found = []
    for room in free:
        cells = CellSpace.of_grid(room, DIRECTIONS)
        summary = bounce.group_summary(cells, math.radians(BOUNCE_DEG), collision="endpoint")
        found.append((int(summary.count), int(summary.transient.max())))
    return np.array(found).T


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=5, help="placements of each environment")
    parser.add_argument("--repeats", type=int, default=3, help="timed turns of each program")
    parser.add_argument("--threads", type=int, default=os.cpu_count())
    options = parser.parse_args()
    free = np.array([place(0, e, run).free for run in range(options.runs) for e in ENVIRONMENTS])
    cells = int(free.sum()) * DIRECTIONS
    print(
        f"{len(free)} rooms, {cells:,} cells; {options.threads} threads on {os.cpu_count()} cores, "
        f"load {os.getloadavg()[0]:.1f}"
    )
    programs: dict[str, Callable[[np.ndarray, int], np.ndarray]] = {
        "jaxcell.bounce.grid_groups": our_study,
        "Alg. 2.1 on a table, Numba": peer_study,
        "jaxcell.bounce.group_summary, room by room": one_at_a_time,
    }
    first = {
        name: program(free[: 2 * BATCH], options.threads) for name, program in programs.items()
    }
    wall, cpu = ({name: [] for name in programs} for _ in range(2))
    for _ in range(options.repeats):
        for name, program in programs.items():
            began = time.perf_counter(), time.process_time()
            first[name] = program(free, options.threads)
            wall[name].append(time.perf_counter() - began[0])
            cpu[name].append(time.process_time() - began[1])
    expected = first[next(iter(programs))]
    for name, found in first.items():
        wrong = np.flatnonzero((found != expected).any(axis=0))
        if wrong.size:
            sys.exit(f"{name}: room {wrong[0]}: {found[:, wrong[0]]}, not {expected[:, wrong[0]]}")
    print("Counts and longest transients are equal in all rooms.\n")
    print("| | least wall, s | median wall, s | least CPU, s | wall, ours = 1 |")
    print("|---|--:|--:|--:|--:|")
    ours = min(wall[next(iter(programs))])
    for name in programs:
        least, median = min(wall[name]), float(np.median(wall[name]))
        print(
            f"| {name} | {least:.2f} | {median:.2f} | {min(cpu[name]):.2f} | {least / ours:.1f} |"
        )


if __name__ == "__main__":
    main()
