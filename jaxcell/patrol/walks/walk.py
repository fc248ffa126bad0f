from typing import Any

import numpy as np
from jaxtyping import Float

from ...base.connected import check_connected
from ...mapping import Chain
from ...markov import dense
from ...optimize import Graph
from ...optimize.checked import one_each


def random_walk(graph: Graph, weights: Any) -> Chain:
    """Make the chain of a patroller that takes edges with probabilities in proportion to weights.

    The probabilities are `p_ij = w_ij / sum_j w_ij` (Alam 2018, section 4.3.1), without waiting.

    **Arguments:**

    - `graph`: the graph.
    - `weights`: array `[edges]`, the weight of each edge, at least 0.

    **Returns:** [`jaxcell.mapping.Chain`][] whose cells are the vertices.

    On a line of three vertices, the second edge has three times the weight of the first:

        >>> from jaxcell import patrol
        >>> graph = patrol.Graph([[0, 1], [1, 2]])
        >>> patrol.random_walk(graph, [1, 3]).to_scipy().toarray().tolist()
        [[0.0, 1.0, 0.0], [0.25, 0.0, 0.75], [0.0, 1.0, 0.0]]
    """
    weights = _checked(graph, weights)
    matrix = graph.matrix(weights)
    total = np.asarray(matrix.sum(axis=1))
    matrix.data /= np.repeat(total, np.diff(matrix.indptr))
    return Chain.from_scipy(matrix)


def walk_hitting_times(graph: Graph, weights: Any) -> Float[np.ndarray, "starts targets"]:
    """Compute the expected number of steps of the walk from each vertex to each other vertex.

    With `X` the pseudo-inverse of the Laplacian and `d` the total weights of the vertices, `h_ij =
    sum_k d_k (X_ik - X_ij - X_jk + X_jj)`.

    **Arguments:**

    - `graph`: the graph.
    - `weights`: array `[edges]`, the weight of each edge, at least 0.

    **Returns:** array `[vertices, vertices]`: rows are starts, the diagonal is 0. Adding the
    transpose gives the commute times.

    A random walk on a line of three vertices:

        >>> from jaxcell import patrol
        >>> graph = patrol.Graph([[0, 1], [1, 2]])
        >>> patrol.walks.walk_hitting_times(graph, [1, 1]).round(6).tolist()
        [[0.0, 1.0, 4.0], [3.0, 0.0, 3.0], [4.0, 1.0, 0.0]]
    """
    weights = _checked(graph, weights)
    matrix = graph.matrix(weights)
    total = np.asarray(matrix.sum(axis=1))
    check_connected(
        graph.vertices,
        graph.edges[weights > 0],
        "weights: expected positive weights that connect all vertices, but",
    )
    shift = total.mean() / graph.vertices
    inverse = np.linalg.inv(np.diag(total) - matrix.toarray() + shift)
    # The shift adds the same number to all entries of the inverse, which cancels below.
    own = np.diag(inverse)
    mean = inverse @ total
    times = mean[:, None] - mean[None, :] + total.sum() * (own[None, :] - inverse)
    np.fill_diagonal(times, 0)
    return times


def edge_shares(graph: Graph, chain: Chain) -> Float[np.ndarray, "edges"]:
    """Compute the share of steps of a chain along each edge, in both directions, in the long run.

    **Arguments:**

    - `graph`: the graph.
    - `chain`: a chain that moves along edges of the graph.

    **Returns:** array `[edges]`; it sums to 1 for a chain that never stays.

    A walk that alternates between two vertices at one end of a line of three:

        >>> from jaxcell import patrol
        >>> graph = patrol.Graph([[0, 1], [1, 2]])
        >>> patrol.walks.edge_shares(graph, patrol.toward(graph, 0)).round(6).tolist()
        [1.0, 0.0]
    """
    matrix = chain.to_scipy().toarray()
    flow = np.asarray(dense.stationary(matrix))[:, None] * matrix
    tail, head = graph.edges.T
    return np.maximum(0.0, flow[tail, head] + flow[head, tail])


def _checked(graph: Graph, weights: Any) -> Float[np.ndarray, "edges"]:
    given = one_each("weights", weights, len(graph.edges), "per edge", zero=True)
    total = np.bincount(graph.edges.ravel(), np.repeat(given, 2), graph.vertices)
    if not total.all():
        raise ValueError(
            f"weights: vertex {np.flatnonzero(total == 0)[0]} has only weights of 0; expected more"
        )
    return given
