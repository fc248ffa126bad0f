from typing import Any

from jaxtyping import Array, Float

from ....markov import dense
from ....optimize import Graph
from .descent import OptimizedWalk, minimize
from .polytope import ChainPolytope


def minimum_kemeny(
    graph: Graph,
    stationary: Any = None,
    *,
    stay: bool = False,
    reversible: bool = False,
    starts: int = 8,
    seed: int = 0,
    tolerance: float = 1e-5,
    throw: bool = True,
) -> OptimizedWalk:
    """Find a chain with a small Kemeny constant: the mean number of steps to a random vertex.

    Among reversible chains with a given stationary distribution the problem is convex, and the
    result is the optimum (Patel, Agharkar and Bullo 2015). Chains that are not reversible can be
    faster; the problem is then not convex, and the result is the best local optimum found.

    Without a stationary distribution the least constant is `(2 n - k - 1) / 2`, with `k` the length
    of the longest cycle (Kirkland 2010). A chain that follows a Hamiltonian cycle has `(n - 1) /
    2`. In a graph without a Hamiltonian cycle, the best chains in the limit leave out the vertices
    that are not on the longest cycle. To guard all vertices, prescribe the distribution.

    **Arguments:**

    - `graph`: a connected graph.
    - `stationary`: array `[vertices]`, the share of the time to spend at each vertex, positive.
    - `stay`: whether the patroller may wait at a vertex, which only helps to meet `stationary`.
    - `reversible`: whether each edge must be taken equally often in both directions; needs
        `stationary`.
    - `starts`: number of starts. The first follows a short closed tour.
    - `seed`: seed of the other starts, which are random.
    - `tolerance`: tolerance of the residual.
    - `throw`: whether to raise `RuntimeError` if the residual exceeds the tolerance.

    **Returns:** [`OptimizedWalk`][jaxcell.patrol.walks.OptimizedWalk]. The residual of its
    certificate is the Frank-Wolfe gap relative to the value, or to 1 if 1 is larger: no reversible
    chain is better by a larger share; for other chains this holds to first order.

    **Raises:** `ValueError` for a graph that is not connected, or for a stationary distribution
    that no chain on the graph has; `RuntimeError` if the residual stays above the tolerance.

    A patroller that must move cannot be at one vertex for more than half of the time:

        >>> from jaxcell import patrol
        >>> graph = patrol.Graph([[0, 1], [1, 2], [2, 0]])
        >>> patrol.walks.minimum_kemeny(graph, [0.6, 0.2, 0.2])
        Traceback (most recent call last):
            ...
        ValueError: stationary: vertices 0 have 0.6 of the time, but those that follow have only ...
    """
    among = ChainPolytope.on(graph, stationary, stay=stay, reversible=reversible)
    return minimize(
        "minimum_kemeny",
        _kemeny,
        among,
        (),
        starts=starts,
        seed=seed,
        tolerance=tolerance,
        throw=throw,
    )


def _kemeny(matrices: Float[Array, "1 vertices vertices"]) -> Float[Array, ""]:
    return dense.kemeny(matrices[0])
