"""Time Figure 2.7 on all cores beside a Numba program for the same rooms.

Run `python experiments/benchmarks/bench_group_study.py`; it takes about 20 s. With `--full` it
takes about 3 min, for all rooms of the figure.

Both programs compute the number of periodic groups and the longest transient of the same rooms, and
must agree. Both distribute the rooms over one thread per core. The peer is Alg. 2.1 as in
`bench_groups.py`, in its faster form, on a table of the steps of all positions.
"""

import functools
import os
import sys
import threading
from multiprocessing.pool import ThreadPool

import numba
import numpy as np
from bench_groups import flat, tabulate, walk_on_table
from rows import options, rows_of, write_rows
from timing import begin, table, take_turns

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
    """Allocate arrays over the cells of a room, which each thread reuses."""
    return [np.empty(size, np.int32) for _ in range(4)]


def peer(free: np.ndarray) -> tuple[int, int]:
    """Compute the number of groups and the longest transient of a room by Alg. 2.1."""
    cells = CellSpace.of_grid(free, DIRECTIONS)
    # Each square has all neighbours because of a margin of blocked squares.
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
    parser.add_argument("--threads", type=int, default=os.cpu_count(), help="threads per program")
    arguments = parser.parse_args()
    runs = 100 if arguments.full else 10
    free = np.array([place(0, e, run).free for run in range(runs) for e in ENVIRONMENTS])
    cells = int(free.sum()) * DIRECTIONS
    begin("numpy", "numba")
    print(f"{len(free)} rooms, {cells:,} cells; {arguments.threads} threads\n")
    programs = {
        "jaxcell.bounce.grid_groups": lambda: our_study(free, arguments.threads),
        f"Alg. 2.1 on a table, Numba, {arguments.threads} threads": lambda: peer_study(
            free, arguments.threads
        ),
    }

    def check(results: dict[str, np.ndarray]) -> None:
        one, other = results.values()
        wrong = np.flatnonzero((one != other).any(axis=0))
        if wrong.size:
            sys.exit(f"room {wrong[0]}: {one[:, wrong[0]]} and {other[:, wrong[0]]}")

    timings = take_turns(programs, arguments.repeats, check, patience_s=60)
    what = "periodic groups and longest transients of Figure 2.7"
    table(what, timings)
    size = f"{len(free)} rooms of 200 x 125 squares and 360 directions"
    write_rows(arguments.rows, rows_of("group_study", what, size, timings))


if __name__ == "__main__":
    main()
