import itertools
import operator

import numpy as np
from jaxtyping import Float

from ...optimize import Graph


# The longest edge is so many units long; what differs by less is equally long.
_UNITS = 2**30


def toward(graph: Graph, vertex: int, paths: int = 3) -> Float[np.ndarray, "edges"]:
    """Weights of a walk that heads for a vertex along short paths (Alam 2018, Alg. 4.1).

    An edge counts once for each of the shortest simple paths to the vertex, from every other, that
    it is on (Yen 1971), and once more if it ends at the vertex. Because each vertex is on a path of
    its own, no walk is stuck, and each comes to the vertex; edges that are on no path have weight
    0.

    Paths are in order of their Euclidean lengths. Of equally long ones, to 30 bits of the longest
    edge, one with fewer edges comes first, and then the one without the last edge, in the order of
    the graph, of those in which they differ.

    **Arguments:**

    - `graph`: a connected graph.
    - `vertex`: where the walk heads for.
    - `paths`: how many paths from each other vertex; all its simple paths, if there are fewer.

    **Returns:** the weights, which sum to 1, for [`jaxcell.patrol.random_walk`][].

    **Raises:** `ValueError` for a vertex that does not exist, no paths, or a vertex from which no
    path leads there.

    A square with a diagonal from 1 to 3, and one path to 0 from each other vertex: that from 2 is
    by 1, and the two edges at 0 count once more.

        >>> from jaxcell import patrol
        >>> edges = [[0, 1], [1, 2], [2, 3], [3, 0], [1, 3]]
        >>> graph = patrol.Graph(edges, xy=[[0, 0], [1, 0], [1, 1], [0, 1]])
        >>> (6 * patrol.toward(graph, 0, paths=1)).round(6).tolist()
        [3.0, 1.0, 0.0, 2.0, 0.0]
    """
    import networkx

    vertex, paths = operator.index(vertex), operator.index(paths)
    if not 0 <= vertex < graph.vertices:
        raise ValueError(f"vertex {vertex} does not exist; vertices are 0 to {graph.vertices - 1}")
    if paths < 1:
        raise ValueError(f"paths: expected at least 1, got {paths}")
    network = networkx.Graph()
    network.add_nodes_from(range(graph.vertices))
    edges = graph.edges.tolist()
    for edge, ((tail, head), length) in enumerate(zip(edges, _lengths(graph), strict=True)):
        network.add_edge(tail, head, number=edge, length=length)
    counts = np.zeros(len(edges), np.int64)
    counts[[number for *_, number in network.edges(vertex, data="number")]] = 1
    for start in network.nodes - {vertex}:
        if not networkx.has_path(network, start, vertex):
            raise ValueError(f"vertex {vertex} cannot be reached from vertex {start}")
        found = networkx.shortest_simple_paths(network, start, vertex, weight="length")
        for path in itertools.islice(found, paths):
            counts[[network.edges[step]["number"] for step in itertools.pairwise(path)]] += 1
    return counts / counts.sum()


def _lengths(graph: Graph) -> list[int]:
    """Lengths by which no two paths are equally long: whole numbers of many digits.

    Lowest is a bit for each edge, so that sums show which edges are in them; then, the number of
    edges; then, the length in units.
    """
    lengths = graph.lengths
    longest = lengths.max() or 1.0
    units = np.rint(lengths / longest * _UNITS).astype(np.int64).tolist()
    edges, digits = len(units), graph.vertices.bit_length()
    return [(((unit << digits) + 1) << edges) + (1 << edge) for edge, unit in enumerate(units)]
