import itertools

import numpy as np
import numpy.typing as npt
import scipy.sparse
from jaxtyping import Int
from scipy.sparse import csgraph

from ..mapping.generalized import ChainLike
from .hitting import cell_mask


def most_probable_path(
    chain: ChainLike, source: npt.ArrayLike | int, target: npt.ArrayLike | int
) -> tuple[Int[np.ndarray, "times"], float]:
    """Find the path between two sets of cells with the largest product of probabilities.

    It is a shortest path with the length `-log p` of each step (Dijkstra 1959). If noise is small,
    nearly all transitions follow it. It has no steps that stay in a cell. It runs on the host.

    **Arguments:** two sets, each as a cell, a list of cells, or a mask. **Returns:** the cells of
    the path, from the source to the target, and the logarithm of its probability.

    From cell 0 to cell 2, directly with probability 0.1 or by way of cell 1 with 0.9 * 0.5:

        >>> import numpy as np
        >>> from jaxcell import markov
        >>> P = np.array([[0.0, 0.9, 0.1], [0.5, 0.0, 0.5], [0.0, 0.0, 1.0]])
        >>> path, log_probability = markov.most_probable_path(P, source=0, target=2)
        >>> path.tolist(), round(float(np.exp(log_probability)), 6)
        ([0, 1, 2], 0.45)
    """
    begin = np.flatnonzero(cell_mask(chain.cells, source, "source"))
    goals = np.flatnonzero(cell_mask(chain.cells, target, "target"))
    matrix = chain.to_scipy()
    # For SciPy a length of 0 is no step.
    length = np.maximum(-np.log(matrix.data), np.finfo(float).tiny)
    graph = scipy.sparse.csr_array((length, matrix.indices, matrix.indptr), matrix.shape)
    away, before, _ = csgraph.dijkstra(
        graph, indices=begin, min_only=True, return_predecessors=True
    )
    path = [int(goals[np.argmin(away[goals])])]
    if not np.isfinite(away[path[0]]):
        raise ValueError("target: no path leads to it from there")
    while (cell := int(before[path[-1]])) >= 0:
        path.append(cell)
    cells = np.array(path[::-1])
    return cells, float(np.log([matrix[step] for step in itertools.pairwise(cells)]).sum())
