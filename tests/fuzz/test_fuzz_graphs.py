"""Graph files of all formats, damaged."""

import json

import networkx as nx
import pytest
from hypothesis import example, given
from mutations import DATA, cases, changed_json, damaged, place, reads_or_refuses

from jaxcell.patrol import load_graph, save_graph


PLAIN = {
    "directed": False,
    "multigraph": False,
    "graph": {},
    "nodes": [{"id": i, "x": i * 1.5, "y": -i} for i in range(4)],
    "edges": [{"source": i, "target": i + 1} for i in range(3)],
}
LINKS = {
    "nodes": [{"id": name, "pos": [0, i]} for i, name in enumerate("abc")],
    "links": [{"source": "a", "target": "b"}, {"source": "b", "target": "c"}],
}
JSON = {
    "g.json": PLAIN,
    "l.json": LINKS,
    "tree.json": json.loads((DATA / "graphs" / "tree.json").read_text()),
}


def graphml():
    graph = nx.path_graph(3)
    for v in graph:
        graph.nodes[v].update(x=1.0 * v, y=2 * v, name="hall", lit=True)
    graph.edges[0, 1]["weight"] = 2.5
    return "\n".join(nx.generate_graphml(graph)).encode()


TEXTS = {
    "g.graphml": graphml(),
    "g.edges": b"# Three\nhall 0 0\nyard 3.5 1\n\nroom 1e3 -2 # far\nhall yard\nyard room\n",
    "g.txt": b"a 0 0\nb 0 1\na b\n",
    "g.json": json.dumps(PLAIN).encode(),
}


@cases()
@given(changed_json(JSON))
def test_json_graphs(tmp_path, file):
    reads_or_refuses(load_graph, place(tmp_path, *file))


@cases()
@given(damaged({name: TEXTS[name] for name in ("g.edges", "g.txt", "g.json")}))
def test_lists_of_edges(tmp_path, file):
    reads_or_refuses(load_graph, place(tmp_path, *file))


@cases()
@given(damaged({"g.graphml": TEXTS["g.graphml"]}))
@example(("g.graphml", TEXTS["g.graphml"].replace(b"xmlns:xsi", b":xsi")))
def test_graphml(tmp_path, file):
    reads_or_refuses(load_graph, place(tmp_path, *file))


def test_the_undamaged_ones_are_read(tmp_path):
    for name, content in [*TEXTS.items(), ("l.json", json.dumps(LINKS).encode())]:
        assert reads_or_refuses(load_graph, place(tmp_path, name, content))


def test_growing_entities_are_refused(tmp_path):
    entities = "".join(f'<!ENTITY l{i} "{f"&l{i - 1};" * 10}">' for i in range(1, 12))
    text = (
        f'<?xml version="1.0"?><!DOCTYPE graphml [<!ENTITY l0 "ha">{entities}]>'
        '<graphml><graph edgedefault="undirected"><node id="&l11;"/></graph></graphml>'
    )
    assert not reads_or_refuses(load_graph, place(tmp_path, "g.graphml", text.encode()))


@pytest.mark.parametrize("suffix", ["json", "graphml", "edges", "txt"])
def test_graphs_are_read_back_in_each_format(tmp_path, suffix):
    graph, names = load_graph(place(tmp_path, "g.edges", TEXTS["g.edges"]))
    save_graph(graph, tmp_path / f"again.{suffix}", names)
    assert load_graph(tmp_path / f"again.{suffix}")[1] == names


def test_too_large_files_are_refused(tmp_path):
    path = place(tmp_path, "g.edges", b"")
    with path.open("r+b") as file:
        file.truncate(64 * 2**20 + 1)
    assert not reads_or_refuses(load_graph, path, "67,108,865 bytes")
