"""Time mean exit times along a parameter of a noisy map of the plane, beside dense matrices.

Run `python experiments/benchmarks/bench_exits.py`; it takes about a minute.

A particle jumps between two wells on 64 x 64 cells, with noise at each mapping. Its mean time until
the other well, the derivative by the depth of the wells, and the share of time in the other well
are computed for some depths. The peer makes the matrix of one depth with scipy, from the same
points, and solves it with LAPACK, without the derivative. The time of 1,000 depths is extrapolated
from those of a solved chain and of a member; with `--full` they are all computed, in minutes.
"""

import dataclasses
import time
from typing import Any

import jax.numpy as jnp
import numpy as np
import scipy.linalg
from rows import Row, options, rows_of, write_rows
from scipy.special import ndtr
from timing import Timing, begin, table, take_turns

from jaxcell import dynamics
from jaxcell.dynamics.noise.chains import sampled
from jaxcell.dynamics.noise.family import Family
from jaxcell.space import Box


CELLS, MEMBERS, FEW = 64, 1000, 20
NOISE = 0.15
ABOUT = {
    "noise": NOISE,
    "start": [-1.0, 0.0],
    "into": lambda x: x[:, 0] > 0,
}
FIRST, LAST = 0.9, 1.1
BOX = Box([-2, -2], [2, 2], [CELLS, CELLS], "clamp")
# Largest relative difference of both programs.
AGREEMENT = 1e-7


def well(x, p):
    return jnp.stack([x[0] + 0.3 * (p["a"] * x[0] - x[0] ** 3) + 0.1 * x[1], 0.5 * x[1]])


SYSTEM = dynamics.System(well, BOX, {"a": 1.0})


def with_scipy(a: float) -> tuple[float, float]:
    """Compute the mean time and the share from the matrix of all cells."""
    x, y = np.moveaxis(sampled(BOX, np.arange(BOX.size, dtype=np.int32)), 2, 0)
    faces = np.linspace(-2, 2, CELLS + 1)
    faces[[0, -1]] = -np.inf, np.inf
    images = x + 0.3 * (a * x - x**3) + 0.1 * y, 0.5 * y
    along = [np.diff(ndtr((faces - image[..., None]) / NOISE)) for image in images]
    matrix = np.einsum("cpi,cpj->cij", *along, optimize=True).reshape(BOX.size, BOX.size)
    matrix /= x.shape[1]
    half, middle = BOX.size // 2, CELLS // 2
    system = np.eye(half) - matrix[:half, :half]
    stay = np.linalg.solve(system, np.ones(half)).reshape(middle, CELLS)
    # The start is in the middle of four cells.
    start = slice(CELLS // 4 - 1, CELLS // 4 + 1), slice(middle - 1, middle + 1)
    # Without one equation, the limiting distribution has the sum 1.
    balance = np.eye(BOX.size) - matrix.T
    balance[-1], right = 1, np.eye(BOX.size)[-1]
    factors = scipy.linalg.lu_factor(balance)
    limit = scipy.linalg.lu_solve(factors, right)
    limit += scipy.linalg.lu_solve(factors, right - balance @ limit)
    return float(stay[start].mean()), float(limit[half:].sum())


def exits(repeats: int) -> list[Row]:
    exits = Family.of(SYSTEM, "a", out_of=None, **ABOUT)
    # The peer has no chains of wider cells.
    narrow = dataclasses.replace(exits, coarser=())
    whole = Family.of(SYSTEM, "a", out_of=None, **ABOUT, back=True)
    middle = (FIRST + LAST) / 2

    def solve(value: float) -> tuple[int, float]:
        count, began = len(exits.nodes), time.process_time()
        exits.at(value), whole.shares(value)
        return len(exits.nodes) - count, time.process_time() - began

    solve(middle)
    chains, took = solve(FIRST)
    values = np.linspace(middle, middle + exits.width / 2, FEW, endpoint=False).tolist()
    used: list[float] = []

    def together() -> tuple[float, float]:
        began = time.process_time()
        found = [(exits.at(value), whole.shares(value)) for value in values]
        used.append((time.process_time() - began) / FEW)
        box = narrow.at(values[0])
        assert box is not None
        return box["mean_time"], float(found[0][1][0])

    def check(results: dict[str, Any]) -> None:
        np.testing.assert_allclose(*results.values(), rtol=AGREEMENT)

    programs = {"jaxcell, exit_times": together, "scipy": lambda: with_scipy(middle)}
    timings = take_turns(programs, repeats, check)
    parts = zip(timings.items(), (FEW, 1), strict=True)
    each = {name: Timing(*(one / count for one in timing)) for (name, timing), count in parts}
    table(f"Mean exit time, derivative and share of time per member, {CELLS**2:,} cells", each)
    needed = round((LAST - FIRST) / exits.width) + 8
    total = needed * took / chains + MEMBERS * min(used)
    print(
        f"\nprocessor time: {took / chains:.2f} s for both chains of a depth, {min(used):.3f} s "
        f"for a member; {MEMBERS:,} members with chains of {needed} depths: {total:.0f} s"
    )
    what = "mean exit time, derivative and share of time per member"
    return rows_of("exits", what, f"{CELLS**2:,} cells", each)


def whole() -> None:
    wall, processor = time.perf_counter(), time.process_time()
    values = np.linspace(FIRST, LAST, MEMBERS)
    found = dynamics.exit_times(SYSTEM, "a", values, **ABOUT, shares=True)
    slope = np.gradient(np.log(found.mean_time), values, edge_order=2)
    difference = np.abs(slope * found.mean_time / found.derivative - 1)[1:-1].max()
    print(
        f"\n{MEMBERS:,} members: {time.perf_counter() - wall:.0f} s, processor time "
        f"{time.process_time() - processor:.0f} s; {found.solved} chains solved, "
        f"{found.alone.sum()} members alone, residuals up to {found.residual.max():.1e}, slopes "
        f"within {difference:.1e} of differences"
    )


def main() -> None:
    arguments = options(__doc__, repeats=2, full="1,000 members: 2 min").parse_args()
    begin("jax", "numpy", "scipy")
    rows = exits(arguments.repeats)
    if arguments.full:
        whole()
    write_rows(arguments.rows, rows)


if __name__ == "__main__":
    main()
