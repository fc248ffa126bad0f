"""Time persistent groups, limiting distributions and coverage policies beside other libraries.

    python experiments/benchmarks/bench_coverage.py

The script prints Markdown tables. README.md in this folder explains the measurements.
"""

import math
import sys
from collections.abc import Callable
from typing import Any

import jax
import numpy as np
import scipy.sparse
from quantecon import MarkovChain
from rows import Row, options, rows_of, write_rows
from scipy.sparse import csgraph, linalg
from timing import begin, header, line, peak_bytes, table, take_turns

from experiments.chapter_3.coverage_policies import BOUNCES_DEG, ERROR_DEG, MAP, RELIABILITY
from jaxcell.bounce import coverage_policy, noisy_bounce_map
from jaxcell.mapping.classes import persistent_groups
from jaxcell.mapping.generalized import Chain
from jaxcell.markov import limiting_distribution
from jaxcell.space import CellSpace, Workspace


SIDE_BY_SIDE_DEG = (30, 315)
# The residual of power iteration, and the largest difference of two results, both 1-norms.
RESIDUAL = 1e-10
AGREEMENT = 1e-6
# The seconds for the turns of one program.
PATIENCE_S = 3


def room(directions: int = 360, cell: float = 1.0) -> CellSpace:
    return CellSpace.of(Workspace.load(MAP), cell, directions)


def noisy(cells: CellSpace, bounce_deg: float) -> Chain:
    return noisy_bounce_map(cells, math.radians(bounce_deg), math.radians(ERROR_DEG), RELIABILITY)


# Our programs start from the chain, and the others from the matrix.


def persistent_components(matrix: scipy.sparse.csr_array) -> np.ndarray:
    """Label the strong component of each cell; -1 if edges leave the component."""
    count, label = csgraph.connected_components(matrix, connection="strong")
    source = np.repeat(label, np.diff(matrix.indptr))
    leaves = np.zeros(count, bool)
    leaves[source[source != label[matrix.indices]]] = True
    return np.where(leaves[label], -1, label)


def scipy_groups(matrix: scipy.sparse.csr_array) -> np.ndarray:
    return in_order(persistent_components(matrix))


def quantecon_groups(matrix: scipy.sparse.csr_array) -> np.ndarray:
    group = np.full(matrix.shape[0], -1)
    for number, cells in enumerate(MarkovChain(matrix).recurrent_classes_indices):
        group[cells] = number
    return in_order(group)


def in_order(group: np.ndarray) -> np.ndarray:
    """Number groups in the order of their smallest cells."""
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
    """Compute the eigenvector of each group for the eigenvalue 1, by ARPACK."""
    value = np.zeros(group.size)
    for cells, part in classes_of(matrix, group):
        # Six eigenvalues, because several are near the unit circle, and fewer may miss 1.
        values, vectors = linalg.eigs(
            part.T.tocsr(), k=6, which="LR", tol=1e-13, v0=np.ones(cells.size)
        )
        vector = vectors[:, np.argmin(np.abs(values - 1))]
        # Division by the sum removes its complex phase.
        value[cells] = (vector / vector.sum()).real
    return value / (group.max() + 1)


def power_limiting(matrix: scipy.sparse.csr_array, group: np.ndarray) -> np.ndarray:
    """Iterate the average of the identity and the matrix of each group, which has no period."""
    value = np.zeros(group.size)
    for cells, part in classes_of(matrix, group):
        forward = part.T.tocsr()
        x = np.full(cells.size, 1 / cells.size)
        while np.abs(change := forward @ x - x).sum() > RESIDUAL:
            x = x + change / 2
        value[cells] = x
    return value / (group.max() + 1)


def quantecon_limiting(matrix: scipy.sparse.csr_array) -> np.ndarray:
    return np.asarray(MarkovChain(matrix).stationary_distributions).mean(axis=0)


def agreeing(tolerance: float) -> Callable[[dict[str, np.ndarray]], None]:
    """Make a check that all programs agree with the first."""

    def check(results: dict[str, np.ndarray]) -> None:
        ours, expected = next(iter(results.items()))
        for name, found in results.items():
            if not np.abs(found - expected).sum() <= tolerance:
                sys.exit(f"{name} and {ours} disagree by {np.abs(found - expected).sum():g}")

    return check


def one_angle(bounce_deg: float, repeats: int) -> list[Row]:
    """Time the groups and the limiting distribution of one bouncing angle."""
    cells = room()
    chain = jax.block_until_ready(noisy(cells, bounce_deg))
    matrix = chain.to_scipy()
    groups = persistent_groups(chain)
    group = np.asarray(groups.group)
    title = f"{bounce_deg} deg, {cells.size:,} cells, {int(groups.size.sum()):,} persistent"
    programs: dict[str, Callable[[], np.ndarray]] = {
        "jaxcell, persistent_groups": lambda: np.asarray(persistent_groups(chain).group),
        "scipy strong components, sink test in NumPy": lambda: scipy_groups(matrix),
        "QuantEcon, recurrent_classes": lambda: quantecon_groups(matrix),
    }
    timings = take_turns(programs, repeats, agreeing(0), PATIENCE_S)
    table(f"Persistent groups, {title}", timings)
    size, noise = f"{cells.size:,} cells", f"imprecise policy, {bounce_deg} deg"
    rows = rows_of("coverage", f"persistent groups, {noise}", size, timings)

    programs = {
        "jaxcell, limiting_distribution": lambda: np.asarray(
            limiting_distribution(chain, groups).value
        ),
        "scipy eigs, given the groups": lambda: eigs_limiting(matrix, group),
        f"power iteration to {RESIDUAL:g}, given the groups": lambda: power_limiting(matrix, group),
    }
    timings = take_turns(programs, repeats, agreeing(AGREEMENT), PATIENCE_S)
    table(f"Limiting distribution, {title}", timings)
    return rows + rows_of("coverage", f"limiting distribution, {noise}", size, timings)


def quantecon_size(repeats: int) -> list[Row]:
    """Time QuantEcon on a fifth of the directions, because it makes dense matrices."""
    cells = room(directions=72)
    chain = jax.block_until_ready(noisy(cells, 75))
    matrix = chain.to_scipy()
    groups = persistent_groups(chain)

    def ours() -> np.ndarray:
        return np.asarray(limiting_distribution(chain, persistent_groups(chain)).value)

    programs: dict[str, Callable[[], np.ndarray]] = {
        "jaxcell, groups and distribution": ours,
        "QuantEcon, stationary_distributions": lambda: quantecon_limiting(matrix),
    }
    timings = take_turns(programs, repeats, agreeing(AGREEMENT), PATIENCE_S)
    title = f"75 deg, {cells.size:,} cells, {int(groups.size.sum()):,} persistent"
    table(f"Groups and distribution, {title}", timings)
    what = "groups and limiting distribution, imprecise policy, 75 deg"
    return rows_of("coverage", what, f"{cells.size:,} cells", timings)


def whole_job(repeats: int) -> list[Row]:
    """Time Alg. 3.3 as a whole, for three sizes of cells."""
    angles, error = np.radians(BOUNCES_DEG), math.radians(ERROR_DEG)
    print("\n### The whole of Alg. 3.3, three angles\n")
    names = ("first call, s", "median, s", "largest residual", "peak memory so far, GB")
    header("cells", *names, words=0)
    rows = []
    for cell in (1.0, 0.5, 0.25):
        cells = room(cell=cell)
        found: dict[str, Any] = {}

        def ours(cells: CellSpace = cells) -> Any:
            return coverage_policy(cells, angles, error, RELIABILITY)

        first, _, median = take_turns({"ours": ours}, repeats, found.update, PATIENCE_S)["ours"]
        residual = max(one.certificate.residual for one in found["ours"].limiting)
        peak = f"{peak_bytes() / 1e9:.2f}"
        line(f"{cells.size:,}", f"{first:.2f}", f"{median:.3f}", f"{residual:.1e}", peak)
        what = f"mixture of {len(angles)} imprecise policies, Alg. 3.3"
        rows.append(Row("coverage", what, f"{cells.size:,} cells", median))
    return rows


def main() -> None:
    arguments = options(__doc__, repeats=3, full="one more angle").parse_args()
    begin("jax", "scipy", "numpy", "quantecon")
    # This part is first because it measures peak memory, which never falls.
    rows = whole_job(arguments.repeats)
    for bounce_deg in BOUNCES_DEG if arguments.full else SIDE_BY_SIDE_DEG:
        rows += one_angle(bounce_deg, arguments.repeats)
    rows += quantecon_size(arguments.repeats)
    write_rows(arguments.rows, rows)


if __name__ == "__main__":
    main()
