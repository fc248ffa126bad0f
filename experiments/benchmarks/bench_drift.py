"""Time persistent groups and absorption times of a drift map beside other libraries.

    python experiments/benchmarks/bench_drift.py

The script prints a Markdown table. README.md in this folder explains the measurements.

The current consists of gyres whose water slowly moves to their centres. The other programs start
from the matrix of the map. All compute the expected number of steps until a drifter is in a
persistent group: scipy by strong components and `spsolve`, deeptime by the mean first passage time
to persistent cells that it gets as input.
"""

import sys
from collections.abc import Callable

import numpy as np
import scipy.sparse
import xarray as xr
from bench_coverage import persistent_components
from rows import Row, options, rows_of, write_rows
from scipy.sparse import linalg
from timing import begin, header, line, peak_bytes, take_turns

from jaxcell.drift.drift_step import DriftStep
from jaxcell.drift.flow import Flow, crossing_time
from jaxcell.drift.long_term import long_term_behaviour
from jaxcell.drift.maps import drift_map
from jaxcell.drift.water import Water
from jaxcell.mapping import Chain


# The largest relative difference of two results.
AGREEMENT = 1e-6
INWARD = 1.0


def gyres(side: int, count: int = 4) -> xr.Dataset:
    """Make currents on `side` x `side` cells of 1 km."""
    x = (np.arange(side) + 0.5)[None] * count / side
    y = (np.arange(side) + 0.5)[:, None] * count / side
    sign = np.sign(np.sin(np.pi * x) * np.sin(np.pi * y))
    across, along = np.cos(np.pi * x) * np.sin(np.pi * y), np.sin(np.pi * x) * np.cos(np.pi * y)
    east, north = INWARD * sign * across - along, INWARD * sign * along + across
    axes = ("time", "layer", "y", "x")
    square = np.full((side, side), 1000.0)
    return xr.Dataset(
        {
            "u": (axes, east[None, None]),
            "v": (axes, north[None, None]),
            "water": (axes[1:], np.ones((1, side, side), bool)),
            "dx": (axes[2:], square),
            "dy": (axes[2:], square),
            "angle": (axes[2:], 0 * square),
        },
        {
            "time": np.array(["2011-07-01"], "datetime64[ns]"),
            "depth": ("layer", [0.0]),
            "lon": (axes[2:], np.zeros((side, side))),
            "lat": (axes[2:], np.zeros((side, side))),
        },
    )


def ours(currents: xr.Dataset, spread: str) -> tuple[Chain, float]:
    """Make the drift map, and return the seconds of a step."""
    water, flow = Water.of(currents), Flow.of(currents)
    duration = 2 * crossing_time(water, flow)
    step = DriftStep(duration, spread=spread, samples=3, edge="exit")
    return drift_map(water, flow, step), duration


def scipy_times(matrix: scipy.sparse.csr_array) -> np.ndarray:
    transient = np.flatnonzero(persistent_components(matrix) < 0)
    inner = matrix[transient][:, transient]
    identity = scipy.sparse.eye_array(transient.size)
    steps = np.zeros(matrix.shape[0])
    steps[transient] = linalg.spsolve((identity - inner).tocsc(), np.ones(transient.size))
    return steps


def deeptime_times(matrix: scipy.sparse.csr_array, persistent: np.ndarray) -> np.ndarray:
    from deeptime.markov.tools.analysis import mfpt

    # deeptime needs the older matrices of scipy, and is singular if the target is not all groups.
    return np.asarray(mfpt(scipy.sparse.csr_matrix(matrix), np.flatnonzero(persistent).tolist()))


def side_by_side(side: int, spread: str, repeats: int) -> list[Row]:
    """Time all programs on a square sea."""
    currents = gyres(side)
    chain, duration = ours(currents, spread)
    matrix, cells = chain.to_scipy(), chain.cells
    by_us = "jaxcell, groups, domiciles and times"
    programs: dict[str, Callable[[], np.ndarray]] = {
        by_us: lambda: np.asarray(
            long_term_behaviour(chain, duration, throw=True).absorption.value
        ),
        "scipy, groups and times": lambda: scipy_times(matrix),
    }
    if cells <= 10_000:
        persistent = persistent_components(matrix) >= 0
        programs["deeptime, times only"] = lambda: deeptime_times(matrix, persistent)

    def check(results: dict[str, np.ndarray]) -> None:
        times = results[by_us]
        for name, found in results.items():
            off = np.abs(found - times).max() / times.max()
            if not (times.any() and off <= AGREEMENT):
                sys.exit(f"{name} and jaxcell disagree by {off:g}")

    drift_maps = {"jaxcell, the map": lambda: np.asarray(ours(currents, spread)[0].image)}
    mapping = take_turns(drift_maps, repeats)
    timings = take_turns(programs, repeats, check, patience_s=5)
    base = timings[by_us].least
    for program, (_, least, median) in {**mapping, **timings}.items():
        times = (f"{least:.3f}", f"{median:.3f}", f"{least / base:.2f}")
        line(f"{cells:,}", spread, program, *times, f"{peak_bytes() / 1e9:.2f}")
    size = f"{cells:,} cells"
    rows = rows_of("drift", f"drift map, {spread} disturbances", size, mapping)
    return rows + rows_of("drift", f"domiciles and times, {spread} disturbances", size, timings)


def main() -> None:
    arguments = options(__doc__, repeats=5, full="a million cells").parse_args()
    begin("jax", "numpy", "scipy", "deeptime")
    names = ("program", "min, s", "median, s", "to ours", "peak so far, GB")
    header("cells", "spread", *names, words=3)
    rows = []
    for side in (100, 500, 1000) if arguments.full else (100, 500):
        for spread in ("turned", "sampled"):
            rows += side_by_side(side, spread, arguments.repeats if side == 100 else 2)
    write_rows(arguments.rows, rows)


if __name__ == "__main__":
    main()
