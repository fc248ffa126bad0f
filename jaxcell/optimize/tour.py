from collections.abc import Sequence

import numpy as np
import scipy.sparse.csgraph
from jaxtyping import Bool, Float, Int

from .graph import Graph, GraphLike


# Largest number of vertices for which the order is optimal.
_EXACT = 12
# Largest number of random changes of a tour, and of changes times stops.
_CHANGES, _WORK = 40, 16_000
# Relative decrease of the length of an edge that is already part of the tour.
_AGAIN = 1e-9


def shortest_tour(graph: GraphLike, through: Sequence[int]) -> Int[np.ndarray, "steps"]:
    """Find a short closed walk through given vertices, along shortest paths between them.

    The order is optimal for up to 12 vertices (Held and Karp 1962). For more vertices, farthest
    insertion inserts each vertex where it lengthens the tour least, and then parts of the tour are
    reversed or moved while this shortens the tour; the result may be longer than the shortest tour.
    Among equally short paths, paths along edges of the tour are preferred, so that the tour has few
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
    order = best_order(between) if stops.size <= _EXACT else good_order(between)
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


def best_order(between: Float[np.ndarray, "stops stops"]) -> Int[np.ndarray, "stops"]:
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


def good_order(between: Float[np.ndarray, "stops stops"]) -> Int[np.ndarray, "stops"]:
    """Order stops into a short closed tour; from `i` to `j` it is `between[i, j]`, one way.

    Farthest insertion makes a tour, which [`improved_order`][] shortens, also after random changes.
    """
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
    best = improved_order(np.array(tour), between)
    random = np.random.default_rng(0)
    for _ in range(min(_CHANGES, _WORK // len(best)) if len(best) > 7 else 0):
        # Exchange two parts of the tour, which no single reversal or move does.
        i, j, k = np.sort(random.choice(np.arange(1, len(best)), 3, replace=False)).tolist()
        changed = np.concatenate([best[:i], best[j:k], best[i:j], best[k:]])
        changed = improved_order(changed, between)
        if tour_length(changed, between) < tour_length(best, between) * (1 - _AGAIN):
            best = changed
    return np.roll(best, -int(np.flatnonzero(best == 0)[0]))


def tour_length(order: Int[np.ndarray, "stops"], between: Float[np.ndarray, "all all"]) -> float:
    """Compute the length of the closed tour in an order."""
    return float(between[order, np.roll(order, -1)].sum())


def improved_order(
    order: Int[np.ndarray, "stops"], between: Float[np.ndarray, "all all"]
) -> Int[np.ndarray, "stops"]:
    """Shorten a tour until no reversal of a part, and no move of up to 3 stops, shortens it."""
    count = order.size
    if count < 4:
        return order
    tolerance = 1e-12 * between[order, np.roll(order, -1)].sum()
    since = 0
    while since < count:
        order, since = np.roll(order, -1), since + 1
        here, there, before = order, np.roll(order, -1), order[-1]
        forth, back = between[here, there], between[there, here]
        # Reverse the stops from 0 to k, up to the last but one.
        inside = np.append(0.0, np.cumsum(back[:-2] - forth[:-2]))
        first, last = here[0], here[:-1]
        longer = between[before, last] + between[first, there[:-1]] + inside
        longer -= between[before, first] + forth[:-1]
        k = int(longer.argmin())
        if longer[k] < -tolerance:
            order, since = np.append(order[k::-1], order[k + 1 :]), 0
            continue
        for part in range(1, min(4, count - 2)):
            # Move the first stops between the stops k and k + 1, in their order or reversed.
            end, after = here[part - 1], here[part:-1]
            shorter = forth[part - 1] + forth[-1] - between[before, here[part]]
            turned = back[: part - 1].sum() - forth[: part - 1].sum()
            ahead = between[after, first] + between[end, there[part:-1]]
            turning = between[after, end] + between[first, there[part:-1]] + turned
            longer = np.minimum(ahead, turning) - forth[part:-1] - shorter
            k = int(longer.argmin())
            if longer[k] < -tolerance:
                moved = order[:part] if ahead[k] <= turning[k] else order[:part][::-1]
                k += part + 1
                order, since = np.concatenate([order[part:k], moved, order[k:]]), 0
                break
    return order
