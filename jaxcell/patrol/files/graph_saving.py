import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ...base.documents import about
from ...base.paths import replacing
from ...optimize import Graph
from ..team.times import names_of
from .graph_files import checked_parts
from .graph_formats import LIST_SUFFIXES, SUFFIXES, Edge, Vertex


def save_graph(
    graph: Graph, path: str | os.PathLike[str], names: Sequence[str] | None = None
) -> None:
    """Write a graph file, completely or not at all; numbers are written without rounding.

    **Arguments:** a graph whose vertices have positions; the file to write or replace, whose suffix
    gives the format, as in [`load_graph`][]; and the name of each vertex, by default its number.

    A graph of two vertices and an edge:

        >>> from jaxcell import examples, patrol
        >>> graph = patrol.Graph([[0, 1]], xy=[[0, 0], [3.5, 1]])
        >>> path = examples.folder() / "line.edges"
        >>> patrol.save_graph(graph, path, ["hall", "yard"])
        >>> print(path.read_text())
        hall 0.0 0.0
        yard 3.5 1.0
        hall yard
    """
    path = Path(path)
    suffix = path.suffix.lower()
    with about(path):
        if graph.xy is None:
            raise ValueError("the vertices have no positions, which a graph file needs")
        names = names_of(graph.vertices, names)
        places = zip(names, graph.xy.tolist(), strict=True)
        nodes = [{"id": name, "x": x, "y": y} for name, (x, y) in places]
        edges: list[dict[str, Any]]
        edges = [{"source": names[i], "target": names[j]} for i, j in graph.edges.tolist()]
        if graph.ways is not None:
            for edge, length in zip(edges, graph.ways.tolist(), strict=True):
                edge["length"] = length
        # The check raises an error for a graph that could not be read from its file.
        checked_parts(
            [Vertex(f"names[{v}]", node["id"], node) for v, node in enumerate(nodes)],
            [Edge(f"edges[{e}]", *edge.values()) for e, edge in enumerate(edges)],
        )
        formats = {".json": _format_json, ".graphml": _format_graphml}
        formats |= dict.fromkeys(LIST_SUFFIXES, _format_list)
        if suffix not in formats:
            raise ValueError(f"unknown format {suffix!r}; expected {SUFFIXES}")
        text = formats[suffix](nodes, edges)
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _format_json(nodes: list[dict[str, Any]], edges: list[dict[str, Any]]) -> str:
    members = ['"directed": false', '"multigraph": false', '"graph": {}']
    for key, parts in (("nodes", nodes), ("edges", edges)):
        lines = ",\n    ".join(map(json.dumps, parts))
        members.append(f'"{key}": [\n    {lines}\n  ]')
    return "{\n  " + ",\n  ".join(members) + "\n}\n"


def _format_graphml(nodes: list[dict[str, Any]], edges: list[dict[str, Any]]) -> str:
    import networkx as nx

    document = {"multigraph": False, "nodes": nodes, "edges": edges}
    graph = nx.node_link_graph(document, edges="edges")
    return "\n".join(nx.generate_graphml(graph)) + "\n"


def _format_list(nodes: list[dict[str, Any]], edges: list[dict[str, Any]]) -> str:
    if "length" in edges[0]:
        raise ValueError("an edge list cannot store lengths of edges; expected another suffix")
    for name in (node["id"] for node in nodes):
        if name.split() != [name] or "#" in name:
            raise ValueError(f"an edge list cannot store spaces or # in a name, got {name!r}")
    parts = [" ".join(map(str, part.values())) for part in [*nodes, *edges]]
    return "\n".join(parts) + "\n"
