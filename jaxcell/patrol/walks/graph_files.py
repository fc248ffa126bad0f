"""Graph files: networkx's node-link JSON, GraphML, and our own lists of vertices and edges.

Every vertex has a name, and either all have a position or none has. Every edge joins two different
vertices, once, and can be walked both ways. Other attributes in a file are ignored.

**Node-link JSON** (`.json`) is an object with a list `nodes`, whose members have an `id` and `x`
and `y`, or a pair `pos`; and a list `edges` (or `links`), whose members have a `source` and a
`target`. In **GraphML** (`.graphml`) and **GML** (`.gml`) the vertices have attributes `x` and `y`.
An **adjacency list** (`.adjlist`) has a line for each vertex, its name and those of neighbours. An
**edge list** (`.edges`, `.txt`) is text; `#` begins a comment:

```
# A line of three is a vertex and its position in metres.
hall 0 0
yard 3.5 1
# A line of two is an edge.
hall yard
```
"""

import json
import os
import re
import reprlib
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, NoReturn
from xml.etree.ElementTree import ParseError
from xml.parsers import expat

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
from ...base.files import replacing
from ...optimize import Graph


_LIST_SUFFIXES = (".edges", ".txt")
_SUFFIXES = ".json (node-link), .graphml, .gml, .adjlist, .edges or .txt (edge list)"
_WEIGHT = re.compile(r"""["\s]weight["\s]""")
_MAX_BYTES = 64 * 1024**2
_DIRECTED = (
    "it is directed; expected an undirected graph, whose edges a patroller can walk both ways: "
    "give each pair of neighbours once"
)


class _Vertex(NamedTuple):
    """A vertex of a file, not yet checked."""

    field: str
    name: object
    attributes: Mapping[str, Any]


class _Edge(NamedTuple):
    """An edge of a file, not yet checked."""

    field: str
    tail: object
    head: object


def load_graph(path: str | os.PathLike[str]) -> tuple[Graph, tuple[str, ...]]:
    """Read a graph file.

    **Arguments:**

    - `path`: the file, of at most 64 MiB. Its suffix says the format: `.json` is node-link JSON,
        `.graphml` is GraphML, `.gml` GML, `.adjlist` an adjacency list, and `.edges` or `.txt` a
        list in which `name x y` is a vertex and `name name` an edge.

    **Returns:** the graph, and the names of its vertices, which it numbers in the order of the
    file.

    **Raises:** `ValueError` that names the file, the field, and what is wrong: text that is cut
    short or in another format, a directed graph, a loop, parallel edges, a vertex that is named
    twice or by an edge alone, or one without two finite coordinates where others have them;
    `FileNotFoundError`.

    The graph of section 4.5.2 of Alam 2018:

        >>> from jaxcell import bundled, patrol
        >>> graph, names = patrol.load_graph(bundled("graphs/eight.json"))
        >>> graph.vertices, len(graph.edges), names[:2], graph.xy[0].tolist()
        (8, 13, ('1', '2'), [1.0, 3.0])
    """
    path = Path(path)
    check_file(path, "a graph")
    suffix = path.suffix.lower()
    try:
        if suffix == ".json":
            found = _parse_json(_text(path))
        elif suffix == ".graphml":
            found = _parse_graphml(_text(path))
        elif suffix in (".gml", ".adjlist"):
            found = _parse_networkx(_text(path), suffix)
        elif suffix in _LIST_SUFFIXES:
            found = _parse_list(_text(path))
        else:
            raise ValueError(f"unknown format {suffix!r}; expected {_SUFFIXES}")
        return _graph(*found)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def save_graph(
    graph: Graph, path: str | os.PathLike[str], names: Sequence[str] | None = None
) -> None:
    """Write a graph file, whole or not at all; reading it gives the same numbers.

    **Arguments:**

    - `graph`: a graph whose vertices have positions.
    - `path`: the file to write or replace; its suffix says the format, as for [`load_graph`][].
    - `names`: the name of each vertex; by default its number.

    **Raises:** `ValueError` for an unknown suffix, a graph without positions, and names that are
    not one a vertex, come twice, or cannot be written; `FileNotFoundError` if the folder does not
    exist.

    A line of two vertices:

        >>> import pathlib, tempfile
        >>> from jaxcell import patrol
        >>> graph = patrol.Graph([[0, 1]], xy=[[0, 0], [3.5, 1]])
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = pathlib.Path(folder, "line.edges")
        ...     patrol.save_graph(graph, path, ["hall", "yard"])
        ...     print(path.read_text())
        hall 0.0 0.0
        yard 3.5 1.0
        hall yard
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if names is None:
        names = [str(vertex) for vertex in range(graph.vertices)]
    try:
        if graph.xy is None:
            raise ValueError("the vertices have no positions, and a graph file has them")
        if len(names) != graph.vertices:
            raise ValueError(f"names: expected {graph.vertices}, one a vertex, got {len(names)}")
        places = graph.xy.tolist()
        pairs = graph.edges.tolist()
        # What could not be read is not written.
        _graph(
            [_Vertex(f"names[{v}]", names[v], {"x": x, "y": y}) for v, (x, y) in enumerate(places)],
            [_Edge(f"edges[{e}]", *(names[end] for end in ends)) for e, ends in enumerate(pairs)],
        )
        vertices = [(name, x, y) for name, (x, y) in zip(names, places, strict=True)]
        edges = [(names[tail], names[head]) for tail, head in pairs]
        if suffix == ".json":
            text = _format_json(vertices, edges)
        elif suffix == ".graphml":
            text = _format_graphml(vertices, edges)
        elif suffix in _LIST_SUFFIXES:
            text = _format_list(vertices, edges)
        else:
            raise ValueError(f"unknown format {suffix!r}; expected {_SUFFIXES}")
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _parse_json(text: str) -> tuple[list[_Vertex], list[_Edge]]:
    document = decode_json(text, "a graph")
    if not isinstance(document, dict):
        raise ValueError(f"expected an object with nodes and edges, got {reprlib.repr(document)}")
    if document.get("directed"):
        raise ValueError(f"directed: {_DIRECTED}")
    # Until version 3.4, and in D3, the edges are "links".
    key = "edges" if "edges" in document else "links"
    fields = Fields(document)
    return (
        [
            _Vertex(f"nodes[{i}]", node.needed("id"), node.values)
            for i, node in enumerate(fields.parts("nodes"))
        ],
        [
            _Edge(f"{key}[{i}]", edge.needed("source"), edge.needed("target"))
            for i, edge in enumerate(fields.parts(key))
        ],
    )


def _parse_graphml(text: str) -> tuple[list[_Vertex], list[_Edge]]:
    import networkx as nx

    parser = expat.ParserCreate()
    parser.StartDoctypeDeclHandler = _refuse_doctype
    try:
        parser.Parse(text, True)
    except expat.ExpatError as error:
        raise ValueError(f"not valid XML, or cut short: {error}") from None
    try:
        with warnings.catch_warnings():
            # Of ports and types, which do not matter here.
            warnings.simplefilter("ignore")
            graph = nx.parse_graphml(text, force_multigraph=True)
    except (
        nx.NetworkXError,
        LookupError,
        TypeError,
        ValueError,
        AttributeError,
        ParseError,
    ) as error:
        raise ValueError(f"not GraphML that networkx reads: {str(error)[:300]}") from None
    if graph.is_directed():
        raise ValueError(f"edgedefault: {_DIRECTED}")
    return (
        [_Vertex(f"node {name!r}", name, members) for name, members in graph.nodes(data=True)],
        [_Edge(f"edge {tail!r} to {head!r}", tail, head) for tail, head in graph.edges()],
    )


def _parse_networkx(text: str, suffix: str) -> tuple[list[_Vertex], list[_Edge]]:
    """GML and adjacency lists, as networkx reads them."""
    import networkx as nx

    lines = text.splitlines()
    try:
        graph = nx.parse_gml(lines) if suffix == ".gml" else nx.parse_adjlist(lines)
    except (nx.NetworkXError, LookupError, TypeError, ValueError, AttributeError) as error:
        raise ValueError(f"not {suffix} that networkx reads: {str(error)[:300]}") from None
    if graph.is_directed():
        raise ValueError(f"directed: {_DIRECTED}")
    return (
        [_Vertex(f"node {name!r}", name, members) for name, members in graph.nodes(data=True)],
        [_Edge(f"edge {tail!r} to {head!r}", tail, head) for tail, head in graph.edges()],
    )


def has_weights(path: str | os.PathLike[str]) -> bool:
    """Whether the edges of a graph file have weights, which [`load_graph`][] does not read.

    **Arguments:**

    - `path`: the file.

    **Returns:** whether it names a weight; lists have none.

    The graph of section 4.5.2 of Alam 2018 has none:

        >>> from jaxcell import bundled, patrol
        >>> patrol.has_weights(bundled("graphs/eight.json"))
        False
    """
    return Path(path).suffix.lower() not in (*_LIST_SUFFIXES, ".adjlist") and bool(
        _WEIGHT.search(_text(Path(path)))
    )


def _refuse_doctype(*_: object) -> NoReturn:
    raise ValueError(
        "it has a document type (<!DOCTYPE ...>), which GraphML does without and whose entities "
        "can grow without bounds; expected none"
    )


def _parse_list(text: str) -> tuple[list[_Vertex], list[_Edge]]:
    vertices: list[_Vertex] = []
    edges: list[_Edge] = []
    for number, line in enumerate(text.splitlines(), 1):
        field, words = f"line {number}", line.partition("#")[0].split()
        if len(words) == 3:
            name, x, y = words
            vertices.append(_Vertex(field, name, {"x": x, "y": y}))
        elif len(words) == 2:
            edges.append(_Edge(field, *words))
        elif words:
            raise refused(field, "a vertex (name x y) or an edge (name name)", line.strip())
    return vertices, edges


def _graph(vertices: list[_Vertex], edges: list[_Edge]) -> tuple[Graph, tuple[str, ...]]:
    """Make a graph of the parts of a file; errors name these parts."""
    numbers: dict[str, int] = {}
    xy = []
    for field, name, attributes in vertices:
        if type(name) not in (str, int) or not str(name).strip() or not str(name).isprintable():
            raise refused(field, "a name, printable text or a number", name)
        if str(name) in numbers:
            raise ValueError(f"{field}: the vertex {reprlib.repr(name)} comes twice")
        numbers[str(name)] = len(numbers)
        placed = bool({"x", "y", "pos"} & attributes.keys())
        xy.append(_position(field, attributes) if placed else None)
    if None in xy and any(one is not None for one in xy):
        field = vertices[xy.index(None)].field
        raise ValueError(f"{field}: it has no position, x and y, as others have")
    if len(numbers) < 2:
        raise ValueError(f"expected at least 2 vertices, got {len(numbers)}")
    if not edges:
        raise ValueError("it has no edges")
    before: dict[tuple[int, int], str] = {}
    for field, *ends in edges:
        for name in ends:
            if str(name) not in numbers:
                raise ValueError(f"{field}: there is no vertex {reprlib.repr(name)}")
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
    pairs = [[numbers[str(edge.tail)], numbers[str(edge.head)]] for edge in edges]
    return Graph(pairs, len(numbers), None if None in xy else xy), tuple(numbers)


def _position(field: str, attributes: Mapping[str, Any]) -> tuple[float, float]:
    if "x" in attributes or "y" in attributes or "pos" not in attributes:
        fields = Fields(attributes, f"{field}.")
        both = [(f"{field}.{axis}", fields.needed(axis)) for axis in "xy"]
    else:
        pair = checked_pair(f"{field}.pos", attributes["pos"])
        both = [(f"{field}.pos[{i}]", value) for i, value in enumerate(pair)]
    # GraphML and lists have numbers as text.
    expected = f"a finite number of at most {MAX_NUMBER:g} m"
    x, y = (checked_number(*one, expected, text=True) for one in both)
    return x, y


def _format_json(vertices: list[tuple[str, float, float]], edges: list[tuple[str, str]]) -> str:
    nodes = [json.dumps({"id": name, "x": x, "y": y}) for name, x, y in vertices]
    pairs = [json.dumps({"source": tail, "target": head}) for tail, head in edges]
    members = [
        '"directed": false',
        '"multigraph": false',
        '"graph": {}',
        *(
            f'"{key}": [\n    ' + ",\n    ".join(lines) + "\n  ]"
            for key, lines in (("nodes", nodes), ("edges", pairs))
        ),
    ]
    return "{\n  " + ",\n  ".join(members) + "\n}\n"


def _format_graphml(vertices: list[tuple[str, float, float]], edges: list[tuple[str, str]]) -> str:
    import networkx as nx

    graph = nx.Graph()
    for name, x, y in vertices:
        graph.add_node(name, x=x, y=y)
    graph.add_edges_from(edges)
    return "\n".join(nx.generate_graphml(graph)) + "\n"


def _format_list(vertices: list[tuple[str, float, float]], edges: list[tuple[str, str]]) -> str:
    for name, _, _ in vertices:
        if name.split() != [name] or "#" in name:
            raise ValueError(f"an edge list has no place for spaces or # in a name: {name!r}")
    lines = [f"{name} {x!r} {y!r}" for name, x, y in vertices]
    lines += [f"{tail} {head}" for tail, head in edges]
    return "\n".join(lines) + "\n"


def _text(path: Path) -> str:
    size = path.stat().st_size
    if size > _MAX_BYTES:
        raise ValueError(f"it has {size:,} bytes; expected a graph of at most {_MAX_BYTES:,}")
    return read_text(path)
