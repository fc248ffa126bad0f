import json
import os
from collections.abc import Sequence
from pathlib import Path

from ...base.paths import replacing
from ...optimize import Graph
from .graph_files import LIST_SUFFIXES, SUFFIXES, Edge, Vertex, checked_graph


def save_graph(
    graph: Graph, path: str | os.PathLike[str], names: Sequence[str] | None = None
) -> None:
    """Write a graph file, completely or not at all; numbers are written without rounding.

    **Arguments:**

    - `graph`: a graph whose vertices have positions.
    - `path`: the file to write or replace; its suffix gives the format, as in [`load_graph`][].
    - `names`: the name of each vertex; by default its number.

    **Raises:** `ValueError` for a graph or names that the format cannot store; `FileNotFoundError`
    if the folder does not exist.

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
            raise ValueError("the vertices have no positions, which a graph file needs")
        if len(names) != graph.vertices:
            raise ValueError(f"names: expected {graph.vertices}, one per vertex, got {len(names)}")
        places = graph.xy.tolist()
        pairs = graph.edges.tolist()
        # The check raises an error for a graph that could not be read from its file.
        checked_graph(
            [Vertex(f"names[{v}]", names[v], {"x": x, "y": y}) for v, (x, y) in enumerate(places)],
            [Edge(f"edges[{e}]", *(names[end] for end in ends)) for e, ends in enumerate(pairs)],
        )
        vertices = [(name, x, y) for name, (x, y) in zip(names, places, strict=True)]
        edges = [(names[tail], names[head]) for tail, head in pairs]
        ways = None if graph.ways is None else graph.ways.tolist()
        if suffix == ".json":
            text = _format_json(vertices, edges, ways)
        elif suffix == ".graphml":
            text = _format_graphml(vertices, edges, ways)
        elif suffix in LIST_SUFFIXES and ways is None:
            text = _format_list(vertices, edges)
        elif suffix in LIST_SUFFIXES:
            raise ValueError("an edge list cannot store lengths of edges; expected another suffix")
        else:
            raise ValueError(f"unknown format {suffix!r}; expected {SUFFIXES}")
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _format_json(
    vertices: list[tuple[str, float, float]],
    edges: list[tuple[str, str]],
    ways: list[float] | None,
) -> str:
    nodes = [json.dumps({"id": name, "x": x, "y": y}) for name, x, y in vertices]
    lengths = [{}] * len(edges) if ways is None else [{"length": length} for length in ways]
    pairs = [
        json.dumps({"source": tail, "target": head} | length)
        for (tail, head), length in zip(edges, lengths, strict=True)
    ]
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


def _format_graphml(
    vertices: list[tuple[str, float, float]],
    edges: list[tuple[str, str]],
    ways: list[float] | None,
) -> str:
    import networkx as nx

    graph = nx.Graph()
    for name, x, y in vertices:
        graph.add_node(name, x=x, y=y)
    graph.add_edges_from(edges)
    if ways is not None:
        nx.set_edge_attributes(graph, dict(zip(edges, ways, strict=True)), "length")
    return "\n".join(nx.generate_graphml(graph)) + "\n"


def _format_list(vertices: list[tuple[str, float, float]], edges: list[tuple[str, str]]) -> str:
    for name, _, _ in vertices:
        if name.split() != [name] or "#" in name:
            raise ValueError(f"an edge list cannot store spaces or # in a name, got {name!r}")
    lines = [f"{name} {x!r} {y!r}" for name, x, y in vertices]
    lines += [f"{tail} {head}" for tail, head in edges]
    return "\n".join(lines) + "\n"
