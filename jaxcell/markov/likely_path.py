import dataclasses

import numpy as np
import numpy.typing as npt
import scipy.sparse
from jaxtyping import Int
from scipy.sparse import csgraph

from ..base.shown import Shown
from ..mapping.generalized import ChainLike
from .hitting import cell_mask


@dataclasses.dataclass(frozen=True, eq=False)
class ProbablePath(Shown):
    """The path of a chain between two sets with the largest probability."""

    cell: Int[np.ndarray, "times"]
    "The cells of the path, from the source to the target."
    log_probability: float
    "The logarithm of the product of the probabilities of the steps."


def most_probable_path(
    chain: ChainLike, source: npt.ArrayLike | int, target: npt.ArrayLike | int
) -> ProbablePath:
    """Find the path between two sets of cells with the largest product of probabilities.

    It is a shortest path with the length `-log p` of each step (Dijkstra 1959). For small noise,
    nearly all transitions follow it. It contains no step that stays in a cell. It runs on the host.

    **Arguments:** a chain, and two sets, each as a cell, a list of cells, or a mask. **Returns:**
    the path, from one of the most probable cells of the source.

    **Raises:** `ValueError` if no path leads from the source to the target.

    From cell 0 to cell 2, directly with probability 0.1 or by way of cell 1 with 0.9 * 0.5:

        >>> import numpy as np
        >>> from jaxcell import markov
        >>> P = np.array([[0.0, 0.9, 0.1], [0.5, 0.0, 0.5], [0.0, 0.0, 1.0]])
        >>> path = markov.most_probable_path(P, source=0, target=2)
        >>> path.cell.tolist(), round(float(np.exp(path.log_probability)), 6)
        ([0, 1, 2], 0.45)
    """
    here = cell_mask(chain.cells, source, "source")
    there = cell_mask(chain.cells, target, "target")
    matrix = chain.to_scipy()
    # A length of 0 would be no step for SciPy; sums of the least positive number are exact.
    length = np.maximum(-np.log(matrix.data), np.finfo(float).tiny)
    graph = scipy.sparse.csr_array((length, matrix.indices, matrix.indptr), matrix.shape)
    begin = np.flatnonzero(here)
    away, before, _ = csgraph.dijkstra(
        graph, indices=begin, min_only=True, return_predecessors=True
    )
    goals = np.flatnonzero(there)
    cell = int(goals[np.argmin(away[goals])])
    if not np.isfinite(away[cell]):
        raise ValueError(
            f"target: no path leads to it from cell {begin[0]}"
            f"{' or another cell of the source' * (begin.size > 1)}"
        )
    path = [cell]
    while (cell := int(before[cell])) >= 0:
        path.append(cell)
    cells = np.array(path[::-1])
    steps = np.asarray(matrix[cells[:-1], cells[1:]])
    return ProbablePath(cells, float(np.log(steps).sum()))
