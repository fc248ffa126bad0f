from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ...base.wide import traced
from ...mapping import Chain, ChainLike
from ...mapping.generalized import slots_of
from ...markov import dense
from ...optimize import GraphLike
from ...optimize.validation import one_each


def random_walk(graph: GraphLike, weights: Any = None) -> Chain:
    """Build the chain of a patroller that takes edges with probabilities proportional to weights.

    The probabilities are `p_ij = w_ij / sum_j w_ij` (Alam 2018, section 4.3.1), without waiting.

    **Arguments:** the graph, and the weight of each edge, at least 0, by default 1; `jit`, `vmap`
    and `grad` may trace the weights. **Returns:** [`jaxcell.mapping.Chain`][] whose cells are the
    vertices.

    On a line of three vertices, the second edge has three times the weight of the first:

        >>> from jaxcell import patrol
        >>> graph = patrol.Graph([[0, 1], [1, 2]])
        >>> patrol.random_walk(graph, [1, 3]).to_scipy().toarray().tolist()
        [[0.0, 1.0, 0.0], [0.25, 0.0, 0.75], [0.0, 1.0, 0.0]]
    """
    if weights is None:
        weights = np.ones(len(graph.edges))
    if traced(weights):
        image, edge = slots_of(graph.matrix(1.0 + np.arange(len(graph.edges))))
        near = jnp.where(edge > 0, jnp.pad(weights, (1, 0))[edge.astype(int)], 0.0)
        return Chain(image, near / jnp.sum(near, axis=0, keepdims=True))
    weights = one_each("weights", weights, len(graph.edges), "per edge", zero=True)
    matrix = graph.matrix(weights)
    total = np.asarray(matrix.sum(axis=1))
    if not total.all():
        vertex = np.flatnonzero(total == 0)[0]
        raise ValueError(f"weights: vertex {vertex} has only weights of 0; expected more")
    matrix.data /= np.repeat(total, np.diff(matrix.indptr))
    return Chain.from_scipy(matrix)


def edge_shares(graph: GraphLike, chain: ChainLike) -> Float[np.ndarray, "edges"]:
    """Compute the share of steps of a chain along each edge, in both directions, in the long run.

    **Arguments:** the graph, and a chain that moves along its edges. **Returns:** array `[edges]`;
    it sums to 1 for a chain that never stays.

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
