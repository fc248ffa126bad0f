"""Readers of graph files: node-link JSON, GraphML, GML, patrolling_sim graphs, and lists.

Every vertex has a name, and either all vertices have a position or none has. Edges join two
different vertices. For a `Graph` they are undirected, and no two edges are parallel; `load_ways`
also reads directed edges, keeps the shortest of parallel edges, and leaves out loops. Either all
edges have a `length` in metres, or all edges are straight. Other attributes in a file are ignored.

Positions are in metres, or in degrees if they are named `lon` and `lat` (or `longitude` and
`latitude`), or if the attribute `crs` of the graph is geographic, such as `EPSG:4326`. Degrees are
converted to metres East and North of the middle, and edges without a length follow great circles.

**Node-link JSON** (`.json`) is an object with two lists. Each member of `nodes` has an `id`, and
either `x` and `y` or a pair `pos`; each member of `edges` (or `links`) has a `source` and a
`target`. In **GraphML** (`.graphml`) and **GML** (`.gml`) the vertices have attributes `x` and `y`.
A **patrolling_sim graph** (`.graph`) is a file of that ROS simulator. An **adjacency list**
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

import contextlib
import functools
import os
import re
import reprlib
import warnings
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree.ElementTree import ParseError

import numpy as np
from jaxtyping import Float, Int

from ...base.bundled import with_path
from ...base.documents import (
    MAX_NUMBER,
    Fields,
    check_file,
    checked_number,
    checked_pair,
    decode_json,
    read_text,
    refused,
)
from ...optimize import Graph
from ...optimize.geographic import degrees, great_circles, in_metres, positioned
from ...optimize.graph import numbered


LIST_SUFFIXES = (".edges", ".txt")
SUFFIXES = ".json (node-link), .graphml, .gml, .adjlist, .graph, .edges or .txt (edge list)"
_NETWORKX = (".graphml", ".gml", ".adjlist")
_WEIGHT = re.compile(r"""["\s]weight["\s]""")
# Errors of networkx for damaged files, besides its own.
_FAULTS = (LookupError, TypeError, ValueError, AttributeError, RecursionError, ParseError)
_MAX_BYTES = 64 * 1024**2
# Edges that are all shorter, in metres, are rather differences of degrees.
_SHORT = 0.1
_DIRECTED = (
    "it is directed; expected an undirected graph, whose edges a patroller can walk both ways: "
    "give each pair of neighbours once; rounds on one-way edges are found by `jaxcell patrol guard`"
)


class Vertex(NamedTuple):
    """A vertex as read from a file, not yet checked; `field` is its place there, for errors."""

    field: str
    name: object
    attributes: Mapping[str, Any]


class Ways(NamedTuple):
    """A directed graph: each way leads from the first of two vertices to the second."""

    names: tuple[str, ...]
    ends: Int[np.ndarray, "ways 2"]
    lengths: Float[np.ndarray, "ways"] | None
    "The length of each way, in metres, or `None` if edges have no lengths and no positions."
    xy: Float[np.ndarray, "vertices 2"] | None
    omitted: tuple[str, ...]
    "Sentences about edges of the file that are left out."


class Edge(NamedTuple):
    """An edge as read from a file, not yet checked; `field` is its place there, for errors."""

    field: str
    tail: object
    head: object
    length: object = None


def load_graph(path: str | os.PathLike[str] | Any) -> tuple[Graph, tuple[str, ...]]:
    """Read a graph file, or number the vertices of a graph of networkx.

    **Arguments:** the graph, or the file, of at most 64 MiB. Its suffix gives the format: `.json`
    is node-link JSON, `.graphml` GraphML, `.gml` GML, `.adjlist` an adjacency list, `.graph` a
    patrolling_sim graph, and `.edges` or `.txt` a list in which `name x y` is a vertex and
    `name name` an edge.

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
    vertices, edges, directed = _parsed(path)
    with about_file(path):
        if directed:
            raise ValueError(f"{directed}: {_DIRECTED}")
        graph, names = checked_graph(vertices, edges)
        if graph.ways is None and graph.xy is not None:
            _check_metres(graph.xy, graph.lengths)
    return graph, names


def load_ways(path: str | os.PathLike[str] | Any) -> Ways:
    """Read a graph file, or a graph of networkx, whose edges may be directed, parallel, or loops.

    **Arguments:** the graph, or the file, as in [`load_graph`][]. An undirected edge becomes two
    ways. Loops are left out, because a robot can always wait; of parallel edges, the shortest is
    used.
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
        return _checked_ways(*_of_networkx(path))
    path = Path(with_path(os.fspath(path)))
    parts = _parsed(path)
    with about_file(path):
        return _checked_ways(*parts)


@contextlib.contextmanager
def about_file(path: Path) -> Iterator[None]:
    """Put the name of a file before the message of a `ValueError`."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def _parsed(path: Path) -> tuple[list[Vertex], list[Edge], str]:
    """Parse a file. The text is the field that makes the graph directed, or empty."""
    check_file(path, "a graph")
    suffix = path.suffix.lower()
    parsers: dict[str, Callable[[str], tuple[list[Vertex], list[Edge], str]]] = {
        ".json": _parse_json,
        ".graph": _parse_simulator,
        **dict.fromkeys(LIST_SUFFIXES, _parse_list),
        **{name: functools.partial(_parse_networkx, name) for name in _NETWORKX},
    }
    with about_file(path):
        if suffix not in parsers:
            raise ValueError(f"unknown format {suffix!r}; expected {SUFFIXES}")
        return parsers[suffix](_text(path))


def _check_metres(xy: Float[np.ndarray, "vertices 2"], lengths: Float[np.ndarray, "_"]) -> None:
    """Raise if positions, which determine lengths, are more likely degrees than metres."""
    longest = lengths.max()
    # Layouts in a unit square have short edges, too.
    degrees_alike = (np.abs(xy) <= [180, 90]).all() and np.abs(xy).max() > 1
    if 0 < longest < _SHORT and degrees_alike:
        raise ValueError(
            f"x, y: expected metres, but the longest edge has {longest:.3g}; if x and "
            "y are degrees, name them lon and lat, or set crs of the graph to EPSG:4326; "
            "otherwise give the edges their lengths in metres"
        )


def _parse_json(text: str) -> tuple[list[Vertex], list[Edge], str]:
    document = decode_json(text, "a graph")
    if not isinstance(document, dict):
        raise ValueError(f"expected an object with nodes and edges, got {reprlib.repr(document)}")
    if document.get("format") == "jaxcell-map":
        raise ValueError("it is a map, not a graph; study.PatrolMap takes it")
    # networkx until version 3.4, and D3, call the edges "links".
    key = "edges" if "edges" in document else "links"
    fields, about = Fields(document), document.get("graph")
    crs = about.get("crs") if isinstance(about, dict) else None
    return (
        [
            Vertex(f"nodes[{i}]", node.needed("id"), positioned(node.values, crs))
            for i, node in enumerate(fields.parts("nodes"))
        ],
        [
            Edge(f"{key}[{i}]", edge.needed("source"), edge.needed("target"), edge.get("length"))
            for i, edge in enumerate(fields.parts(key))
        ],
        "directed" if document.get("directed") else "",
    )


def _parse_networkx(suffix: str, text: str) -> tuple[list[Vertex], list[Edge], str]:
    import networkx as nx

    lines = text.splitlines()
    if suffix == ".graphml" and "<!DOCTYPE" in text:
        raise ValueError(
            "it has a document type (<!DOCTYPE ...>), which GraphML does without and whose "
            "entities can grow without bounds; expected none"
        )
    try:
        with warnings.catch_warnings():
            # Warnings about ports and types are ignored.
            warnings.simplefilter("ignore")
            graph = {
                ".graphml": lambda: nx.parse_graphml(text, force_multigraph=True),
                ".gml": lambda: nx.parse_gml(lines),
                ".adjlist": lambda: nx.parse_adjlist(lines),
            }[suffix]()
    except (nx.NetworkXError, *_FAULTS) as error:
        raise ValueError(f"not {suffix} that networkx reads: {str(error)[:300]}") from None
    vertices, edges, directed = _of_networkx(graph)
    return vertices, edges, "edgedefault" if directed and suffix == ".graphml" else directed


def _of_networkx(graph: Any) -> tuple[list[Vertex], list[Edge], str]:
    """Return the parts of a graph of networkx, whose numbers may be those of NumPy."""

    def plain(value: Any) -> Any:
        if isinstance(value, list | tuple | np.ndarray):
            return [plain(each) for each in value]
        return value.item() if isinstance(value, np.generic) else value

    crs = graph.graph.get("crs")
    return (
        [
            Vertex(
                f"node {name!r}",
                str(name),
                positioned({key: plain(value) for key, value in members.items()}, crs),
            )
            for name, members in graph.nodes(data=True)
        ],
        [
            Edge(f"edge {tail!r} to {head!r}", str(tail), str(head), plain(length))
            for tail, head, length in graph.edges(data="length")
        ],
        "directed" if graph.is_directed() else "",
    )


def _parse_simulator(text: str) -> tuple[list[Vertex], list[Edge], str]:
    """Parse a graph of patrolling_sim, the ROS simulator of patrols (Portugal and Rocha).

    The file begins with the number of vertices, the width and height of the picture, metres per
    pixel, and the offset of the origin. Each vertex has a number, two coordinates in pixels, the
    count of its neighbours, and for each neighbour its number, a direction (N, SE, ...) and the
    length of the path in pixels.
    """
    words = text.split()
    at = 0

    def number(what: str) -> float:
        nonlocal at
        at += 1
        if at > len(words):
            raise ValueError(f"it ends after {len(words)} words; expected more; is it truncated?")
        return checked_number(f"word {at}", words[at - 1], what, text=True)

    def count(what: str) -> int:
        value = number(what)
        if value < 0 or value % 1:
            raise refused(f"word {at}", what, words[at - 1])
        return int(value)

    total = count("the number of vertices")
    for _ in range(2):
        number("a size in pixels")
    scale = number("the metres per pixel")
    if scale <= 0:
        raise refused(f"word {at}", "more than 0 metres per pixel", words[at - 1])
    right, up = number("an offset in metres"), number("an offset in metres")
    vertices: list[Vertex] = []
    edges: list[Edge] = []
    lengths: dict[frozenset[str], float] = {}
    for _ in range(total):
        name, field = str(count("the number of a vertex")), f"word {at}"
        x, y = number("a coordinate in pixels"), number("a coordinate in pixels")
        vertices.append(Vertex(field, name, {"x": x * scale + right, "y": y * scale + up}))
        for _ in range(count("the number of neighbours")):
            other, place = str(count("the number of a neighbour")), f"word {at}"
            at += 1  # The direction.
            length = number("the length of a path in pixels") * scale
            ends = frozenset((name, other))
            if ends not in lengths:
                edges.append(Edge(place, name, other, length))
            back = lengths.setdefault(ends, length)
            if back != length:
                raise ValueError(
                    f"{place}: from vertex {name} to {other} it is {length:g} m, and "
                    f"{back:g} m back; expected equal lengths in both directions"
                )
    if at < len(words):
        raise ValueError(f"word {at + 1}: {words[at]!r} comes after the last of {total} vertices")
    return vertices, edges, ""


def has_weights(path: str | os.PathLike[str] | Any) -> bool:
    """Check whether the edges of a graph file have weights, which [`load_graph`][] does not read.

    The result is `False` for formats without weights, and for a graph that is not a file.

    The graph of section 4.5.2 of Alam 2018 has no weights:

        >>> from jaxcell import bundled, patrol
        >>> patrol.files.has_weights(bundled("graphs/eight.json"))
        False
    """
    if not isinstance(path, str | os.PathLike):
        return False
    return Path(path).suffix.lower() not in (*LIST_SUFFIXES, ".adjlist", ".graph") and bool(
        _WEIGHT.search(_text(Path(path)))
    )


def _parse_list(text: str) -> tuple[list[Vertex], list[Edge], str]:
    vertices: list[Vertex] = []
    edges: list[Edge] = []
    for number, line in enumerate(text.splitlines(), 1):
        field, words = f"line {number}", line.partition("#")[0].split()
        # networkx writes an edge without attributes as `name name {}`.
        if len(words) == 3 and words[2] == "{}":
            words.pop()
        if len(words) == 3:
            name, x, y = words
            vertices.append(Vertex(field, name, {"x": x, "y": y}))
        elif len(words) == 2:
            edges.append(Edge(field, *words))
        elif words:
            raise refused(field, "a vertex (name x y) or an edge (name name)", line.strip())
    if not vertices:
        ends = {name: edge.field for edge in edges for name in (edge.tail, edge.head)}
        vertices = [Vertex(field, name, {}) for name, field in ends.items()]
    return vertices, edges, ""


def checked_graph(vertices: list[Vertex], edges: list[Edge]) -> tuple[Graph, tuple[str, ...]]:
    """Check the vertices and edges of a file, and return the graph with the names of vertices."""
    numbers, pairs, places, lengths = _checked_parts(vertices, edges)
    before: dict[tuple[int, int], str] = {}
    for field, *ends, _ in edges:
        tail, head = sorted(numbers[str(name)] for name in ends)
        joined = " and ".join(map(reprlib.repr, ends))
        if tail == head:
            raise ValueError(f"{field}: it is a loop, which joins {joined}; expected two vertices")
        if (tail, head) in before:
            first = before[tail, head]
            raise ValueError(
                f"{field}: it joins {joined}, as {first} does; expected no parallel edges"
            )
        before[tail, head] = field
    return Graph(pairs, len(numbers), places, lengths), tuple(numbers)


def _checked_ways(vertices: list[Vertex], edges: list[Edge], directed: str) -> Ways:
    numbers, pairs, places, lengths = _checked_parts(vertices, edges)
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


def _checked_parts(
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
    if any(geographic) and not all(geographic):
        field = vertices[geographic.index(False)].field
        raise ValueError(f"{field}: it has no longitude and latitude, but other vertices have")
    if None in xy and any(place is not None for place in xy):
        field = vertices[xy.index(None)].field
        raise ValueError(f"{field}: it has no position x, y, but other vertices have")
    if len(numbers) < 2:
        raise ValueError(f"expected at least 2 vertices, got {len(numbers)}")
    if not edges:
        raise ValueError("it has no edges")
    for field, *ends, _ in edges:
        for name in ends:
            if str(name) not in numbers:
                raise ValueError(f"{field}: there is no vertex {reprlib.repr(name)}")
    pairs = np.array([[numbers[str(edge.tail)], numbers[str(edge.head)]] for edge in edges])
    places, lengths = None if None in xy else np.array(xy, float), _lengths(edges)
    if places is not None and all(geographic):
        lengths = great_circles(places, pairs) if lengths is None else lengths
        places = in_metres(places)
    return numbers, pairs, places, lengths


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


def _text(path: Path) -> str:
    size = path.stat().st_size
    if size > _MAX_BYTES:
        raise ValueError(f"it has {size:,} bytes; expected a graph of at most {_MAX_BYTES:,}")
    return read_text(path)
