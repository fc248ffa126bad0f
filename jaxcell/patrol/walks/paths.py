import itertools
import math
from fractions import Fraction

import networkx
import numpy as np
import scipy.sparse
from jaxtyping import Float

from ...mapping import Chain
from ...optimize import Graph, GraphLike
from ...optimize.validation import check_count
from ..team.times import check_vertex


# Lengths become exact fractions of a longer length: the largest denominator, and the tolerance.
_PARTS, _ROUNDING = 16, 1e-9
# Vertices times edges times paths, above which Yen's searches take minutes.
_MAX_SEARCHES = 500_000


def toward(graph: GraphLike, vertex: int, paths: int = 1) -> Chain:
    """Build a walk that heads for a vertex along short paths (Alam 2018, Alg. 4.1).

    From every other vertex there are `paths` shortest simple paths to the vertex (Yen 1971). Each
    step gets a count: the number of these paths that contain it, or 1 for a step that leaves the
    vertex. The probability of a step is in proportion to its count. As in the printed algorithm, a
    path adds only to the counts of steps in its own direction. In the long run, the walk may leave
    out vertices that are on no path from a neighbour of the vertex.

    Paths are in order of their Euclidean lengths. Among equally long paths, such as one straight
    edge and several edges along it, the path with fewer edges is first. If two paths still tie, the
    second contains the edge with the highest number, among the edges on only one of them.

    **Arguments:** a connected graph; the vertex for which the walk heads; and the number of paths
    from each other vertex, or all simple paths if there are fewer. **Returns:**
    [`jaxcell.mapping.Chain`][] whose cells are the vertices.

    A square with a diagonal from 1 to 3; the path from 2 goes through 1:

        >>> from jaxcell import patrol
        >>> edges = [[0, 1], [1, 2], [2, 3], [3, 0], [1, 3]]
        >>> graph = patrol.Graph(edges, xy=[[0, 0], [1, 0], [1, 1], [0, 1]])
        >>> patrol.toward(graph, 0).to_scipy().toarray().tolist()
        [[0.0, 0.5, 0.0, 0.5], [1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]]
    """
    check_vertex("vertex", vertex, graph.vertices)
    check_count("paths", paths)
    searches = graph.vertices * len(graph.edges) * paths
    if paths > 1 and searches > _MAX_SEARCHES:
        raise ValueError(
            f"paths: {paths} from each of {graph.vertices:,} vertices take minutes to find; "
            "expected 1, or a smaller graph"
        )
    network = networkx.Graph()
    network.add_nodes_from(range(graph.vertices))
    for (tail, head), length in zip(graph.edges.tolist(), _lengths(graph), strict=True):
        network.add_edge(tail, head, length=length)
    shortest = networkx.single_source_dijkstra_path(network, vertex, weight="length")
    counts = scipy.sparse.dok_array((graph.vertices, graph.vertices))
    for neighbour in network[vertex]:
        counts[vertex, neighbour] += 1
    for start in network.nodes - {vertex}:
        if start not in shortest:
            raise ValueError(f"vertex {vertex} cannot be reached from vertex {start}")
        chosen = [shortest[start][::-1]]
        if paths > 1:
            simple = networkx.shortest_simple_paths(network, start, vertex, weight="length")
            chosen = list(itertools.islice(simple, paths))
        for path in chosen:
            for step in itertools.pairwise(path):
                counts[step] += 1
    rows = counts.tocsr()
    return Chain.from_scipy(scipy.sparse.diags_array(1 / rows.sum(axis=1)) @ rows)


def _lengths(graph: Graph) -> list[int]:
    """Return integer lengths with which no two paths are equally long.

    The lowest bits are one bit per edge, so that different paths have different sums; the middle
    bits count the edges; the highest bits are the length, in a unit that divides all lengths.
    """
    exact = _exact(graph.lengths)
    units = math.lcm(*(length.denominator for length in exact))
    edges, digits = len(exact), graph.vertices.bit_length()
    return [
        (((int(length * units) << digits) + 1) << edges) + (1 << edge)
        for edge, length in enumerate(exact)
    ]


def _exact(lengths: Float[np.ndarray, "edges"]) -> list[Fraction]:
    """Return lengths as exact fractions, so that the edges along a line sum to its length."""
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
        for edge, piece, all_ in zip(left[alike], pieces.tolist(), (of + 1).tolist(), strict=True):
            exact[edge] = Fraction(longest) * Fraction(piece, all_)
        left = left[~alike]
    return exact
