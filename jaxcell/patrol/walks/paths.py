import itertools
import math
import operator
from fractions import Fraction

import networkx
import numpy as np
import scipy.sparse
from jaxtyping import Float, Int

from ...mapping import Chain
from ...optimize import Graph


# Edges are as long as so many parts of a line at most, if they are so to rounding.
_PARTS, _ROUNDING = 16, 1e-9
# Vertices times edges times paths: more of Yen's searches take minutes.
_MAX_SEARCHES = 500_000


def toward(graph: Graph, vertex: int, paths: int = 1, *, directed: bool = True) -> Chain:
    """A walk that heads for a vertex along short paths (Alam 2018, Alg. 4.1).

    A step counts once for each of the shortest simple paths to the vertex, from every other, that
    goes along it (Yen 1971), and each step away from the vertex counts once; a step is taken in
    proportion to its count. As printed, only the direction of the path counts. Then one path from
    each vertex makes the time to come there the number of edges, as in all rows of Table 4.2; and
    in the long run the walk may leave out vertices that no path from a neighbour of the vertex
    comes through. Where both directions count, the walk is reversible, and far slower.

    Paths are in order of their Euclidean lengths. Of equally long ones, as along a line and along
    pieces of it, one with fewer edges comes first, and then the one without the last edge, in the
    order of the graph, of those in which they differ.

    **Arguments:**

    - `graph`: a connected graph.
    - `vertex`: where the walk heads for.
    - `paths`: how many paths from each other vertex; all its simple paths, if there are fewer.
    - `directed`: whether only the direction of a path counts, or both.

    **Returns:** [`jaxcell.mapping.Chain`][] whose cells are the vertices.

    **Raises:** `ValueError` for a vertex that does not exist, no paths, a vertex from which no path
    leads there, and several paths on a graph on which they take minutes to find.

    A square with a diagonal from 1 to 3. The path from 2 is by 1, and from 0 both ways are open:

        >>> from jaxcell import patrol
        >>> edges = [[0, 1], [1, 2], [2, 3], [3, 0], [1, 3]]
        >>> graph = patrol.Graph(edges, xy=[[0, 0], [1, 0], [1, 1], [0, 1]])
        >>> patrol.toward(graph, 0).to_scipy().toarray().tolist()
        [[0.0, 0.5, 0.0, 0.5], [1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]]
    """
    there, back = path_counts(graph, vertex, paths)
    if not directed:
        there = back = there + back
    tail, head = graph.edges.T
    counts = scipy.sparse.csr_array(
        (np.concatenate([there, back]), (np.append(tail, head), np.append(head, tail))),
        (graph.vertices, graph.vertices),
    ).astype(np.float64)
    return Chain.from_scipy(scipy.sparse.diags_array(1 / counts.sum(axis=1)) @ counts)


def path_counts(graph: Graph, vertex: int, paths: int) -> Int[np.ndarray, "2 edges"]:
    """How often each edge counts in Alg. 4.1, in its own direction and in the other.

    **Arguments and raises:** as [`toward`][].
    """
    vertex, paths = operator.index(vertex), operator.index(paths)
    if not 0 <= vertex < graph.vertices:
        raise ValueError(f"vertex {vertex} does not exist; vertices are 0 to {graph.vertices - 1}")
    if paths < 1:
        raise ValueError(f"paths: expected at least 1, got {paths}")
    searches = graph.vertices * len(graph.edges) * paths
    if paths > 1 and searches > _MAX_SEARCHES:
        raise ValueError(
            f"paths: {paths} from each of {graph.vertices:,} vertices take minutes to find; "
            "expected 1, or a smaller graph"
        )
    network = networkx.Graph()
    network.add_nodes_from(range(graph.vertices))
    edges = graph.edges.tolist()
    for edge, ((tail, head), length) in enumerate(zip(edges, _lengths(graph), strict=True)):
        network.add_edge(tail, head, number=edge, length=length)
    shortest = networkx.single_source_dijkstra_path(network, vertex, weight="length")
    counts = np.zeros((2, len(edges)), np.int64)

    def count(here: int, there: int) -> None:
        edge = network.edges[here, there]["number"]
        counts[int(edges[edge][0] != here), edge] += 1

    for neighbour in network[vertex]:
        count(vertex, neighbour)
    for start in network.nodes - {vertex}:
        if start not in shortest:
            raise ValueError(f"vertex {vertex} cannot be reached from vertex {start}")
        found = [shortest[start][::-1]]
        if paths > 1:
            simple = networkx.shortest_simple_paths(network, start, vertex, weight="length")
            found = list(itertools.islice(simple, paths))
        for path in found:
            for step in itertools.pairwise(path):
                count(*step)
    return counts


def _lengths(graph: Graph) -> list[int]:
    """Lengths by which no two paths are equally long: whole numbers of many digits.

    Lowest is a bit for each edge, so that sums show which edges are in them; then, the number of
    edges; then, the length in units.
    """
    exact = _exact(graph.lengths)
    units = math.lcm(*(one.denominator for one in exact))
    edges, digits = len(exact), graph.vertices.bit_length()
    return [
        (((int(one * units) << digits) + 1) << edges) + (1 << edge)
        for edge, one in enumerate(exact)
    ]


def _exact(lengths: Float[np.ndarray, "edges"]) -> list[Fraction]:
    """Lengths such that pieces of a line are together as long as the line, without rounding."""
    exact = [Fraction(0)] * lengths.size
    parts = np.arange(1, _PARTS + 1)[:, None]
    left = np.flatnonzero(lengths)
    while left.size:
        longest = lengths[left].max()
        share = parts * lengths[left] / longest
        whole = np.abs(share - np.rint(share)) < _ROUNDING
        alike = whole.any(axis=0)
        of = whole[:, alike].argmax(axis=0)
        pieces = np.rint(share[:, alike][of, np.arange(of.size)]).astype(int)
        for edge, some, all_ in zip(left[alike], pieces.tolist(), (of + 1).tolist(), strict=True):
            exact[edge] = Fraction(longest) * Fraction(some, all_)
        left = left[~alike]
    return exact
