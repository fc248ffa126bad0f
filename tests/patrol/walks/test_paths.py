import itertools

import networkx as nx
import numpy as np
import pytest
from graphs import SMALL, TABLE_4_2, grid, network_of
from hypothesis import given, strategies as st

from jaxcell.patrol import Graph
from jaxcell.patrol.walks import measure
from jaxcell.patrol.walks.paths import toward


def brute_force(graph, vertex, paths):
    """The counts of steps on the first of all simple paths, in order."""
    network = network_of(graph)
    edge = {frozenset(ends): number for number, ends in enumerate(graph.edges.tolist())}

    # Lengths are compared after rounding, so that equal sums in another order are equal.
    def order(path):
        used = sorted(edge[frozenset(step)] for step in itertools.pairwise(path))
        return round(float(graph.lengths[used].sum()), 9), len(used), used[::-1]

    counts = np.zeros((graph.vertices, graph.vertices))
    counts[vertex, list(network[vertex])] = 1
    for start in network.nodes - {vertex}:
        simple = nx.all_simple_paths(network, start, vertex)
        for path in sorted(simple, key=order)[:paths]:
            for step in itertools.pairwise(path):
                counts[step] += 1
    return counts


@given(st.integers(2, 7), st.integers(1, 5), st.integers(0, 10_000), st.sampled_from([1, 4, 1000]))
def test_equals_brute_force(n, paths, seed, steps):
    # On a coarse lattice, many paths are equally long.
    random = np.random.default_rng(seed)
    edges = {(int(random.integers(i)), i) for i in range(1, n)}
    edges |= {tuple(sorted(e)) for e in random.integers(n, size=(6, 2)).tolist() if e[0] != e[1]}
    xy = random.integers(0, steps, size=(n, 2)) / steps
    graph = Graph(random.permutation(sorted(edges)), xy=xy)
    vertex = int(random.integers(n))
    counts = brute_force(graph, vertex, paths)
    np.testing.assert_allclose(
        toward(graph, vertex, paths).to_scipy().toarray(),
        counts / counts.sum(axis=1, keepdims=True),
        atol=1e-15,
    )


def test_a_line_comes_before_pieces_of_it():
    # From (0, 0) to (3, 3), by (1, 1): the sum of the pieces is another number in 64 bits.
    xy = np.array([[0, 0], [1, 1], [3, 3]]) / 4
    line = Graph(np.array([[0, 1], [1, 2], [0, 2]]), xy=xy)
    assert toward(line, 2).to_scipy().toarray()[0].tolist() == [0, 0, 1]


def test_along_one_path_the_time_is_the_number_of_edges():
    graph = grid(8, 8)
    found = measure(toward(graph, 27))
    hops = nx.floyd_warshall_numpy(nx.grid_2d_graph(8, 8))[:, 27]
    np.testing.assert_allclose(found.hitting_time[:, 27], hops, atol=1e-9)
    assert hops.sum() / 64 == 4.0
    # In the long run it goes to and fro between the vertex and its four neighbours.
    assert (found.stationary > 0).sum() == 5
    assert np.isinf(found.hitting_time[27, 0])
    assert max(off for off, _ in found.checks().values()) < 1e-9


def test_many_paths_on_a_large_graph_are_refused():
    graph = grid(20, 20)
    with pytest.raises(ValueError, match="paths: 3 from each of 400 vertices take minutes"):
        toward(graph, 0, 3)
    assert toward(graph, 0).cells == 400


@pytest.mark.parametrize("vertex", range(8))
def test_vertices_are_in_the_order_of_table_4_2(vertex):
    # Up to the order of vertices that are equally far.
    times = measure(toward(SMALL, vertex)).hitting_time[TABLE_4_2[vertex], vertex]
    assert (np.diff(times) > -1e-9).all()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((4,), "vertex: expected a vertex, 0 to 3, got 4"),
        ((0, 0), "paths: expected a whole number of at least 1, got 0"),
        ((0, 3), "vertex 0 cannot be reached from vertex 2"),
    ],
)
def test_wrong_arguments_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        toward(Graph([[0, 1], [2, 3]]), *arguments)
