"""Persistent groups, limiting distributions and coverage policies, side by side with peers.

    python experiments/benchmarks/bench_coverage.py

prints Markdown tables; README.md in this folder says what is timed, and the rules. QuantEcon is
compared where it is installed (`pip install quantecon`).
"""

import argparse
import importlib.util
import math
import os
import resource
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path

import jax
import numpy as np
import scipy
import scipy.sparse
from scipy.sparse import csgraph, linalg

from jaxcell.bounce.coverage import coverage_policy, noisy_bounce_map
from jaxcell.mapping.classes import persistent_groups
from jaxcell.mapping.generalized import Chain
from jaxcell.markov import limiting_distribution
from jaxcell.space import CellSpace, Workspace


jax.config.update("jax_enable_x64", True)

MAP = Path(__file__).parents[2] / "data" / "maps" / "complex.json"
BOUNCES_DEG = (30, 75, 315)
ERROR_DEG = 5
RELIABILITY = 0.8
# As far as power iteration goes, and how far from each other two answers may be.
RESIDUAL = 1e-10
AGREEMENT = 1e-6


def room(directions: int = 360, cell: float = 1.0) -> CellSpace:
    return CellSpace.of(Workspace.load(MAP), cell, directions)


def noisy(cells: CellSpace, bounce_deg: float) -> Chain:
    return noisy_bounce_map(cells, math.radians(bounce_deg), math.radians(ERROR_DEG), RELIABILITY)


# The peers get the matrix, but for one; ours gets the chain, and makes the matrix in its time.


def matrix_of(chain: Chain) -> scipy.sparse.csr_array:
    """The matrix as scipy makes it from the arrays of a chain."""
    image, probability = np.asarray(chain.image), np.asarray(chain.probability)
    used = probability > 0
    _, cell = np.nonzero(used)
    shape = (image.shape[1], image.shape[1])
    return scipy.sparse.csr_array((probability[used], (cell, image[used])), shape=shape)


def scipy_groups(matrix: scipy.sparse.csr_array) -> np.ndarray:
    """The group of each cell: strong components, and a sink test over all edges at once."""
    count, label = csgraph.connected_components(matrix, connection="strong")
    source = np.repeat(label, np.diff(matrix.indptr))
    leaves = np.zeros(count, bool)
    leaves[source[source != label[matrix.indices]]] = True
    return in_order(np.where(leaves[label], -1, label))


def plain_groups(matrix: scipy.sparse.csr_array) -> np.ndarray:
    """The same with the sink test edge by edge, as Alg. 3.3 is written."""
    count, label = csgraph.connected_components(matrix, connection="strong")
    closed = [True] * count
    labels, images, start = label.tolist(), matrix.indices.tolist(), matrix.indptr.tolist()
    for cell, component in enumerate(labels):
        for edge in range(start[cell], start[cell + 1]):
            if labels[images[edge]] != component:
                closed[component] = False
    return in_order(np.where(np.array(closed)[label], label, -1))


def quantecon_groups(matrix: scipy.sparse.csr_array) -> np.ndarray:
    from quantecon import MarkovChain

    group = np.full(matrix.shape[0], -1)
    for number, cells in enumerate(MarkovChain(matrix).recurrent_classes_indices):
        group[cells] = number
    return in_order(group)


def in_order(group: np.ndarray) -> np.ndarray:
    """Numbers groups in the order of their smallest cells."""
    numbers, first = np.unique(group, return_index=True)
    first = first[numbers >= 0]
    renamed = np.full(group.size, -1)
    for number, cell in enumerate(np.sort(first)):
        renamed[group == group[cell]] = number
    return renamed


def classes_of(matrix: scipy.sparse.csr_array, group: np.ndarray) -> list[tuple]:
    members = [np.flatnonzero(group == number) for number in range(group.max() + 1)]
    return [(cells, matrix[cells][:, cells]) for cells in members]


def eigs_limiting(matrix: scipy.sparse.csr_array, group: np.ndarray) -> np.ndarray:
    """The eigenvector of each group to the eigenvalue 1, by ARPACK."""
    value = np.zeros(group.size)
    for cells, part in classes_of(matrix, group):
        # With fewer than some it may miss the right one: others are near the unit circle too.
        values, vectors = linalg.eigs(
            part.T.tocsr(), k=6, which="LR", tol=1e-13, v0=np.ones(cells.size)
        )
        vector = vectors[:, np.argmin(np.abs(values - 1))]
        # It comes with any complex phase, which its sum takes off.
        value[cells] = (vector / vector.sum()).real
    return value / (group.max() + 1)


def power_limiting(matrix: scipy.sparse.csr_array, group: np.ndarray) -> np.ndarray:
    """Power iteration on each group, resting every second time so that periods do not matter."""
    value = np.zeros(group.size)
    for cells, part in classes_of(matrix, group):
        forward = part.T.tocsr()
        x = np.full(cells.size, 1 / cells.size)
        while np.abs(change := forward @ x - x).sum() > RESIDUAL:
            x = x + change / 2
        value[cells] = x
    return value / (group.max() + 1)


def whole_power_limiting(matrix: scipy.sparse.csr_array) -> np.ndarray:
    """Power iteration from a uniform start over all cells, which weighs the groups by itself."""
    forward = matrix.T.tocsr()
    x = np.full(matrix.shape[0], 1 / matrix.shape[0])
    while np.abs(change := forward @ x - x).sum() > RESIDUAL:
        x = x + change / 2
    return x


def quantecon_limiting(matrix: scipy.sparse.csr_array) -> np.ndarray:
    from quantecon import MarkovChain

    return np.asarray(MarkovChain(matrix).stationary_distributions).mean(axis=0)


# The rules: warm up, check, then take turns.


def take_turns(
    programs: dict[str, Callable[[], np.ndarray]], repeats: int, tolerance: float
) -> dict[str, float]:
    """The median seconds of each program; all must give what the first gives."""
    results = {name: np.asarray(program()) for name, program in programs.items()}
    ours, expected = next(iter(results.items()))
    for name, found in results.items():
        if not np.abs(found - expected).sum() <= tolerance:
            sys.exit(f"{name} and {ours} disagree by {np.abs(found - expected).sum():g}")
    taken: dict[str, list[float]] = {name: [] for name in programs}
    for _ in range(repeats):
        for name, program in programs.items():
            began = time.perf_counter()
            program()
            taken[name].append(time.perf_counter() - began)
    return {name: statistics.median(times) for name, times in taken.items()}


def show(title: str, timings: dict[str, float]) -> None:
    ours = next(iter(timings.values()))
    print(f"\n### {title}\n\n| | median, ms | times ours |\n|---|--:|--:|")
    for name, seconds in timings.items():
        print(f"| {name} | {1e3 * seconds:,.1f} | {seconds / ours:,.1f} x |")


def with_quantecon() -> bool:
    return importlib.util.find_spec("quantecon") is not None


def one_angle(bounce_deg: float, repeats: int) -> None:
    cells = room()
    chain = jax.block_until_ready(noisy(cells, bounce_deg))
    matrix = chain.to_scipy()
    found = persistent_groups(chain)
    group = np.asarray(found.group)
    title = f"{bounce_deg} deg, {cells.size:,} cells, {int(found.size.sum()):,} persistent"
    programs = {
        "jaxcell, persistent_groups": lambda: np.asarray(persistent_groups(chain).group),
        "scipy strong components, sink test in NumPy": lambda: scipy_groups(matrix),
        "the same, with the matrix made by scipy": lambda: scipy_groups(matrix_of(chain)),
        "scipy strong components, sink test edge by edge": lambda: plain_groups(matrix),
    }
    if with_quantecon():
        programs["QuantEcon, recurrent_classes"] = lambda: quantecon_groups(matrix)
    show(f"Persistent groups, {title}", take_turns(programs, repeats, 0))

    programs = {
        "jaxcell, limiting_distribution": lambda: np.asarray(
            limiting_distribution(chain, found).value
        ),
        "scipy eigs, given the groups": lambda: eigs_limiting(matrix, group),
        f"power iteration to {RESIDUAL:g}, given the groups": lambda: power_limiting(matrix, group),
        f"power iteration to {RESIDUAL:g}, all cells": lambda: whole_power_limiting(matrix),
    }
    show(f"Limiting distribution, {title}", take_turns(programs, repeats, AGREEMENT))


def quantecon_size(repeats: int) -> None:
    """QuantEcon makes its matrices dense, so it gets a fifth of the directions."""
    cells = room(directions=72)
    chain = jax.block_until_ready(noisy(cells, 75))
    matrix = chain.to_scipy()
    found = persistent_groups(chain)

    def ours() -> np.ndarray:
        return np.asarray(limiting_distribution(chain, persistent_groups(chain)).value)

    programs: dict[str, Callable[[], np.ndarray]] = {"jaxcell, groups and distribution": ours}
    programs["QuantEcon, stationary_distributions"] = lambda: quantecon_limiting(matrix)
    title = f"75 deg, {cells.size:,} cells, {int(found.size.sum()):,} persistent"
    show(f"Groups and distribution, {title}", take_turns(programs, repeats, AGREEMENT))


def whole_job(repeats: int) -> None:
    angles, error = np.radians(BOUNCES_DEG), math.radians(ERROR_DEG)
    print("\n### The whole of Alg. 3.3, three angles\n")
    print("| cells | first call, s | median, s | largest residual | peak memory so far, GB |")
    print("|--:|--:|--:|--:|--:|")
    for cell in (1.0, 0.5, 0.25):
        cells = room(cell=cell)
        taken = []
        for _ in range(repeats + 1):
            began = time.perf_counter()
            found = coverage_policy(cells, angles, error, RELIABILITY)
            taken.append(time.perf_counter() - began)
        residual = max(one.certificate.residual for one in found.limiting)
        unit = 1 if sys.platform == "darwin" else 1024
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e9
        print(
            f"| {cells.size:,} | {taken[0]:.2f} | {statistics.median(taken[1:]):.3f} | "
            f"{residual:.1e} | {peak:.2f} |"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=5, help="timed turns of each program")
    repeats = parser.parse_args().repeats
    versions = f"jax {jax.__version__}, scipy {scipy.__version__}, numpy {np.__version__}"
    print(f"{versions}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}")
    # First of all, since peak memory never falls.
    whole_job(repeats)
    for bounce_deg in BOUNCES_DEG:
        one_angle(bounce_deg, repeats)
    if with_quantecon():
        quantecon_size(min(repeats, 3))
    else:
        print("\nQuantEcon is not installed, and was left out.")


if __name__ == "__main__":
    main()
