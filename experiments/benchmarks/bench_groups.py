"""Time images, periodic groups and transient steps of a bouncing robot beside a Numba program.

    python experiments/benchmarks/bench_groups.py

The script prints Markdown tables. README.md in this folder explains the measurements.
"""

import concurrent.futures
import math
import multiprocessing
import sys
from collections.abc import Callable, Iterable
from typing import NamedTuple

import jax
import numba
import numpy as np
import psutil
from any_map import any_map
from rows import Row, options, rows_of, write_rows
from timing import Timing, begin, header, line, peak_bytes, take_turns

from experiments.shared.data import MAPS
from jaxcell import bounce
from jaxcell.mapping import GroupSummary
from jaxcell.space import CellSpace, Motion, Stencil, Workspace, stencil


# The processes that measure memory import only this module.
jax.config.update("jax_enable_x64", True)

DIRECTIONS = 360
BOUNCE = math.pi / 2
MAP = MAPS / "room_200x125.json"
SIZES = [1e5, 1e6, 1e7]
MORE_SIZES = [3e5, 3e6, 3e7]


def room(scale: float = 1.0, directions: int = DIRECTIONS) -> CellSpace:
    """Make the cells of the bundled room of 200 x 125 m, in squares of `1 / scale` metres."""
    return CellSpace.of_grid(CellSpace.of(Workspace.load(MAP), 1 / scale, 1).free, directions)


class Groups(NamedTuple):
    image: np.ndarray | jax.Array
    group: np.ndarray | jax.Array
    step: np.ndarray | jax.Array
    count: int | jax.Array


# The peer: Alg. 2.1, every cell mapped once and visited twice.


@numba.njit(cache=False, inline="always")
def finish_walk(path, length, z, group, step, count):
    """Label the cells of a walk that ends at `z`, a cell of this walk (-2) or of an earlier one."""
    if group[z] == -2:
        while True:
            length -= 1
            group[path[length]] = count
            step[path[length]] = 0
            if path[length] == z:
                break
        count += 1
    label, steps = group[z], step[z]
    for i in range(length - 1, -1, -1):
        steps += 1
        group[path[i]] = label
        step[path[i]] = steps
    return count


@numba.njit(cache=False, inline="always")
def destination(position, square, way, offset, crossed, beside):
    """Find the position after a step; -1 if the robot bumps."""
    to = position[square + offset[way]]
    for j in range(crossed.shape[1]):
        if position[square + crossed[way, j]] < 0:
            to = -1
    for j in range(beside.shape[1]):
        left, right = beside[way, j]
        if (position[square + left] < 0) & (position[square + right] < 0):
            to = -1
    return to


@numba.njit(cache=False)
def walk_on_grid(position, square, offset, crossed, beside, shift, image, group, step, path):
    directions, positions = offset.size, square.size
    count = 0
    group[:] = -1
    for direction in range(directions):
        for start in range(positions):
            z, length = direction * positions + start, 0
            k, here = direction, square[start]
            while group[z] == -1:
                group[z] = -2
                path[length] = z
                length += 1
                to = destination(position, here, k, offset, crossed, beside)
                if to < 0:
                    to = position[here]
                    k = (k + shift) % directions
                else:
                    here += offset[k]
                to += k * positions
                image[z] = to
                z = to
            if length:
                count = finish_walk(path, length, z, group, step, count)
    return count


@numba.njit(cache=False)
def tabulate(position, square, offset, crossed, beside):
    target = np.empty((offset.size, square.size), np.int32)
    for way in range(offset.size):
        for p in range(square.size):
            to = destination(position, square[p], way, offset, crossed, beside)
            target[way, p] = p if to < 0 else to
    return target


@numba.njit(cache=False)
def walk_on_table(target, ways, shift, image, group, step, path):
    directions, positions = ways.size, target.shape[1]
    count = 0
    group[:] = -1
    for direction in range(directions):
        for start in range(positions):
            z, length = direction * positions + start, 0
            k, here, way = direction, start, ways[direction]
            while group[z] == -1:
                group[z] = -2
                path[length] = z
                length += 1
                there = target[way, here]
                if there == here:
                    k = (k + shift) % directions
                    way = ways[k]
                here = there
                to = k * positions + here
                image[z] = to
                z = to
            if length:
                count = finish_walk(path, length, z, group, step, count)
    return count


@numba.njit(cache=False)
def summary_of_arrays(group, step, count):
    """Compute periods, basins and longest transients, in the order of the groups' first cells."""
    number = np.full(count, -1, np.int32)
    period, basin, transient = np.zeros((3, count), np.int32)
    known = 0
    for z in range(group.size):
        g = group[z]
        basin[g] += 1
        transient[g] = max(transient[g], step[z])
        if step[z] == 0:
            period[g] += 1
            if number[g] == -1:
                number[g] = known
                known += 1
    order = np.argsort(number)
    return count, period[order], basin[order], transient[order]


def flat(shape: Stencil, columns: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Convert the squares of a stencil to offsets, and pad its lists with the end square."""
    weights = np.array([columns, 1])
    most = max(map(len, shape.crossed)), max(1, *map(len, shape.beside))
    rows = list(zip(map(tuple, shape.offset), shape.crossed, shape.beside, strict=True))
    crossed = np.array([(*c, *[o] * (most[0] - len(c))) for o, c, _ in rows]) @ weights
    beside = np.array([(*b, *[(o, o)] * (most[1] - len(b))) for o, _, b in rows]) @ weights
    return shape.offset @ weights, crossed, beside


def peer_groups(cells: CellSpace, collision: str, tabulated: bool) -> Groups:
    """Compute the groups by Alg. 2.1, on the grid or on a table of steps."""
    # Each square has all neighbours because of a margin of blocked squares.
    position = np.pad(cells.position_of_square, 1, constant_values=-1)
    square = np.flatnonzero(position.ravel() >= 0)
    shape = stencil(cells.directions, Motion(collision=collision), cells.free.shape)
    offset, crossed, beside = flat(shape, position.shape[1])
    if collision == "endpoint":
        crossed, beside = crossed[:, :0], beside[:, :0]
    shift = bounce.bounce_shift(BOUNCE, cells.directions)
    # NumPy, unlike Numba, requests huge pages for large arrays.
    arrays = [np.empty(cells.size, np.int32) for _ in range(4)]
    if tabulated:
        target = tabulate(position.ravel(), square, offset, crossed, beside)
        count = walk_on_table(target, shape.way, int(shift), *arrays)
    else:
        steps = (x[shape.way] for x in (offset, crossed, beside))
        count = walk_on_grid(position.ravel(), square, *steps, int(shift), *arrays)
    return Groups(*arrays[:3], count)


def peer_summary(cells: CellSpace, collision: str, tabulated: bool) -> GroupSummary:
    groups = peer_groups(cells, collision, tabulated)
    return GroupSummary(*summary_of_arrays(groups.group, groups.step, groups.count))


def two_calls(cells: CellSpace, collision: str) -> Groups:
    image = bounce.bounce_map(cells, BOUNCE, motion=Motion(collision=collision)).image
    groups = bounce.bounce_groups(cells, BOUNCE, motion=Motion(collision=collision))
    return jax.block_until_ready(Groups(image, groups.group, groups.step, groups.count))


def summary_only(cells: CellSpace, collision: str) -> GroupSummary:
    return jax.block_until_ready(
        bounce.group_summary(cells, BOUNCE, motion=Motion(collision=collision))
    )


def check(results: dict[str, Groups | GroupSummary]) -> None:
    """Stop if the results of two programs differ in any cell.

    jaxcell numbers groups by their smallest periodic cells. Alg. 2.1 numbers them as it visits
    their basins, so its groups are renumbered here, without timing.
    """

    def ordered(result: Groups | GroupSummary) -> list[np.ndarray]:
        if isinstance(result, GroupSummary):
            tables = (result.period, result.basin, result.transient)
            return [np.asarray(x)[: int(result.count)] for x in tables]
        image, group, step, count = map(np.asarray, result)
        periodic = group[step == 0]
        _, first = np.unique(periodic, return_index=True)
        number = np.empty(count, np.int32)
        number[periodic[np.sort(first)]] = np.arange(count)
        return [image, number[group], step, count]

    names = list(results)
    expected = ordered(results[names[0]])
    for name in names[1:]:
        for found, wanted in zip(ordered(results[name]), expected, strict=True):
            if not np.array_equal(found, wanted):
                sys.exit(f"{name} and {names[0]} disagree")


EXPANDED = ["jaxcell", "jaxcell, map known", "Alg. 2.1", "Alg. 2.1 on a table"]
SUMMARY = ["jaxcell, summary", "Alg. 2.1, summary", "Alg. 2.1 on a table, summary"]


def both_alike(results: dict[str, Groups | GroupSummary]) -> None:
    for names in (EXPANDED, SUMMARY):
        check({name: results[name] for name in names})


def programs(cells: CellSpace, collision: str) -> dict[str, Callable[[], object]]:
    """Make all programs by name."""

    # A new space has nothing in its caches.
    def new() -> CellSpace:
        return CellSpace.of_grid(cells.free, cells.directions)

    calls = [
        lambda: two_calls(new(), collision),
        lambda: two_calls(cells, collision),
        lambda: peer_groups(new(), collision, False),
        lambda: peer_groups(new(), collision, True),
        lambda: summary_only(new(), collision),
        lambda: peer_summary(new(), collision, False),
        lambda: peer_summary(new(), collision, True),
    ]
    return dict(zip(EXPANDED + SUMMARY, calls, strict=True))


def compile_peer() -> None:
    for collision in ("endpoint", "swept"):
        for tabulated in (False, True):
            peer_summary(room(0.1), collision, tabulated)


def rows_for(timings: dict[str, Timing], cells: CellSpace, collision: str) -> list[Row]:
    """Make rows with the faster of both peers."""
    rows = []
    wanted = "image, group and step of all cells", "counts, periods, basins, longest transients"
    for what, (ours, *_, grid, table) in zip(wanted, (EXPANDED, SUMMARY), strict=True):
        peer = min(grid, table, key=lambda name: timings[name].median)
        both = {ours: timings[ours], f"{peer}, Numba": timings[peer]}
        what = f"{what}, collision {collision!r}"
        rows += rows_of("groups", what, f"{cells.size:,} cells", both)
    return rows


def side_by_side(collision: str, repeats: int) -> list[Row]:
    """Time all programs on the room."""
    cells = room()
    timings = take_turns(programs(cells, collision), repeats, both_alike)
    print(f"\n### 200 x 125 x {DIRECTIONS}, {cells.size:,} cells, collision {collision!r}\n")
    header("program", "first call, s", "min, ms", "median, ms", "Alg. 2.1 takes", "on a table")
    for names in (EXPANDED, SUMMARY):
        for name in names:
            first, least, median = timings[name]
            ratios = [f"{timings[peer].median / median:.2f} x" for peer in names[-2:]]
            line(name, f"{first:.2f}", f"{least * 1e3:.1f}", f"{median * 1e3:.1f}", *ratios)
    return rows_for(timings, cells, collision)


def series(title: str, spaces: Iterable[CellSpace], repeats: int) -> list[Row]:
    """Print the median times in several sizes, and the exponents of their growth.

    The returned rows are for the smallest size, which is best for the peer.
    """
    names = EXPANDED + SUMMARY
    print(f"\n### {title}, collision 'swept', median ms\n")
    header("cells", *names, words=0)
    counted, measured, rows = [], [], []
    for cells in spaces:
        # Small cases have more turns, and the largest fewer.
        turns = 3 if cells.size > 2e7 else max(repeats, min(50, round(repeats * 3e6 / cells.size)))
        timings = take_turns(programs(cells, "swept"), turns, both_alike)
        rows = rows or rows_for(timings, cells, "swept")
        counted.append(cells.size)
        measured.append([timings[name].median for name in names])
        line(f"{cells.size:,}", *(f"{1e3 * s:.2f}" for s in measured[-1]))
    slopes = np.polyfit(np.log(counted), np.log(measured), 1)[0]
    line("exponent", *(f"{slope:.2f}" for slope in slopes))
    return rows


def bytes_per_cell(scale: float, name: str) -> float:
    """Measure the peak memory of a call above that of a small room, in a new process."""
    programs(room(0.1), "swept")[name]()
    cells = room(scale)
    before = psutil.Process().memory_info().rss
    programs(cells, "swept")[name]()
    return (peak_bytes() - before) / cells.size


def memory(size: float) -> None:
    """Print the peak memory of four programs."""
    scale = math.sqrt(size / room().size)
    print(f"\n### Peak memory, {room(scale).size:,} cells\n")
    header("program", "bytes per cell")
    for name in (EXPANDED[0], EXPANDED[2], SUMMARY[0], SUMMARY[1]):
        spawn = multiprocessing.get_context("spawn")
        with concurrent.futures.ProcessPoolExecutor(1, mp_context=spawn) as process:
            line(name, f"{process.submit(bytes_per_cell, scale, name).result():.1f}")


def main() -> None:
    full = "memory, other collisions, fewer directions, and 30,000,000 cells"
    arguments = options(__doc__, repeats=9, full=full).parse_args()
    repeats = arguments.repeats
    begin("jax", "numba", "numpy", "scipy")
    # This part is first because the recorded peak of a child begins at the size of its parent.
    if arguments.full:
        memory(MORE_SIZES[-1])
    compile_peer()
    rows = side_by_side("swept", repeats)
    if arguments.full:
        rows += side_by_side("endpoint", repeats)
    rows += any_map(np.asarray(bounce.bounce_map(room(), BOUNCE).image), min(repeats, 5))
    full_size = room().size
    sizes = sorted(SIZES + MORE_SIZES) if arguments.full else SIZES
    rooms = (room(math.sqrt(size / full_size)) for size in sizes)
    rows += series(f"Rooms of all sizes, {DIRECTIONS} directions", rooms, repeats)
    if arguments.full:
        fewer = (room(directions=directions) for directions in (4, 12, 36, 120))
        series("The same room, fewer directions", fewer, repeats)
    write_rows(arguments.rows, rows)


if __name__ == "__main__":
    main()
