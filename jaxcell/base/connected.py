"""Check that a graph is connected."""

import numpy as np
import scipy.sparse
from jaxtyping import Int


_MAX_LISTED = 8


def vertices_apart(
    vertices: int, edges: Int[np.ndarray, "edges 2"]
) -> tuple[Int[np.ndarray, "some"], int] | None:
    """Find the smallest connected component of a graph, if the graph is not connected.

    **Returns:** the vertices of this component, and the first vertex outside it; `None` if the
    graph is connected.
    """
    matrix = scipy.sparse.csr_array((np.ones(len(edges)), edges.T), (vertices, vertices))
    parts, part = scipy.sparse.csgraph.connected_components(matrix, directed=False)
    if parts < 2:
        return None
    # Among equally small components choose the last, which does not contain vertex 0.
    smallest = parts - 1 - int(np.argmin(np.bincount(part)[::-1]))
    return np.flatnonzero(part == smallest), int(np.flatnonzero(part != smallest)[0])


def check_connected(
    vertices: int,
    edges: Int[np.ndarray, "edges 2"],
    expected: str = "graph: expected all vertices connected, but",
) -> None:
    """Raise `ValueError` if a graph is not connected; the message begins with `expected`."""
    parts = vertices_apart(vertices, edges)
    if parts is None:
        return
    apart, other = parts
    listed = ", ".join(map(str, apart[:_MAX_LISTED])) + ", ..." * (apart.size > _MAX_LISTED)
    raise ValueError(
        f"{expected} {'vertex' if apart.size == 1 else 'vertices'} {listed} "
        f"({apart.size} of {vertices}) cannot be reached from vertex {other}"
    )
