"""Parsers of the formats of graph files, whose vertices and edges are not yet checked."""

import functools
import reprlib
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias
from xml.etree.ElementTree import ParseError

import numpy as np

from ...base.documents import (
    Fields,
    about,
    check_file,
    checked_list,
    checked_number,
    decode_json,
    read_text,
    refused,
)
from ...base.doubts import Doubt, warn
from ...optimize.geographic import positioned
from ...optimize.graph import UNREAD


LIST_SUFFIXES = (".edges", ".txt")
SUFFIXES = (
    ".json (node-link), .geojson (routes), .graphml, .gml, .adjlist, .graph, .edges or .txt (edge "
    "list)"
)
_NETWORKX = (".graphml", ".gml", ".adjlist")
# Members of an edge in JSON that are no attributes.
_ENDS = {"source", "target", "id", "key"}
# Values of the attribute `oneway` of a street that leads one way.
_ONE_WAY = ("true", "yes", "1", "-1")
# Errors of networkx for damaged files, besides its own.
_FAULTS = (LookupError, TypeError, ValueError, AttributeError, RecursionError, ParseError)
_MAX_BYTES = 64 * 1024**2


class Vertex(NamedTuple):
    """A vertex as read from a file, not yet checked; `field` is its place there, for errors."""

    field: str
    name: object
    attributes: Mapping[str, Any]


class Edge(NamedTuple):
    """An edge as read from a file, not yet checked; `field` is its place there, for errors."""

    field: str
    tail: object
    head: object
    length: object = None
    attributes: Mapping[str, Any] = {}


Parts: TypeAlias = tuple[list[Vertex], list[Edge], str]
"""Vertices, edges, and the field of the file that makes the graph directed, or an empty text."""


def parsed(path: Path, weight: str | None = None) -> Parts:
    """Parse a file. The text is the field that makes the graph directed, or empty.

    `weight` names the attribute of edges that is their length, by default `length`.
    """
    check_file(path, "a graph")
    suffix = path.suffix.lower()
    length = weight or "length"
    parsers: dict[str, Callable[[str], Parts]] = {
        ".json": functools.partial(_parse_json, length),
        ".geojson": functools.partial(_parse_routes, length),
        ".graph": _parse_simulator,
        **dict.fromkeys(LIST_SUFFIXES, functools.partial(_parse_list, weight)),
        **{name: functools.partial(_parse_networkx, name, length) for name in _NETWORKX},
    }
    with about(path):
        if suffix not in parsers:
            raise ValueError(f"unknown format {suffix!r}; expected {SUFFIXES}")
        parts = parsers[suffix](_text(path))
        if weight is not None and all(edge.length is None for edge in parts[1]):
            known = sorted({str(name) for edge in parts[1] for name in edge.attributes})
            attributes = ", ".join(known) or "no attributes"
            raise ValueError(f"`weight`: no edge has {weight!r}; they have {attributes}")
        return parts


def doubt_attributes(name: str, edges: list[Edge], placed: bool, directed: bool) -> None:
    """Doubt attributes of edges that are not read: other lengths, and `oneway` if undirected."""
    every = [edge.attributes for edge in edges]
    unread = UNREAD.intersection(*every) if every else ()
    if unread and all(edge.length is None for edge in edges):
        length = "the distance of its ends" if placed else "unknown, and it takes one step"
        no_length = f"edges have no attribute length, so that of each is {length}"
        use = " or ".join(f'`weight="{other}"`' for other in sorted(unread))
        warn(f"{name}: {no_length}; to read another attribute as length, set {use}", Doubt)
    count = sum(str(about.get("oneway")).lower() in _ONE_WAY for about in every)
    if count and not directed:
        marked = f"{count:,} of {len(every):,} edges of an undirected graph are marked oneway"
        way_on = "if all are one-way, set `directed`; otherwise save a directed graph"
        warn(f"{name}: {marked}, but lead both ways; {way_on}", Doubt)


def _parse_routes(weight: str, text: str) -> Parts:
    """Parse a route graph of nav2: points with an id, and lines from `startid` to `endid`."""
    vertices: list[Vertex] = []
    edges: list[Edge] = []
    document = decode_json(text, "a graph")
    if not isinstance(document, dict):
        raise ValueError(f"expected an object with features, got {reprlib.repr(document)}")
    for i, feature in enumerate(Fields(document).parts("features")):
        field, about = f"features[{i}]", _part(feature, "properties")
        if "startid" in about.values:
            ends = str(about.needed("startid")), str(about.needed("endid"))
            edges.append(Edge(field, *ends, about.get(weight), about.values))
        else:
            place = _part(feature, "geometry").needed("coordinates")
            at = place[:2] if isinstance(place, list) else place
            vertices.append(Vertex(field, str(about.needed("id")), {"pos": at}))
    return vertices, edges, "startid"


def _part(fields: Fields, name: str) -> Fields:
    """Return the object with this name, as fields."""
    value = fields.needed(name)
    if not isinstance(value, dict):
        raise fields.refused(name, "an object")
    return Fields(value, f"{fields.where}{name}.")


def _parse_problem(problem: Fields) -> Parts:
    """Parse a problem of RoSSO (John et al. 2023), whose `weight_matrix` has times of edges."""
    rows = checked_list("weight_matrix", problem.needed("weight_matrix"))
    unused = [name for name in ("stationary_distribution", "tau") if problem.get(name) is not None]
    if unused:
        warn(f"of the problem, {' and '.join(unused)} are not used; give `attack_time`", Doubt)
    edges = [
        Edge(f"weight_matrix[{i}][{j}]", str(i), str(j), time)
        for i, row in enumerate(rows)
        for j, time in enumerate(checked_list(f"weight_matrix[{i}]", row))
        if i != j and time != 0
    ]
    vertices = [Vertex(f"weight_matrix[{i}]", str(i), {}) for i in range(len(rows))]
    return vertices, edges, "weight_matrix"


def _parse_json(weight: str, text: str) -> Parts:
    document = decode_json(text, "a graph")
    if not isinstance(document, dict):
        raise ValueError(f"expected an object with nodes and edges, got {reprlib.repr(document)}")
    if document.get("format") == "jaxcell-map":
        raise ValueError("it is a map, not a graph; study.PatrolMap takes it")
    if "problem_params" in document:
        return _parse_problem(_part(Fields(document), "problem_params"))
    # networkx until version 3.4, and D3, call the edges "links".
    key = "edges" if "edges" in document else "links"
    fields, about = Fields(document), document.get("graph")
    crs = about.get("crs") if isinstance(about, dict) else None
    vertices = [
        Vertex(f"nodes[{i}]", node.needed("id"), positioned(node.values, crs))
        for i, node in enumerate(fields.parts("nodes"))
    ]
    edges = []
    for i, edge in enumerate(fields.parts(key)):
        about = {name: edge.values[name] for name in edge.values.keys() - _ENDS}
        ends = edge.needed("source"), edge.needed("target")
        edges.append(Edge(f"{key}[{i}]", *ends, edge.get(weight), about))
    return vertices, edges, "directed" if document.get("directed") else ""


def _parse_networkx(suffix: str, weight: str, text: str) -> Parts:
    import networkx as nx

    lines = text.splitlines()
    if suffix == ".graphml" and "<!DOCTYPE" in text:
        raise ValueError(
            "it has a document type (<!DOCTYPE ...>), which GraphML does without and whose "
            "entities can grow without bounds; expected none"
        )
    try:
        with warnings.catch_warnings(action="ignore"):  # about ports and types
            graph = {
                ".graphml": lambda: nx.parse_graphml(text, force_multigraph=True),
                ".gml": lambda: nx.parse_gml(lines),
                ".adjlist": lambda: nx.parse_adjlist(lines),
            }[suffix]()
    except (nx.NetworkXError, *_FAULTS) as error:
        raise ValueError(f"not {suffix} that networkx reads: {str(error)[:300]}") from None
    vertices, edges, directed = of_networkx(graph, weight)
    return vertices, edges, "edgedefault" if directed and suffix == ".graphml" else directed


def of_networkx(graph: Any, weight: str = "length") -> Parts:
    """Return the parts of a graph of networkx, whose numbers may be those of NumPy."""

    def plain(value: Any) -> Any:
        if isinstance(value, list | tuple | np.ndarray):
            return [plain(each) for each in value]
        return value.item() if isinstance(value, np.generic) else value

    crs, vertices = graph.graph.get("crs"), []
    for name, members in graph.nodes(data=True):
        about = positioned({key: plain(value) for key, value in members.items()}, crs)
        vertices.append(Vertex(f"node {name!r}", str(name), about))
    edges = [
        Edge(f"edge {tail!r} to {head!r}", str(tail), str(head), plain(known.get(weight)), known)
        for tail, head, known in graph.edges(data=True)
    ]
    return vertices, edges, "directed" if graph.is_directed() else ""


def _parse_simulator(text: str) -> Parts:
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
                got = f"from vertex {name} to {other} it is {length:g} m, and {back:g} m back"
                raise ValueError(f"{place}: {got}; expected equal lengths in both directions")
    if at < len(words):
        raise ValueError(f"word {at + 1}: {words[at]!r} comes after the last of {total} vertices")
    return vertices, edges, ""


def _parse_list(weight: str | None, text: str) -> Parts:
    vertices: list[Vertex] = []
    edges: list[Edge] = []
    for number, line in enumerate(text.splitlines(), 1):
        field, words = f"line {number}", line.partition("#")[0].partition("%")[0].split()
        # networkx writes an edge without attributes as `name name {}`.
        if len(words) == 3 and words[2] == "{}":
            words.pop()
        if weight is not None and len(words) > 2:
            edges.append(Edge(field, words[0], words[1], words[2]))
        elif len(words) == 3:
            name, x, y = words
            vertices.append(Vertex(field, name, {"x": x, "y": y}))
        elif len(words) == 2:
            edges.append(Edge(field, words[0], words[1]))
        elif words:
            expected = "a vertex (name x y) or an edge (name name), words with spaces between"
            raise refused(field, expected, line.strip())
    if vertices and not edges:
        why = "it has no edges: a line of three words is a vertex, name x y"
        raise ValueError(f"{why}; if it is an edge with its length, set `weight`")
    if not vertices:
        ends = {name: edge.field for edge in edges for name in (edge.tail, edge.head)}
        vertices = [Vertex(field, name, {}) for name, field in ends.items()]
    return vertices, edges, ""


def _text(path: Path) -> str:
    size = path.stat().st_size
    if size > _MAX_BYTES:
        raise ValueError(f"it has {size:,} bytes; expected a graph of at most {_MAX_BYTES:,}")
    return read_text(path)
