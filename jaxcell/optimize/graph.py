import dataclasses
import operator
from collections.abc import Hashable, Iterable, Sequence
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import scipy.sparse
from jaxtyping import Float, Int

from ..base.doubts import Doubt, warn
from ..base.shown import Pictured
from .geographic import degrees, great_circles, in_metres, positioned
from .validation import finite, one_each


# Attributes of edges that people give for a length.
UNREAD = frozenset({"weight", "distance", "travel_time", "cost", "time", "duration"})


@dataclasses.dataclass(frozen=True, eq=False, init=False)
class Graph(Pictured):
    """An undirected graph without loops or parallel edges, with optional positions of its vertices.

    A line of three vertices, with positions:

        >>> from jaxcell import optimize
        >>> graph = optimize.Graph([[0, 1], [1, 2]], xy=[[0, 0], [3, 4], [3, 5]])
        >>> graph.vertices, graph.lengths.tolist()
        (3, [5.0, 1.0])
    """

    vertices: int
    "Number of vertices, which are numbered from 0."
    edges: Int[np.ndarray, "edges 2"]
    "The two ends of each edge."
    xy: Float[np.ndarray, "vertices 2"] | None
    "The position of each vertex, in metres, or `None`."
    ways: Float[np.ndarray, "edges"] | None
    "The length of each edge, in metres, or `None` if it is the distance between its ends."

    def __init__(
        self, edges: Any, vertices: int | None = None, xy: Any = None, ways: Any = None
    ) -> None:
        """Create a graph from its edges, or from an undirected graph of networkx.

        Nodes 0, 1, ... of a networkx graph, in any order, are the vertices with these numbers;
        other nodes are numbered in its order. Its node attributes `x` and `y`, or `pos`, are
        positions, and its edge attribute `length` is the length of an edge, in metres; other
        attributes are ignored, with a doubt if edges without a length have a `weight`. Positions
        `lon` and `lat`, or `x` and `y` if the attribute `crs` of the graph is geographic, are
        degrees and become metres, with lengths on the Earth.

        **Arguments:**

        - `edges`: integer array `[edges, 2]`, the two ends of each edge; or the networkx graph.
        - `vertices`: number of vertices; by default the number of rows of `xy`, or without `xy` one
            more than the largest end of an edge.
        - `xy`: array `[vertices, 2]`, the positions, in metres.
        - `ways`: array `[edges]`, the lengths of the edges, in metres; by default edges are
            straight.
        """
        names: Sequence[Hashable] | None = None
        if hasattr(edges, "is_multigraph"):
            names = numbered(edges)
            edges, xy, ways = _of_networkx(edges, names, xy, ways)
            vertices = len(names) if vertices is None else vertices
        ends = np.asarray(edges)
        if ends.ndim != 2 or ends.shape[1] != 2 or ends.shape[0] == 0:
            raise ValueError(f"edges: expected an array [edges, 2], got {list(ends.shape)}")
        if not np.issubdtype(ends.dtype, np.integer):
            raise ValueError(f"edges: expected whole numbers, got {ends.dtype}")
        places = None if xy is None else finite("xy", xy)
        if vertices is None:
            vertices = int(ends.max()) + 1 if places is None else places.shape[0]
        vertices = operator.index(vertices)
        if vertices < 2:
            raise ValueError(f"vertices: expected at least 2, got {vertices}")
        _check_edges(ends, vertices, range(vertices) if names is None else names)
        if places is not None and places.shape != (vertices, 2):
            raise ValueError(f"xy: expected an array [{vertices}, 2], got {list(places.shape)}")
        lengths = None if ways is None else one_each("ways", ways, len(ends), "per edge")
        object.__setattr__(self, "ways", lengths)
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "edges", ends.astype(np.int32))
        object.__setattr__(self, "xy", places)

    @classmethod
    def of_input(cls, value: Any) -> "Graph | None":
        """Create a graph of a networkx graph or of an array of edges."""
        edges = (
            hasattr(value, "is_multigraph") or hasattr(value, "shape") or isinstance(value, list)
        )
        return cls(value) if edges else None

    @property
    def lengths(self) -> Float[np.ndarray, "edges"]:
        """The length of each edge: from `ways` in metres, or from `xy`, or 1 if both are `None`."""
        if self.ways is not None:
            return self.ways
        if self.xy is None:
            return np.ones(len(self.edges))
        tail, head = self.edges.T
        return np.hypot(*(self.xy[tail] - self.xy[head]).T)

    def matrix(self, values: Float[np.ndarray, "edges"]) -> scipy.sparse.csr_array:
        """Build the symmetric sparse matrix with the value of edge `i, j` in its entry `[i, j]`."""
        tail, head = self.edges.T
        entries = (np.tile(values, 2), (np.append(tail, head), np.append(head, tail)))
        return scipy.sparse.csr_array(entries, shape=(self.vertices, self.vertices))


if TYPE_CHECKING:
    # Networkx has no types.
    GraphLike: TypeAlias = Graph | Any
    """A graph, or what public functions convert to one: a graph of networkx, or an array of
    edges."""
else:
    GraphLike = Graph


def numbered(network: Any) -> Sequence[Hashable]:
    """List the nodes of a networkx graph by their number: by name if the names are 0, 1, ..."""
    nodes = list(network)
    return range(len(nodes)) if set(nodes) == set(range(len(nodes))) else nodes


def _of_networkx(
    network: Any, names: Sequence[Hashable], xy: Any, ways: Any
) -> tuple[Any, Any, Any]:
    """Return the edges of a networkx graph, and its positions and lengths if none are given."""
    if network.is_directed():
        raise ValueError(
            "edges: the networkx graph is directed; expected an undirected graph, such as that of "
            "its method to_undirected"
        )
    number = {name: vertex for vertex, name in enumerate(names)}
    edges = [[number[tail], number[head]] for tail, head in network.edges()]
    if not edges:
        raise ValueError("edges: the networkx graph has no edges")
    ends = np.array(edges, np.int64)
    if ways is None:
        lengths = [length for *_, length in network.edges(data="length")]
        ways = _all_or_none(lengths, network.edges(), "length, but other edges have")
    if xy is None:
        crs = network.graph.get("crs")
        attributes = [positioned(network.nodes[name], crs) for name in names]
        plane = [
            (node["x"], node["y"]) if {"x", "y"} <= node.keys() else node.get("pos")
            for node in attributes
        ]
        if all(place is None for place in plane) and any(map(degrees, attributes)):
            earth = [degrees(node) for node in attributes]
            lacking = "longitude and latitude, but other vertices have"
            places = finite("xy", _all_or_none(earth, number, lacking))
            if (np.abs(places) > [360, 90]).any():
                raise ValueError(
                    "edges: in the networkx graph, positions are degrees, as its crs or the names "
                    "of attributes say; expected longitudes to 360 and latitudes to 90"
                )
            return ends, in_metres(places), great_circles(places, ends) if ways is None else ways
        xy = _all_or_none(plane, number, "position x, y or pos, but other vertices have")
    unread = UNREAD.intersection(*(values for *_, values in network.edges(data=True)))
    if ways is None and unread:
        of_each = "1 m" if xy is None else "the distance of its ends"
        warn(
            f"edges: the networkx graph has no `length` of edges, and its `{min(unread)}` is not "
            f"read: the length of each edge is {of_each}; give lengths as `length` or `ways`, in "
            "metres",
            Doubt,
        )
    return ends, xy, ways


def _all_or_none(values: list[Any], owners: Iterable[Any], lacking: str) -> list[Any] | None:
    given = [value is not None for value in values]
    if not any(given):
        return None
    if not all(given):
        raise ValueError(
            f"edges: in the networkx graph, {list(owners)[given.index(False)]!r} has no {lacking}"
        )
    return values


def _check_edges(ends: Int[np.ndarray, "edges 2"], vertices: int, names: Sequence[Any]) -> None:
    if ends.min() < 0 or ends.max() >= vertices:
        edge, side = np.argwhere((ends < 0) | (ends >= vertices))[0]
        raise ValueError(
            f"edges[{edge}, {side}] is {ends[edge, side]}; vertices are 0 to {vertices - 1}"
        )
    loops = np.flatnonzero(ends[:, 0] == ends[:, 1])
    if loops.size:
        raise ValueError(
            f"edges[{loops[0]}] is a loop at vertex {names[ends[loops[0], 0]]!r}; expected two ends"
        )
    key = ends.min(axis=1).astype(np.int64) * vertices + ends.max(axis=1)
    _, first, same = np.unique(key, return_index=True, return_inverse=True)
    again = np.flatnonzero(first[same] != np.arange(key.size))
    if again.size:
        edge = again[0]
        raise ValueError(
            f"edges[{edge}] joins {names[ends[edge, 0]]!r} and {names[ends[edge, 1]]!r}, as edges"
            f"[{first[same[edge]]}] does; expected no parallel edges"
        )
