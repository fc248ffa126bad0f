"""Readers of graph files: node-link JSON, GraphML, GML, patrolling_sim graphs, and lists.

Every vertex has a name, and either all vertices have a position or none has. Loops are left out,
and so are all but the shortest of parallel edges. For a `Graph` each directed edge needs its way
back; `load_ways` keeps directed edges. Either all edges have a `length` in metres, or all edges are
straight; `weight` names another attribute for the length. Other attributes are ignored.

Positions are in metres, or in degrees if they are named `lon` and `lat` (or `longitude` and
`latitude`), or if the attribute `crs` of the graph is geographic, such as `EPSG:4326`. Degrees are
converted to metres East and North of the middle, and edges without a length follow great circles.

**Node-link JSON** (`.json`) is an object with two lists. Each member of `nodes` has an `id`, and
either `x` and `y` or a pair `pos`; each member of `edges` (or `links`) has a `source` and a
`target`. In **GraphML** (`.graphml`) and **GML** (`.gml`) the vertices have attributes `x` and `y`.
A **patrolling_sim graph** (`.graph`) is a file of that ROS simulator. A **route graph** of nav2
(`.geojson`) has points with an `id`, and lines from `startid` to `endid`. An **adjacency list**
(`.adjlist`) has one line per vertex, with its name and its neighbours' names. An **edge list**
(`.edges`, `.txt`) is text; `#` begins a comment:

```
# A line of three words is a vertex and its position in metres.
hall 0 0
yard 3.5 1
# A line of two words is an edge.
hall yard
```
"""

import os
import reprlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ...base.bundled import with_path
from ...base.documents import MAX_NUMBER, Fields, about, checked_number, checked_pair, refused
from ...base.doubts import Doubt, warn
from ...optimize import Graph
from ...optimize.geographic import degrees, great_circles, in_metres
from ...optimize.graph import numbered
from .graph_formats import Edge, Vertex, doubt_attributes, of_networkx, parsed


# Edges that are all shorter, in metres, are rather differences of degrees.
_SHORT = 0.1
# Edges that are longer than this, times the distances of their ends, have ends in degrees.
_MUCH_LONGER = 1e4
# The relative difference of equal lengths, which files may round.
_EQUAL = 1e-6
_DIRECTED = (
    "expected an undirected graph, whose edges a patroller can walk both ways; rounds on one-way "
    "edges are found by `jaxcell patrol guard`"
)


class Ways(NamedTuple):
    """A directed graph: each way leads from the first of two vertices to the second."""

    names: tuple[str, ...]
    ends: Int[np.ndarray, "ways 2"]
    lengths: Float[np.ndarray, "ways"] | None
    "The length of each way, in metres, or `None` if edges have no lengths and no positions."
    xy: Float[np.ndarray, "vertices 2"] | None
    omitted: tuple[str, ...]
    "Sentences about edges of the file that are left out."


def load_graph(
    path: str | os.PathLike[str] | Any, weight: str | None = None
) -> tuple[Graph, tuple[str, ...]]:
    """Read a graph file, or number the vertices of a graph of networkx.

    Loops are left out, and of parallel edges all but the shortest, which a `Doubt` says. A directed
    graph is read if each way has a way back of the same length.

    **Arguments:** the graph, or the file, of at most 64 MiB. Its suffix gives the format: `.json`
    is node-link JSON, `.graphml` GraphML, `.gml` GML, `.adjlist` an adjacency list, `.graph` a
    patrolling_sim graph, and `.edges` or `.txt` a list in which `name x y` is a vertex and
    `name name` an edge. `weight` is the name of the
        attribute of edges that is their length, by default `length`; in a list with it, a line of
        three words is an edge and its length.

    **Returns:** the graph, and the names of its vertices in the order of their numbers.

    The graph of section 4.5.2 of Alam 2018:

        >>> from jaxcell import bundled, patrol
        >>> graph, names = patrol.load_graph(bundled("graphs/eight.json"))
        >>> graph.vertices, len(graph.edges), names[:2], graph.xy[0].tolist()
        (8, 13, ('1', '2'), [1.0, 3.0])
    """
    if hasattr(path, "geom_type"):
        raise ValueError(f"file: a {path.geom_type} is a room, not a graph; use study.PatrolMap")
    if not isinstance(path, str | os.PathLike):
        graph = path if isinstance(path, Graph) else Graph(path)
        return graph, tuple(map(str, range(graph.vertices) if path is graph else numbered(path)))
    path = Path(with_path(os.fspath(path)))
    vertices, edges, directed = parsed(path, weight)
    with about(path):
        _, _, places, lengths = parts = checked_parts(vertices, edges)
        doubt_attributes(str(path), edges, places is not None, bool(directed))
        ways = _simple_ways(*parts, directed)
        for omitted in ways.omitted:
            warn(f"{path}: {omitted}", Doubt)
        return _undirected(ways, lengths is not None, directed), ways.names


def _undirected(ways: Ways, measured: bool, directed: str) -> Graph:
    """Join each way and its way back to one edge; raise if a way back is missing or differs."""
    key, back = ways.ends @ [len(ways.names), 1], ways.ends @ [1, len(ways.names)]
    order = np.argsort(key)
    at = order[np.searchsorted(key, back, sorter=order).clip(max=key.size - 1)]
    if count := int((key[at] != back).sum()):
        why = f"{count:,} of its {key.size:,} ways have no way back"
        raise ValueError(f"{directed}: {why}; {_DIRECTED}")
    if ways.lengths is not None and (ways.lengths[at] != ways.lengths).any():
        raise ValueError(f"{directed}: ways back have other lengths; {_DIRECTED}")
    first = np.flatnonzero(np.arange(key.size) < at)
    lengths = ways.lengths[first] if measured and ways.lengths is not None else None
    return Graph(ways.ends[first], len(ways.names), ways.xy, lengths)


def load_ways(
    path: str | os.PathLike[str] | Any, weight: str | None = None, directed: bool = False
) -> Ways:
    """Read a graph file, or a graph of networkx, whose edges may be directed, parallel, or loops.

    **Arguments:** the graph, or the file, as in [`load_graph`][]. An undirected edge becomes two
    ways, unless all edges of the file are `directed`. Loops are left out, because a robot can
    always wait; of parallel edges, the shortest is used.
    **Returns:** `Ways`.

    A street of 50 m one way and 80 m back:

        >>> import networkx as nx
        >>> from jaxcell import patrol
        >>> streets = nx.DiGraph()
        >>> streets.add_edge("gate", "yard", length=50.0)
        >>> streets.add_edge("yard", "gate", length=80.0)
        >>> ways = patrol.files.load_ways(streets)
        >>> ways.names, ways.ends.tolist(), ways.lengths.tolist()
        (('gate', 'yard'), [[0, 1], [1, 0]], [50.0, 80.0])
    """
    if isinstance(path, Graph):
        both = np.concatenate([path.edges, path.edges[:, ::-1]])
        measured = path.ways is not None or path.xy is not None
        lengths = np.tile(path.lengths, 2) if measured else None
        return Ways(tuple(map(str, range(path.vertices))), both, lengths, path.xy, ())
    if hasattr(path, "is_multigraph"):
        name, (vertices, edges, one_way) = "graph", of_networkx(path, weight or "length")
    else:
        name = with_path(os.fspath(path))
        vertices, edges, one_way = parsed(Path(name), weight)
    with about(name):
        parts = checked_parts(vertices, edges)
        doubt_attributes(name, edges, parts[2] is not None, directed or bool(one_way))
        return _simple_ways(*parts, one_way or "directed" * directed)


def _check_metres(xy: Float[np.ndarray, "vertices 2"], lengths: Float[np.ndarray, "_"]) -> None:
    """Raise if positions, which determine lengths, are more likely degrees than metres."""
    longest = lengths.max()
    if 0 < longest < _SHORT and _in_degrees(xy):
        raise ValueError(
            f"x, y: expected metres, but the longest edge has {longest:.3g}; if x and "
            "y are degrees, name them lon and lat, or set crs of the graph to EPSG:4326; "
            "otherwise give the edges their lengths in metres"
        )


def _simple_ways(
    numbers: dict[str, int],
    pairs: Int[np.ndarray, "edges 2"],
    places: Float[np.ndarray, "vertices 2"] | None,
    lengths: Float[np.ndarray, "edges"] | None,
    directed: str,
) -> Ways:
    """Make ways of checked edges, without loops and parallel ways."""
    if lengths is None and places is not None:
        lengths = np.hypot(*(places[pairs[:, 0]] - places[pairs[:, 1]]).T)
        _check_metres(places, lengths)
    measured = lengths is not None
    lengths = np.ones(len(pairs)) if lengths is None else lengths
    if not directed:
        pairs, lengths = np.concatenate([pairs, pairs[:, ::-1]]), np.tile(lengths, 2)
    loop = pairs[:, 0] == pairs[:, 1]
    order = np.flatnonzero(~loop)[np.argsort(lengths[~loop], kind="stable")]
    _, first = np.unique(pairs[order] @ [len(numbers), 1], return_index=True)
    kept, sides = np.sort(order[first]), 1 if directed else 2
    omitted = about_omitted(int(loop.sum()) // sides, (int((~loop).sum()) - kept.size) // sides)
    return Ways(tuple(numbers), pairs[kept], lengths[kept] if measured else None, places, omitted)


def about_omitted(loops: int, parallel: int) -> tuple[str, ...]:
    """Say how many loops and parallel edges are left out, if any."""
    counts = (
        (loops, "loop", "a robot can wait at a vertex"),
        (parallel, "parallel edge", "the shortest of them is used"),
    )
    return tuple(
        f"{count:,} {what}{' is' if count == 1 else 's are'} left out: {why}"
        for count, what, why in counts
        if count
    )


def checked_parts(
    vertices: list[Vertex], edges: list[Edge]
) -> tuple[
    dict[str, int],
    Int[np.ndarray, "edges 2"],
    Float[np.ndarray, "vertices 2"] | None,
    Float[np.ndarray, "edges"] | None,
]:
    """Return the number of each vertex by its name, the ends of edges, positions and lengths."""
    numbers: dict[str, int] = {}
    xy, geographic = [], []
    for field, name, attributes in vertices:
        if type(name) not in (str, int) or not str(name).strip() or not str(name).isprintable():
            raise refused(field, "a name, printable text or a number", name)
        if str(name) in numbers:
            raise ValueError(f"{field}: the vertex {reprlib.repr(name)} comes twice")
        numbers[str(name)] = len(numbers)
        in_plane = {"x", "y", "pos"} & attributes.keys()
        on_earth = None if in_plane else degrees(attributes)
        xy.append(_position(field, attributes, on_earth) if in_plane or on_earth else None)
        geographic.append(on_earth is not None)
    placed = [place is not None for place in xy]
    for have, what in ((geographic, "longitude and latitude"), (placed, "position x, y")):
        if any(have) and not all(have):
            field = vertices[have.index(False)].field
            raise ValueError(f"{field}: it has no {what}, but other vertices have")
    if len(numbers) < 2:
        raise ValueError(f"expected at least 2 vertices, got {len(numbers)}")
    if not edges:
        raise ValueError("it has no edges")
    for field, *ends in (edge[:3] for edge in edges):
        for name in ends:
            if str(name) not in numbers:
                raise ValueError(f"{field}: there is no vertex {reprlib.repr(name)}")
    pairs = np.array([[numbers[str(edge.tail)], numbers[str(edge.head)]] for edge in edges])
    places, lengths = None if None in xy else np.array(xy, float), _lengths(edges)
    if places is not None and all(geographic):
        lengths = great_circles(places, pairs) if lengths is None else lengths
        places = in_metres(places)
    elif places is not None and lengths is not None and _in_degrees(places):
        straight = np.hypot(*(places[pairs[:, 0]] - places[pairs[:, 1]]).T)
        if lengths.sum() > _MUCH_LONGER * straight.sum() > 0:
            warn("x and y are taken as degrees, because edges are 10,000 times as long", Doubt)
            places = in_metres(places)
    return numbers, pairs, places, lengths


def _in_degrees(xy: Float[np.ndarray, "vertices 2"]) -> bool:
    """Check whether positions may be degrees. Layouts in a unit square have small numbers, too."""
    return bool((np.abs(xy) <= [180, 90]).all() and np.abs(xy).max() > 1)


def _lengths(edges: list[Edge]) -> np.ndarray | None:
    missing = [edge.field for edge in edges if edge.length is None]
    if len(missing) == len(edges):
        return None
    if missing:
        raise ValueError(f"{missing[0]}: it has no length, but other edges have")
    expected = f"a positive number of at most {MAX_NUMBER:g} m"
    lengths = [checked_number(f"{e.field}.length", e.length, expected, text=True) for e in edges]
    for edge, length in zip(edges, lengths, strict=True):
        if length <= 0:
            raise refused(f"{edge.field}.length", expected, edge.length)
    return np.array(lengths)


def _position(
    field: str, attributes: Mapping[str, Any], on_earth: tuple[Any, Any] | None
) -> tuple[float, float]:
    """Check a position: the longitude and latitude `on_earth`, or x and y among `attributes`."""
    limits: tuple[float, float] = MAX_NUMBER, MAX_NUMBER
    if on_earth is not None:
        limits = 360.0, 90.0
        both = [(f"{field}.{axis}", on_earth[k]) for k, axis in enumerate(("lon", "lat"))]
    elif "x" in attributes or "y" in attributes or "pos" not in attributes:
        fields = Fields(attributes, f"{field}.")
        both = [(f"{field}.{axis}", fields.needed(axis)) for axis in "xy"]
    else:
        pair = checked_pair(f"{field}.pos", attributes["pos"])
        both = [(f"{field}.pos[{i}]", value) for i, value in enumerate(pair)]
    # GraphML and lists store numbers as text.
    unit = "m" if on_earth is None else "degrees"
    x, y = (
        checked_number(*value, f"a finite number of at most {most:g} {unit}", most=most, text=True)
        for value, most in zip(both, limits, strict=True)
    )
    return x, y
