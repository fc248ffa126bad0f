from collections.abc import Sequence

import numpy as np
import scipy.sparse.csgraph
from jaxtyping import Bool, Float, Int

from .graph import Graph, GraphLike


# Largest number of vertices for which the order is optimal.
_EXACT = 12
# Relative decrease of the length of an edge that is already part of the tour.
_AGAIN = 1e-9


def shortest_tour(graph: GraphLike, through: Sequence[int]) -> Int[np.ndarray, "steps"]:
    """Find a short closed walk through given vertices, along shortest paths between them.

    The order is optimal for up to 12 vertices (Held and Karp 1962). For more vertices, farthest
    insertion inserts each vertex where it lengthens the tour least, and then parts of the tour are
    reversed while this shortens the tour; the result may be longer than the shortest tour. Among
    equally short paths, paths along edges of the tour are preferred, so that the tour has few
    edges.

    **Arguments:** the graph, in which the length of a path is the sum of [`Graph.lengths`][]; and
    two or more vertices. **Returns:** the vertices of the walk in order, from the first of
    `through`. The first vertex is not repeated at the end. A walk may pass a vertex or an edge more
    than once.

    A square, whose opposite corners are not joined by an edge:

        >>> from jaxcell import optimize
        >>> square = optimize.Graph([[0, 1], [1, 2], [2, 3], [3, 0]])
        >>> optimize.shortest_tour(square, [0, 2]).tolist()
        [0, 3, 2, 3]
    """
    stops = np.asarray(through)
    if stops.ndim != 1 or stops.size < 2 or not np.issubdtype(stops.dtype, np.integer):
        raise ValueError(f"expected two or more vertices for a tour, got {through!r}")
    wrong = stops[(stops < 0) | (stops >= graph.vertices)]
    if wrong.size:
        raise ValueError(
            f"vertex {wrong[0]} does not exist; vertices are 0 to {graph.vertices - 1}"
        )
    names, counts = np.unique(stops, return_counts=True)
    if (counts > 1).any():
        raise ValueError(f"vertex {names[counts > 1][0]} comes twice in the list of vertices")
    # scipy ignores edges of length 0, between vertices at one position.
    lengths = np.maximum(graph.lengths, np.finfo(np.float64).tiny)
    between = scipy.sparse.csgraph.dijkstra(graph.matrix(lengths), indices=stops)[:, stops]
    far = stops[np.isinf(between[0])]
    if far.size:
        raise ValueError(f"vertex {far[0]} cannot be reached from vertex {stops[0]}")
    order = _best_order(between) if stops.size <= _EXACT else _good_order(between)
    legs: list[list[int]] = []
    used = np.zeros(len(graph.edges), bool)
    for here, there in zip(stops[order], stops[np.roll(order, -1)], strict=True):
        # In a search from the next stop, the predecessors lead to this stop.
        _, before = scipy.sparse.csgraph.dijkstra(
            graph.matrix(lengths * (1 - _AGAIN * used)), indices=there, return_predecessors=True
        )
        leg = [int(here)]
        while leg[-1] != there:
            leg.append(int(before[leg[-1]]))
        legs.append(leg[:-1])
        used |= _between(graph, np.array(leg[:-1]), np.array(leg[1:]))
    return np.array([vertex for leg in legs for vertex in leg], np.int32)


def on_walk(graph: Graph, walk: Int[np.ndarray, "steps"]) -> Bool[np.ndarray, "edges"]:
    """Return a mask of the edges of a closed walk."""
    return _between(graph, walk, np.roll(walk, -1))


def _between(
    graph: Graph, here: Int[np.ndarray, "steps"], there: Int[np.ndarray, "steps"]
) -> Bool[np.ndarray, "edges"]:
    used = np.minimum(here, there).astype(np.int64) * graph.vertices + np.maximum(here, there)
    edges = np.sort(graph.edges, axis=1).astype(np.int64)
    return np.isin(edges[:, 0] * graph.vertices + edges[:, 1], used)


def _best_order(between: Float[np.ndarray, "stops stops"]) -> Int[np.ndarray, "stops"]:
    """Find the order of the shortest tour with dynamic programming over sets of stops."""
    last = between.shape[0] - 1
    step = between[1:, 1:]
    # `cost[s, j]`: the least length from stop 0 through the stops in the bit set s, ending at j.
    cost = np.full((1 << last, last), np.inf)
    came = np.zeros((1 << last, last), np.int64)
    bit = 1 << np.arange(last)
    cost[bit, np.arange(last)] = between[0, 1:]
    for visited in range(1, 1 << last):
        onward = cost[visited][:, None] + step
        came_from = onward.argmin(axis=0)
        reached = onward[came_from, np.arange(last)]
        new = np.flatnonzero((visited & bit) == 0)
        cost[visited | bit[new], new] = reached[new]
        came[visited | bit[new], new] = came_from[new]
    visited = (1 << last) - 1
    stop = int(np.argmin(cost[visited] + between[1:, 0]))
    order = []
    for _ in range(last):
        order.append(stop + 1)
        visited, stop = visited ^ (1 << stop), int(came[visited, stop])
    return np.array([0, *reversed(order)])


def _good_order(between: Float[np.ndarray, "stops stops"]) -> Int[np.ndarray, "stops"]:
    """Find an order by farthest insertion, then reverse parts of it while that makes it shorter."""
    tour = [0]
    nearest = between[0].copy()
    while len(tour) < between.shape[0]:
        stop = int(np.argmax(nearest))
        here = np.array(tour)
        there = np.roll(here, -1)
        longer = between[here, stop] + between[stop, there] - between[here, there]
        tour.insert(int(np.argmin(longer)) + 1, stop)
        nearest = np.minimum(nearest, between[stop])
        nearest[tour] = -1
    order = np.array(tour)
    while True:
        here, there = order, np.roll(order, -1)
        now = between[here, there]
        # Reversing the part between edges i and j joins both first ends, and both second ends.
        saved = (
            now[:, None]
            + now[None, :]
            - between[np.ix_(here, here)]
            - between[np.ix_(there, there)]
        )
        i, j = np.unravel_index(np.argmax(np.triu(saved, 1)), saved.shape)
        if saved[i, j] <= 1e-12 * now.sum() or i >= j:
            start = int(np.flatnonzero(order == 0)[0])
            return np.roll(order, -start)
        order[i + 1 : j + 1] = order[i + 1 : j + 1][::-1].copy()
