from typing import Any

from jaxtyping import Array, Float

from ....markov import dense
from ....optimize import GraphLike
from .descent import OptimizedWalk, minimize
from .polytope import ChainPolytope


def minimum_kemeny(
    graph: GraphLike,
    stationary: Any = None,
    *,
    stay: bool = False,
    starts: int = 8,
    seed: int = 0,
    tolerance: float = 1e-5,
    throw: bool = True,
) -> OptimizedWalk:
    """Find a chain with a small Kemeny constant: the mean number of steps to a random vertex.

    It runs on the host, because it compares local optima from several starts.

    The problem is not convex (Patel, Agharkar and Bullo 2015): the result is a local optimum, the
    best of several starts.

    Without a stationary distribution the least constant is `(2 n - k - 1) / 2`, with `k` the length
    of the longest cycle (Kirkland 2010), and the best chains in the limit leave out the vertices
    that are not on this cycle. To guard all vertices, prescribe the distribution.

    **Arguments:**

    - `graph`: a connected graph.
    - `stationary`: array `[vertices]`, the share of the time to spend at each vertex, positive.
    - `stay`: whether the patroller may wait at a vertex, which only helps to meet `stationary`.
    - `starts`: number of starts. The first follows a short closed tour.
    - `seed`: seed of the other starts, which are random.
    - `tolerance`: tolerance of the residual.
    - `throw`: whether to raise `RuntimeError` if the residual exceeds the tolerance.

    **Returns:** [`OptimizedWalk`][jaxcell.patrol.walks.OptimizedWalk]. The residual of its
    certificate is the Frank-Wolfe gap relative to the value, or to 1 if 1 is larger: to first
    order, no chain is better by a larger share.

    A patroller that must move cannot be at one vertex for more than half of the time:

        >>> from jaxcell import patrol
        >>> graph = patrol.Graph([[0, 1], [1, 2], [2, 0]])
        >>> patrol.walks.minimum_kemeny(graph, [0.6, 0.2, 0.2])
        Traceback (most recent call last):
            ...
        ValueError: stationary: vertices 0 have 0.6 of the time, but those that follow have only ...
    """
    among = ChainPolytope.on(graph, stationary, stay=stay)
    search: Any = {"starts": starts, "seed": seed, "tolerance": tolerance, "throw": throw}
    return minimize("minimum_kemeny", _kemeny, among, (), **search)


def _kemeny(matrices: Float[Array, "1 vertices vertices"]) -> Float[Array, ""]:
    return dense.kemeny(matrices[0])
