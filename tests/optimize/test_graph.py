import networkx as nx
import numpy as np
import pytest

from jaxcell.base.doubts import Doubt
from jaxcell.optimize import Graph


def ends(graph, names):
    return {frozenset(names[end] for end in edge) for edge in graph.edges.tolist()}


@pytest.mark.parametrize(
    "network",
    [
        nx.grid_2d_graph(3, 4),
        nx.path_graph(["hall", "yard", "attic"]),
        nx.relabel_nodes(nx.petersen_graph(), {v: 100 - 7 * v for v in range(10)}),
        nx.MultiGraph([((0, 1), (1, 2)), ((1, 2), (5, 5))]),
        nx.Graph([((0, 1), (1, 0))]),
    ],
    ids=["pairs", "words", "numbers", "multigraph", "an edge of pairs"],
)
def test_graph_of_networkx_has_its_vertices_and_edges(network):
    graph = Graph(network)
    assert graph.vertices == network.number_of_nodes()
    assert ends(graph, list(network)) == set(map(frozenset, network.edges()))
    assert graph.xy is None
    assert graph.ways is None


def test_vertices_of_networkx_keep_their_numbers_in_any_order():
    """A star about 0 and a path 3, 1, 0, 2, whose nodes networkx lists in order of appearance."""
    star = Graph(nx.Graph([(2, 0), (0, 1)]))
    assert {frozenset(edge) for edge in star.edges.tolist()} == {
        frozenset((2, 0)),
        frozenset((0, 1)),
    }
    network = nx.Graph([(3, 1), (1, 0), (0, 2)])
    nx.set_node_attributes(network, {k: (10.0 * k, 0.0) for k in range(4)}, "pos")
    path = Graph(network)
    assert path.edges.tolist() == [[3, 1], [1, 0], [0, 2]]
    assert path.xy[:, 0].tolist() == [0, 10, 20, 30]
    named = Graph(nx.Graph([("hall", "attic"), ("attic", "cellar")]))
    assert named.edges.tolist() == [[0, 1], [1, 2]]


@pytest.mark.parametrize("name", ["weight", "distance", "travel_time"])
def test_lengths_under_other_names_are_doubted(name):
    network = nx.Graph()
    network.add_edge("a", "b", **{name: 2.5})
    network.add_edge("b", "c", **{name: 9.0})
    with pytest.warns(Doubt, match=f"its `{name}` is not read: the length of each edge is 1 m"):
        assert Graph(network).lengths.tolist() == [1, 1]
    assert Graph(network, ways=[2.5, 9]).lengths.tolist() == [2.5, 9]


def test_graph_of_networkx_keeps_vertices_without_edges():
    network = nx.Graph([("b", "a")])
    network.add_node("alone")
    assert Graph(network).vertices == 3


def test_graph_of_networkx_has_its_positions_and_lengths():
    network = nx.path_graph(3)
    nx.set_node_attributes(network, {0: (0, 1), 1: (2, 3), 2: (4, 5)}, "pos")
    nx.set_edge_attributes(network, {(0, 1): 7.0, (1, 2): "8.5"}, "length")
    graph = Graph(network)
    np.testing.assert_array_equal(graph.xy, [[0, 1], [2, 3], [4, 5]])
    np.testing.assert_array_equal(graph.ways, [7, 8.5])
    network = nx.path_graph(["a", "b"])
    network.add_node("a", x=1.0, y=2.0)
    network.add_node("b", x=3.0, y=4.0)
    np.testing.assert_array_equal(Graph(network).xy, [[1, 2], [3, 4]])
    np.testing.assert_array_equal(Graph(network, xy=[[0, 0], [1, 1]]).xy, [[0, 0], [1, 1]])


def lacking(kind, **attributes):
    network = nx.path_graph(["a", "b", "c"])
    (network.nodes["a"] if kind == "node" else network.edges["a", "b"]).update(attributes)
    return network


@pytest.mark.parametrize(
    ("network", "message"),
    [
        (nx.DiGraph([(0, 1), (1, 0)]), "edges: the networkx graph is directed; .* to_undirected"),
        (nx.MultiDiGraph([(0, 1)]), "edges: the networkx graph is directed"),
        (nx.MultiGraph([("a", "b"), ("b", "a")]), r"edges\[1\] joins 'a' and 'b', as .*parallel"),
        (nx.Graph([("a", "b"), ("b", "b")]), r"edges\[1\] is a loop at vertex 'b'"),
        (nx.empty_graph(3), "edges: the networkx graph has no edges"),
        (lacking("node", x=1, y=1), "networkx graph, 'b' has no position x, y or pos, but other"),
        (lacking("node", pos=(1, 1)), "networkx graph, 'b' has no position x, y or pos, but other"),
        (lacking("edge", length=3), r"networkx graph, \('b', 'c'\) has no length, but other edges"),
        (nx.grid_2d_graph(2, 2).edges, r"edges: expected an array \[edges, 2\], got \[4, 2, 2\]"),
    ],
)
def test_networkx_graphs_that_cannot_be_represented_are_refused(network, message):
    with pytest.raises(ValueError, match=message):
        Graph(network)
