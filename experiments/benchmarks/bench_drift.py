"""Persistent groups and absorption times of a drift map, side by side with peers.

    python experiments/benchmarks/bench_drift.py

prints a Markdown table; README.md in this folder says what is timed, and the rules. deeptime is
compared where it is installed (`pip install deeptime`).

The current is made of gyres whose water goes slowly to their middles. Peers get the matrix of the
map, and all give the expected number of steps until a drifter is in a persistent group: scipy by
strong components and `spsolve`, deeptime by the mean first passage time to the persistent cells,
which it is told.
"""

import argparse
import importlib.util
import os
import resource
import statistics
import sys
import time
from collections.abc import Callable

import jax
import numpy as np
import scipy
import scipy.sparse
import xarray as xr
from scipy.sparse import csgraph, linalg

from jaxcell.drift.behaviour import long_term_behaviour
from jaxcell.drift.drift_map import drift_map
from jaxcell.drift.flow import Flow, crossing_time
from jaxcell.drift.water import Water
from jaxcell.mapping import Chain
from jaxcell.runtime import configure_jax


# How far from each other two answers may be, as a part of the time.
AGREEMENT = 1e-6
INWARD = 1.0


def gyres(side: int, count: int = 4) -> xr.Dataset:
    """Currents on `side` x `side` cells of 1 km."""
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
    """The drift map, and what one of its steps takes."""
    water, flow = Water.of(currents), Flow.of(currents)
    duration = 2 * crossing_time(water, flow)
    return drift_map(water, flow, duration, spread=spread, samples=3, edge="exit"), duration


def scipy_groups(matrix: scipy.sparse.csr_array) -> np.ndarray:
    """Which cells are persistent: strong components, and a sink test over all edges at once."""
    count, label = csgraph.connected_components(matrix, connection="strong")
    source = np.repeat(label, np.diff(matrix.indptr))
    leaves = np.zeros(count, bool)
    leaves[source[source != label[matrix.indices]]] = True
    return ~leaves[label]


def scipy_times(matrix: scipy.sparse.csr_array) -> np.ndarray:
    transient = np.flatnonzero(~scipy_groups(matrix))
    inner = matrix[transient][:, transient]
    identity = scipy.sparse.eye_array(transient.size)
    steps = np.zeros(matrix.shape[0])
    steps[transient] = linalg.spsolve((identity - inner).tocsc(), np.ones(transient.size))
    return steps


def deeptime_times(matrix: scipy.sparse.csr_array, persistent: np.ndarray) -> np.ndarray:
    from deeptime.markov.tools.analysis import mfpt

    # It needs scipy's older matrices, and closed classes make it singular but for the target.
    return np.asarray(mfpt(scipy.sparse.csr_matrix(matrix), np.flatnonzero(persistent).tolist()))


def timed(program: Callable[[], np.ndarray], repeats: int) -> tuple[list[float], np.ndarray]:
    taken = []
    for _ in range(repeats):
        began = time.perf_counter()
        found = program()
        taken.append(time.perf_counter() - began)
    return taken, found


def peak() -> float:
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e9


def row(cells: int, spread: str, program: str, seconds: list[float], ratio: float) -> None:
    print(
        f"| {cells:,} | {spread} | {program} | {min(seconds):.3f} | "
        f"{statistics.median(seconds):.3f} | {ratio:.2f} | {peak():.2f} |",
        flush=True,
    )


def side_by_side(side: int, spread: str, repeats: int) -> None:
    currents = gyres(side)
    chain, duration = ours(currents, spread)
    mapping, _ = timed(lambda: np.asarray(ours(currents, spread)[0].image), repeats)
    taken, times = timed(
        lambda: np.asarray(long_term_behaviour(chain, duration, throw=True).absorption.value),
        repeats,
    )
    cells = chain.cells
    row(cells, spread, "jaxcell, the map", mapping, min(mapping) / min(taken))
    row(cells, spread, "jaxcell, groups, domiciles and times", taken, 1.0)
    matrix = chain.to_scipy()
    peers: dict[str, Callable[[], np.ndarray]] = {
        "scipy, groups and times": lambda: scipy_times(matrix)
    }
    if cells <= 10_000 and importlib.util.find_spec("deeptime") is not None:
        persistent = scipy_groups(matrix)
        peers["deeptime, times only"] = lambda: deeptime_times(matrix, persistent)
    for name, program in peers.items():
        seconds, found = timed(program, repeats if cells <= 10_000 else 1)
        off = np.abs(found - times).max() / times.max()
        if not (times.any() and off <= AGREEMENT):
            sys.exit(f"{name} and jaxcell disagree by {off:g}")
        row(cells, spread, name, seconds, min(seconds) / min(taken))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=5, help="timed runs")
    parser.add_argument("--side", type=int, default=1000, help="cells along the largest square")
    arguments = parser.parse_args()
    configure_jax()
    print(
        f"jax {jax.__version__}, scipy {scipy.__version__}, numpy {np.__version__}, "
        f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}\n"
    )
    if importlib.util.find_spec("deeptime") is None:
        print("deeptime is not installed, and was left out.\n")
    print("| cells | spread | program | min, s | median, s | to ours | peak so far, GB |")
    print("|--:|---|---|--:|--:|--:|--:|")
    for side in (100, arguments.side):
        for spread in ("turned", "sampled"):
            side_by_side(side, spread, arguments.repeats if side == 100 else 2)


if __name__ == "__main__":
    main()
