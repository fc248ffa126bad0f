"""Times Figure 2.7 on all cores, side by side with a Numba pass over the same rooms.

Run `python experiments/benchmarks/bench_group_study.py`; it takes about 20 s, and with `--full`,
which is the whole of the figure, about 3 min.

Both programs get the same rooms, and give the number of periodic groups and the longest transient
of each, which have to be equal; rooms are shared out to a thread for each core in both. The peer is
Alg. 2.1 as in `bench_groups.py`, in its faster form, on a table of the steps of all positions.
"""

import functools
import os
import statistics
import sys
import threading
import time
from collections.abc import Callable
from multiprocessing.pool import ThreadPool

import numba
import numpy as np
from bench_groups import flat, tabulate, walk_on_table
from rows import Row, options, write_rows
from timing import begin, line

from experiments.chapter_2.group_study import BATCH, BOUNCE_DEG, groups_and_transients
from jaxcell.space import ENDPOINT, CellSpace, stencil
from jaxcell.space.maps.random_rooms import DIRECTIONS, ENVIRONMENTS, place


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
    shape = stencil(DIRECTIONS, ENDPOINT, cells.free.shape)
    offset, crossed, beside = flat(shape, position.shape[1])
    none = crossed[:, :0], beside[:, :0]
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


def main() -> None:
    parser = options(__doc__, repeats=3, full="all 100 placements of each environment: 3 min")
    parser.add_argument("--threads", type=int, default=os.cpu_count())
    arguments = parser.parse_args()
    runs = 100 if arguments.full else 10
    free = np.array([place(0, e, run).free for run in range(runs) for e in ENVIRONMENTS])
    cells = int(free.sum()) * DIRECTIONS
    begin("numpy", "numba")
    print(f"{len(free)} rooms, {cells:,} cells; {arguments.threads} threads\n")
    programs: dict[str, Callable[[np.ndarray, int], np.ndarray]] = {
        "jaxcell.bounce.grid_groups": our_study,
        "Alg. 2.1 on a table, Numba": peer_study,
    }
    for program in programs.values():
        program(free[: 2 * BATCH], arguments.threads)
    found: dict[str, np.ndarray] = {}
    wall: dict[str, list[float]] = {name: [] for name in programs}
    for _ in range(arguments.repeats):
        for name, program in programs.items():
            began = time.perf_counter()
            found[name] = program(free, arguments.threads)
            wall[name].append(time.perf_counter() - began)
    (ours, one), (peer, other) = found.items()
    wrong = np.flatnonzero((one != other).any(axis=0))
    if wrong.size:
        sys.exit(f"room {wrong[0]}: {one[:, wrong[0]]} and {other[:, wrong[0]]}")
    line("", "least, s", "median, s", "ours = 1")
    line("---", *["--:"] * 3)
    median = {name: statistics.median(seconds) for name, seconds in wall.items()}
    for name in programs:
        ratio = median[name] / median[ours]
        line(name, f"{min(wall[name]):.2f}", f"{median[name]:.2f}", f"{ratio:.1f}")
    what = "periodic groups and longest transients of Figure 2.7"
    size = f"{len(free)} rooms of 200 x 125 squares and 360 directions"
    told = f"{peer}, {arguments.threads} threads"
    write_rows(arguments.rows, [Row("group_study", what, size, median[ours], told, median[peer])])


if __name__ == "__main__":
    main()
