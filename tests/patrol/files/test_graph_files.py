import json
import runpy
import warnings
from pathlib import Path

import networkx as nx
import numpy as np
import pytest
from hypothesis import assume, given, strategies as st

from jaxcell.optimize import Graph
from jaxcell.patrol.files import load_graph
from jaxcell.patrol.files.values import load_stakes, load_values


GRAPHS = Path(__file__).parents[3] / "data" / "graphs"
SUFFIXES = (".json", ".graphml", ".edges", ".txt")
NAMES = ("hall", "1", "Küche", "a&b<c>")
SQUARE = Graph([[0, 1], [2, 1], [2, 3], [0, 3]], xy=[[0, 0], [0.1, 1e-9], [-3, 1 / 3], [1e6, 2]])


def lengths_of(graph, names=range(99)):
    """The length of each edge, by its ends in any order."""
    ends = [frozenset(names[end] for end in edge) for edge in graph.edges.tolist()]
    return dict(zip(ends, graph.lengths.tolist(), strict=True))


def write_graph(graph, path, names):
    places, ends = graph.xy.tolist(), [[names[v] for v in edge] for edge in graph.edges.tolist()]
    if path.suffix in (".edges", ".txt"):
        rows = [(name, x, y) for name, (x, y) in zip(names, places, strict=True)] + ends
        path.write_text("".join(" ".join(map(str, row)) + "\n" for row in rows), encoding="utf-8")
        return
    theirs = nx.Graph()
    for name, (x, y) in zip(names, places, strict=True):
        theirs.add_node(name, x=x, y=y)
    for edge, (one, other) in enumerate(ends):
        length = {} if graph.ways is None else {"length": float(graph.ways[edge])}
        theirs.add_edge(one, other, **length)
    if path.suffix == ".json":
        document = json.dumps(nx.node_link_data(theirs, edges="edges"))
        path.write_text(document, encoding="utf-8")
    else:
        nx.write_graphml(theirs, path)


def load_text(tmp_path, text, suffix=".json"):
    path = tmp_path / f"graph{suffix}"
    path.write_text(text, encoding="utf-8")
    return load_graph(path)


@st.composite
def graphs(draw):
    n = draw(st.integers(2, 8))
    pairs = st.tuples(st.integers(0, n - 1), st.integers(0, n - 1)).filter(lambda e: e[0] != e[1])
    edges = draw(st.lists(pairs, min_size=1, unique_by=frozenset))
    coordinate = st.floats(-1e9, 1e9)
    xy = draw(st.lists(st.tuples(coordinate, coordinate), min_size=n, max_size=n))
    text = st.text(min_size=1, max_size=8).filter(
        lambda name: name.isprintable() and name.split() == [name] and not set("#%") & set(name)
    )
    names = draw(st.lists(text, min_size=n, max_size=n, unique=True))
    length = st.floats(0, 1e9, exclude_min=True)
    ways = draw(st.none() | st.lists(length, min_size=len(edges), max_size=len(edges)))
    return Graph(edges, xy=xy, ways=ways), tuple(names)


@given(graphs(), st.sampled_from(SUFFIXES))
def test_any_graph_survives(tmp_path_factory, graph_and_names, suffix):
    graph, names = graph_and_names
    # Shorter edges would be taken for degrees.
    assume(graph.xy is None or graph.lengths.max() >= 0.1)
    path = tmp_path_factory.getbasetemp() / f"any{suffix}"
    assume(graph.ways is None or suffix not in (".edges", ".txt"))
    write_graph(graph, path, names)
    found, found_names = load_graph(path)
    assert found_names == names
    np.testing.assert_array_equal(found.xy, graph.xy)
    assert lengths_of(found) == lengths_of(graph)
    assert (found.ways is None) == (graph.ways is None)


def test_networkx_reads_and_writes_the_same(tmp_path):
    write_graph(SQUARE, tmp_path / "ours.json", NAMES)
    ours = nx.node_link_graph(json.loads((tmp_path / "ours.json").read_text()), edges="edges")
    assert set(map(frozenset, ours.edges)) == lengths_of(SQUARE, NAMES).keys()
    assert ours.nodes["hall"] == {"x": 0.0, "y": 0.0}

    theirs = nx.random_geometric_graph(12, 0.5, seed=3)
    for key in ("edges", "links"):
        graph, names = load_text(tmp_path, json.dumps(nx.node_link_data(theirs, edges=key)))
        assert names == tuple(map(str, range(12)))
        np.testing.assert_array_equal(graph.xy, [theirs.nodes[v]["pos"] for v in range(12)])
        assert set(map(tuple, graph.edges.tolist())) == set(theirs.edges)
    for v in theirs:
        theirs.nodes[v]["x"], theirs.nodes[v]["y"] = theirs.nodes[v].pop("pos")
    nx.write_graphml(theirs, tmp_path / "theirs.graphml")
    again, _ = load_graph(tmp_path / "theirs.graphml")
    np.testing.assert_array_equal(again.xy, graph.xy)
    np.testing.assert_array_equal(again.edges, graph.edges)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda d: d.update(directed=True),
            "directed: 4 of its 4 ways .* both ways",
        ),
        (lambda d: d.update(format="jaxcell-map"), r"it is a map, not a graph; study.PatrolMap"),
        (lambda d: d.pop("nodes"), r"nodes: expected a list, got None"),
        (lambda d: d.pop("edges"), r"links: expected a list, got None"),
        (lambda d: d.update(nodes=[]), "expected at least 2 vertices, got 0"),
        (lambda d: d.update(edges=[]), "it has no edges"),
        (lambda d: d["nodes"][1].pop("id"), r"nodes\[1\].id: it is missing"),
        (lambda d: d["nodes"][1].update(id=None), r"nodes\[1\]: expected a name"),
        (lambda d: d["nodes"][1].update(id=True), r"nodes\[1\]: expected a name"),
        (lambda d: d["nodes"][1].update(id="a\nb"), r"nodes\[1\]: expected a name"),
        (lambda d: d["nodes"][1].update(id=" "), r"nodes\[1\]: expected a name"),
        (lambda d: d["nodes"][2].update(id=1), r"nodes\[2\]: the vertex 1 comes twice"),
        (lambda d: d["nodes"][1].pop("y"), r"nodes\[1\].y: it is missing"),
        (lambda d: [d["nodes"][1].pop(axis) for axis in "xy"], r"nodes\[1\]: it has no position x"),
        (lambda d: d["nodes"][1].update(x="far"), r"nodes\[1\].x: expected .* got 'far'"),
        (lambda d: d["nodes"][1].update(x=1e300), r"nodes\[1\].x: .* at most 1e\+09 m, got 1e"),
        (lambda d: d["nodes"].append({"id": "p", "pos": [1]}), r"nodes\[4\].pos: expected a pair"),
        (
            lambda d: d["nodes"].append({"id": "p", "pos": [1, "x"]}),
            r"nodes\[4\].pos\[1\]: expected a finite number",
        ),
        (lambda d: d["edges"][1].pop("source"), r"edges\[1\].source: it is missing"),
        (lambda d: d["edges"][1].update(target="attic"), r"edges\[1\]: there is no vertex 'attic'"),
        (lambda d: d["edges"][1].update(length=2), r"edges\[0\]: it has no length, but other ed"),
        (
            lambda d: [edge.update(length=0) for edge in d["edges"]],
            r"edges\[0\].length: expected a positive number",
        ),
        (lambda d: [edge.update(length="far") for edge in d["edges"]], r"edges\[0\].length: expe"),
    ],
)
def test_bad_fields_of_json_are_named(change, message, tmp_path):
    write_graph(SQUARE, tmp_path / "whole.json", NAMES)
    document = json.loads((tmp_path / "whole.json").read_text(encoding="utf-8"))
    change(document)
    with pytest.raises(ValueError, match=rf"graph\.json: {message}"):
        load_text(tmp_path, json.dumps(document))


@pytest.mark.parametrize(
    ("suffix", "old", "new", "message"),
    [
        (".graphml", '"undirected"', '"directed"', "edgedefault: . of its . ways have no way back"),
        (".graphml", "1e-09", "north", "not .graphml that networkx reads"),
        (".graphml", 'target="1"', 'target="attic"', "node 'attic': it has no position"),
        (".graphml", "</node>", "", "not .graphml that networkx reads: mismatched tag"),
        (".graphml", "<graphml", "<!DOCTYPE graphml><graphml", "it has a document type"),
        (".graphml", "graphml.graphdrawing.org", "example.org", "not .graphml"),
        (".edges", "1000000.0 2.0", "1000000.0", "line 4: there is no vertex '3'"),
        (".edges", "1e-09", "inf", "line 2.y: expected a finite number .* got 'inf'"),
        (".edges", "hall 1\n", "hall 1 2 3\n", "line 5: expected a vertex .* or an edge"),
        (".edges", "hall 1\n", "hall 1 0.5\n", "line 5: the vertex 'hall' comes twice"),
    ],
)
def test_bad_parts_of_other_formats_are_named(suffix, old, new, message, tmp_path):
    names = NAMES if suffix == ".graphml" else ("hall", "1", "2", "3")
    path = tmp_path / f"graph{suffix}"
    write_graph(SQUARE, path, names)
    text = path.read_text(encoding="utf-8")
    assert old in text
    with pytest.raises(ValueError, match=rf"graph\{suffix}: .*{message}"):
        load_text(tmp_path, text.replace(old, new, 1), suffix)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_an_empty_file_is_refused(suffix, tmp_path):
    with pytest.raises(ValueError, match=rf"graph\{suffix}: "):
        load_text(tmp_path, "", suffix)


def test_other_files_are_refused(tmp_path):
    with pytest.raises(ValueError, match="expected an object with nodes and edges"):
        load_text(tmp_path, "[]")
    with pytest.raises(FileNotFoundError, match=r"none\.json: there is no such file"):
        load_graph(tmp_path / "none.json")
    with pytest.raises(ValueError, match="expected a graph file, got a directory"):
        load_graph(tmp_path)
    with pytest.raises(ValueError, match=r"graph\.dot: unknown format '\.dot'; expected \.json"):
        load_text(tmp_path, "graph {}", ".dot")
    (tmp_path / "latin.txt").write_bytes(b"\xe9 0 0\n")
    with pytest.raises(ValueError, match="expected UTF-8 text; byte 0 is not"):
        load_graph(tmp_path / "latin.txt")


def test_the_karate_club_has_no_positions_and_weights_that_are_not_used(tmp_path):
    club = nx.karate_club_graph()
    nx.write_gml(club, tmp_path / "club.gml")
    nx.write_adjlist(club, tmp_path / "club.adjlist")
    nx.write_graphml(club, tmp_path / "club.graphml")
    (tmp_path / "club.json").write_text(json.dumps(nx.node_link_data(club, edges="edges")))
    for suffix in ("gml", "adjlist", "graphml", "json"):
        path = tmp_path / f"club.{suffix}"
        with warnings.catch_warnings(record=True) as doubts:
            warnings.simplefilter("always")
            graph, names = load_graph(path)
        assert graph.xy is None
        assert lengths_of(graph, names).keys() == {frozenset(map(str, e)) for e in club.edges}
        said = "edges have no attribute length, so that of each is unknown, and it takes one step"
        named = f'{path}: {said}; to read another attribute as length, set `weight="weight"`'
        assert [str(each.message) for each in doubts] == [named] * (suffix != "adjlist")


def test_a_number_for_each_vertex(tmp_path):
    path = tmp_path / "values.txt"
    path.write_text("# places\nb 2.5\nold hall 3 # metres\n\na 1\n")
    assert load_values(path, ["a", "b", "old hall"]).tolist() == [1, 2.5, 3]
    for text, message in (
        ("a 1\n", "there is no number for vertex 'b'"),
        ("a 1\nc 2\n", "line 2: there is no vertex 'c'"),
        ("a 1\nbb 2\n", "line 2: there is no vertex 'bb'; did you mean b"),
        ("a 1\na 2\n", "line 2: the vertex 'a' comes twice"),
        ("a 1\nb 0\n", "line 2: expected a number more than 0, got 0"),
        ("a 1\nb two\n", "line 2: expected a number more than 0"),
    ):
        path.write_text(text)
        with pytest.raises(ValueError, match=message):
            load_values(path, ["a", "b"])


def test_stakes_of_each_vertex(tmp_path):
    path = tmp_path / "stakes.txt"
    path.write_text("b 1 2 3 4\nhall 5 5 6 7 8\n")
    stakes = load_stakes(path, ["hall 5", "b"])
    assert [one.tolist() for one in vars(stakes).values()] == [[5, 1], [6, 2], [7, 3], [8, 4]]
    path.write_text("b 1\nhall 5 2\n")
    stakes = load_stakes(path, ["hall 5", "b"])
    assert (stakes.values.tolist(), stakes.adversary_values) == ([2, 1], None)


def test_the_bundled_graphs_are_made_by_their_script(tmp_path):
    runpy.run_path(str(GRAPHS / "make_graphs.py"))["main"](tmp_path)
    made = sorted(path.name for path in tmp_path.iterdir())
    assert made == sorted(path.name for path in GRAPHS.glob("*.json"))
    for name in made:
        assert (tmp_path / name).read_bytes() == (GRAPHS / name).read_bytes()


@pytest.mark.parametrize("path", sorted(GRAPHS.glob("*.json")), ids=lambda path: path.stem)
def test_the_bundled_graphs_are_connected(path):
    graph, names = load_graph(path)
    assert names == tuple(str(v + 1) for v in range(graph.vertices))
    assert nx.is_connected(nx.Graph(graph.edges.tolist()))
    assert len(np.unique(graph.xy, axis=0)) == graph.vertices


CORRIDOR = """3
100 50
0.5
1 -2

0
10 20
1
1 E 30

1
40 20
2
0 W 30
2 N 12

2
40 30
1
1 S 12
"""


def test_graphs_of_patrolling_sim(tmp_path):
    graph, names = load_text(tmp_path, CORRIDOR, ".graph")
    assert names == ("0", "1", "2")
    assert graph.edges.tolist() == [[0, 1], [1, 2]]
    assert graph.xy.tolist() == [[6, 8], [21, 8], [21, 13]]
    # The last way is not straight.
    assert graph.lengths.tolist() == [15, 6]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (CORRIDOR[:-3], "it ends after 29 words"),
        (CORRIDOR + "7", "word 31: '7' comes after the last of 3 vertices"),
        (CORRIDOR.replace("0.5", "0"), "word 4: expected more than 0 metres per pixel"),
        (CORRIDOR.replace("E 30", "E far"), "word 13: expected the length of a path"),
        (CORRIDOR.replace("E 30", "E 31"), "15.5 m back; expected equal lengths in both"),
    ],
)
def test_bad_graphs_of_patrolling_sim_are_refused(tmp_path, text, message):
    with pytest.raises(ValueError, match=message):
        load_text(tmp_path, text, ".graph")


@pytest.mark.parametrize("data", [True, False])
def test_an_edge_list_of_networkx_is_read(tmp_path, data):
    network = nx.cycle_graph(5)
    nx.write_edgelist(network, tmp_path / "ring.txt", data=data)
    graph, names = load_graph(tmp_path / "ring.txt")
    ends = lengths_of(graph, list(map(int, names))).keys()
    assert ends == set(map(frozenset, network.edges))
