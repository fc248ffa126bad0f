"""Times attractors and basins of Thomas' system, side by side with recurrences in Numba.

    python experiments/benchmarks/bench_dynamics.py

The peer does what Attractors.jl does (Datseris & Wagemakers 2022): the orbit of each cell is
followed through the cells until it is where it has been again and again, which is an attractor, or
where others have been that have ended. Both map by the same Runge-Kutta steps; the peer's orbits
come one after the other, since each needs what those before it have left.
"""

import sys

import numba
import numpy as np
from rows import options, rows_of, write_rows
from timing import begin, line, take_turns

from jaxcell import dynamics
from jaxcell.dynamics import systems
from jaxcell.space import Box


CELLS, ALL_CELLS = 61, 251
B, DT, STEPS = 0.1665, 0.1, 20
# The defaults of Attractors.jl.
RECURRENCES, LOCATE, HIT_ATTRACTOR, HIT_BASIN, LOST = 100, 1000, 2, 10, 20


@numba.njit(cache=False, inline="always")
def field(x, y, z):
    return np.sin(y) - B * x, np.sin(z) - B * y, np.sin(x) - B * z


@numba.njit(cache=False)
def mapped(x, y, z):
    for _ in range(STEPS):
        a1, b1, c1 = field(x, y, z)
        a2, b2, c2 = field(x + DT / 2 * a1, y + DT / 2 * b1, z + DT / 2 * c1)
        a3, b3, c3 = field(x + DT / 2 * a2, y + DT / 2 * b2, z + DT / 2 * c2)
        a4, b4, c4 = field(x + DT * a3, y + DT * b3, z + DT * c3)
        x += DT / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
        y += DT / 6 * (b1 + 2 * b2 + 2 * b3 + b4)
        z += DT / 6 * (c1 + 2 * c2 + 2 * c3 + c4)
    return x, y, z


@numba.njit(cache=False, inline="always")
def cell_of(x, y, z, lower, width, cells):
    i = int(np.floor((x - lower) / width))
    j = int(np.floor((y - lower) / width))
    k = int(np.floor((z - lower) / width))
    inside = (0 <= i < cells) & (0 <= j < cells) & (0 <= k < cells)
    return (i * cells + j) * cells + k if inside else -1


@numba.njit(cache=False)
def recurrences(lower, width, cells):
    """The attractor of each cell, from 1; -1 for those that leave the box."""
    basin = np.zeros(cells**3, np.int32)
    attractor = np.zeros(cells**3, np.int32)
    seen = np.full(cells**3, -1, np.int32)
    found = 0
    for start in range(cells**3):
        if basin[start]:
            continue
        x = lower + (start // cells**2 + 0.5) * width
        y = lower + (start // cells % cells + 0.5) * width
        z = lower + (start % cells + 0.5) * width
        again = on_attractor = in_basin = lost = last = label = 0
        while label == 0:
            x, y, z = mapped(x, y, z)
            here = cell_of(x, y, z, lower, width, cells)
            if here < 0:
                lost += 1
                label = -1 if lost == LOST else 0
                continue
            hit, known = attractor[here], basin[here]
            again = again + 1 if seen[here] == start else 0
            on_attractor = on_attractor + 1 if hit else 0
            in_basin = in_basin + 1 if known > 0 and known == last else min(known, 1)
            last, lost = known, 0
            seen[here] = start
            if on_attractor == HIT_ATTRACTOR:
                label = hit
            elif in_basin == HIT_BASIN:
                label = known
            elif again == RECURRENCES:
                found += 1
                label = found
                for _ in range(LOCATE):
                    x, y, z = mapped(x, y, z)
                    here = cell_of(x, y, z, lower, width, cells)
                    if here >= 0:
                        attractor[here] = basin[here] = found
        basin[start] = label
    return basin


def box(cells: int) -> Box:
    return Box([-6] * 3, [6] * 3, [cells] * 3)


def shares(basin: np.ndarray) -> np.ndarray:
    return np.sort(np.unique(basin[basin > 0], return_counts=True)[1] / basin.size)[::-1]


def agree(results: dict[str, np.ndarray]) -> None:
    """Refuses other shares than cells of this size explain; recurrences find small ones besides."""
    one, other = map(shares, results.values())
    print(f"shares of the cells: {one.round(3)}, {other.round(3)}\n")
    if one.size != 3 or other.size < 3 or np.abs(one - other[:3]).max() > 0.1:
        sys.exit(f"attractors have {one} and {other} of the cells")


def main() -> None:
    full = f"{ALL_CELLS}^3 cells of ours, in 32 and in 64 bits"
    arguments = options(__doc__, repeats=3, full=full).parse_args()
    begin("jax", "numba", "numpy")
    system = systems.thomas

    def ours(cells: int, dtype: str) -> np.ndarray:
        return dynamics.basins(system.map, box(cells), {"b": B}, dtype=dtype).basin + 1

    programs = {
        "jaxcell": lambda: ours(CELLS, "float64"),
        "recurrences, Numba": lambda: recurrences(-6.0, 12 / CELLS, CELLS),
    }
    timings = take_turns(programs, arguments.repeats, agree)
    line("", "first call, s", "median, s", "ours = 1")
    line("---", *["--:"] * 3)
    for name, (first, _, median) in timings.items():
        line(name, f"{first:.2f}", f"{median:.2f}", f"{median / timings['jaxcell'].median:.1f}")
    if arguments.full:
        alone = {kind: lambda kind=kind: ours(ALL_CELLS, kind) for kind in ("float32", "float64")}
        for name, (_, _, median) in take_turns(alone, 1).items():
            line(f"jaxcell, {ALL_CELLS}^3 cells, {name}", "", f"{median:.1f}", "")
        each = timings["recurrences, Numba"].median * (ALL_CELLS / CELLS) ** 3
        line("recurrences, as many at that time a cell, float64", "", f"{each:.0f}", "")
    size = f"{CELLS**3:,} cells"
    what = "attractors and basins of Thomas' system"
    write_rows(arguments.rows, rows_of("dynamics", what, size, timings))


if __name__ == "__main__":
    main()
