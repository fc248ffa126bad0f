"""Graphs that the tests of weights, walks and patrols share."""

import itertools

import networkx as nx
import numpy as np
from hypothesis import strategies as st

from jaxcell import bundled
from jaxcell.optimize import Graph
from jaxcell.patrol import cell_graph
from jaxcell.space import CellSpace, Workspace, visible_cells


def graph_of(network):
    network = nx.convert_node_labels_to_integers(network)
    return Graph(np.array(network.edges), network.number_of_nodes())


def network_of(graph):
    """The same graph in networkx, with the lengths of its edges."""
    network = nx.empty_graph(graph.vertices)
    for (tail, head), length in zip(graph.edges.tolist(), graph.lengths.tolist(), strict=True):
        network.add_edge(tail, head, length=length)
    return network


def random_graph(vertices, edges, seed):
    """A random tree, and random edges more."""
    network = nx.random_labeled_tree(vertices, seed=seed)
    random = np.random.default_rng(seed)
    while network.number_of_edges() < edges:
        network.add_edge(*random.choice(vertices, 2, replace=False).tolist())
    return graph_of(network)


def grid(rows, columns):
    return graph_of(nx.grid_2d_graph(rows, columns))


def on_map(name, reach):
    """The graph of the cells of a map, of 1 m, and a mask of the cells that each cell sees."""
    cells = CellSpace.of(Workspace.load(bundled(f"maps/{name}.json")), 1.0, 1)
    return cell_graph(cells), visible_cells(cells, reach)


@st.composite
def connected_graphs(draw, most=9):
    n = draw(st.integers(2, most))
    tree = [(draw(st.integers(0, i - 1)), i) for i in range(1, n)]
    others = sorted(set(itertools.combinations(range(n), 2)) - set(tree))
    more = draw(st.lists(st.sampled_from(others), unique=True, max_size=12)) if others else []
    return Graph(np.array(tree + more), n)


def incidence(graph):
    """A matrix with 1 at the first end of each edge, and -1 at the second."""
    matrix = np.zeros((graph.vertices, len(graph.edges)))
    matrix[graph.edges[:, 0], np.arange(len(graph.edges))] = 1
    matrix[graph.edges[:, 1], np.arange(len(graph.edges))] = -1
    return matrix


# The small example of Boyd, "Convex optimization of graph Laplacian eigenvalues" (2006). Its
# vertices 3 and 8 have the same neighbours.
SMALL = Graph(
    np.array([[1, 2, 3, 1, 2, 2, 6, 5, 7, 8, 6, 7, 2], [2, 3, 4, 5, 8, 4, 5, 7, 3, 4, 7, 8, 7]]).T
    - 1,
    xy=[[1, 3], [2, 2.5], [3, 3], [3, 2], [1, 2], [1, 1], [2, 1.5], [3, 1]],
)
# The weights of the fastest mixing chain on it, times 8, to six digits.
MIXING = np.fromstring(
    ".498188 .061695 .183414 .466937 .061695 .378422 .164781 .12248 .259668 .183414 .358185 "
    ".259668 0",
    sep=" ",
)
# Alam 2018, Table 4.2: its vertices from the closest to the furthest, for the strategies toward
# each vertex, for all vertices, and for vertices 2, 5 and 8.
TABLE_4_2 = (
    np.array(
        [
            [1, 5, 2, 7, 6, 8, 3, 4],
            [2, 8, 3, 4, 7, 1, 5, 6],
            [3, 4, 2, 7, 8, 1, 5, 6],
            [4, 3, 8, 2, 1, 7, 5, 6],
            [5, 6, 7, 1, 2, 8, 3, 4],
            [6, 5, 7, 3, 1, 8, 2, 4],
            [7, 8, 2, 3, 6, 5, 4, 1],
            [8, 4, 2, 7, 3, 1, 6, 5],
            [7, 2, 5, 3, 8, 1, 4, 6],
            [8, 2, 5, 1, 7, 4, 6, 3],
        ]
    )
    - 1
)
