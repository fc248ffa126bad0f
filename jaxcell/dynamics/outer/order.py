"""Strong components of a graph, and paths between them."""

import numpy as np
from jaxtyping import Bool, Int
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components


# Number of sets whose predecessors are found at once, one per bit.
_BITS = 64


def recurrent_components(graph: csr_array) -> Int[np.ndarray, "vertices"]:
    """Return the strong component that contains each vertex, or -1 for vertices on no cycle."""
    _, label = connected_components(graph, directed=True, connection="strong")
    recurs = np.bincount(label) > 1
    recurs[label[graph.diagonal() > 0]] = True
    return np.where(recurs, np.cumsum(recurs) - 1, -1)[label]


def reachable(
    graph: csr_array, member: Int[np.ndarray, "vertices"], count: int
) -> Bool[np.ndarray, "sets sets"]:
    """Find all pairs of different sets `i` and `j` such that a path leads from `i` to `j`.

    `member` is the set that contains each vertex, or -1 for none, and `count` the number of sets.
    Each set must be strongly connected.
    """
    into = graph.T.tocsr()
    leads = np.zeros((count, count), bool)
    for begin in range(0, count, _BITS):
        shift = member - begin
        front = np.flatnonzero((shift >= 0) & (shift < _BITS))
        reached = np.zeros(member.size, np.uint64)
        reached[front] = np.uint64(1) << shift[front].astype(np.uint64)
        while front.size:
            # Vertices before those that changed reach the same sets.
            sizes = into.indptr[front + 1] - into.indptr[front]
            at = np.arange(sizes.sum()) + np.repeat(
                into.indptr[front] - np.cumsum(sizes) + sizes, sizes
            )
            vertex, more = into.indices[at], np.repeat(reached[front], sizes)
            new = (more & ~reached[vertex]) != 0
            vertex = vertex[new]
            np.bitwise_or.at(reached, vertex, more[new])
            front = np.unique(vertex)
        width = min(_BITS, count - begin)
        own = np.zeros(count, np.uint64)
        np.bitwise_or.at(own, member[member >= 0], reached[member >= 0])
        bits = own[:, None] >> np.arange(width, dtype=np.uint64) & np.uint64(1)
        leads[:, begin : begin + width] = bits.astype(bool)
    np.fill_diagonal(leads, False)
    return leads
