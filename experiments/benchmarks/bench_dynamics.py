"""Time attractors and basins of Thomas' system beside recurrences in Numba.

    python experiments/benchmarks/bench_dynamics.py

The peer follows the method of Attractors.jl (Datseris & Wagemakers 2022). The orbit of each cell
continues until it repeatedly visits its own cells, which are an attractor, or repeatedly visits
cells of a known attractor or basin. Both programs have the same Runge-Kutta steps. The orbits of
the peer are sequential, because each uses the labels of earlier orbits.
"""

import sys

import numba
import numpy as np
from rows import options, rows_of, write_rows
from timing import begin, line, table, take_turns

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
    """Number the attractor of each cell, from 1; -1 for orbits that leave the box."""
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
    """Stop if the shares of the three attractors differ by more than cells of this size explain.

    Recurrences may find more attractors, which are small.
    """
    one, other = map(shares, results.values())
    print(f"shares of the cells: {one.round(3)}, {other.round(3)}\n")
    if one.size != 3 or other.size < 3 or np.abs(one - other[:3]).max() > 0.1:
        sys.exit(f"attractors have {one} and {other} of the cells")


def main() -> None:
    full = f"our time for {ALL_CELLS}^3 cells, in 32 and in 64 bits"
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
    size = f"{CELLS**3:,} cells"
    what = "attractors and basins of Thomas' system"
    table(f"{what}, {size}", timings)
    if arguments.full:
        alone = {kind: lambda kind=kind: ours(ALL_CELLS, kind) for kind in ("float32", "float64")}
        for name, (_, _, median) in take_turns(alone, 1).items():
            line(f"jaxcell, {ALL_CELLS}^3 cells, {name}", "", "", f"{median:.1f}", "")
        each = timings["recurrences, Numba"].median * (ALL_CELLS / CELLS) ** 3
        line(f"recurrences, extrapolated to {ALL_CELLS}^3 cells", "", "", f"{each:.0f}", "")
    write_rows(arguments.rows, rows_of("dynamics", what, size, timings))


if __name__ == "__main__":
    main()
