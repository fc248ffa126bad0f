import itertools

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, strategies as st

from jaxcell.patrol import Graph, random_walk, walk_hitting_times
from jaxcell.patrol.walks.paths import toward


# The small example of Boyd et al., "Convex optimization of graph Laplacian eigenvalues" (2006).
TAILS = [1, 2, 3, 1, 2, 2, 6, 5, 7, 8, 6, 7, 2]
HEADS = [2, 3, 4, 5, 8, 4, 5, 7, 3, 4, 7, 8, 7]
XY = [[1, 3], [2, 2.5], [3, 3], [3, 2], [1, 2], [1, 1], [2, 1.5], [3, 1]]
SMALL = Graph(np.array([TAILS, HEADS]).T - 1, xy=XY)


def simple_paths(graph, start, end):
    """All, each a set of its edges."""
    found = []

    def extend(here, seen, used):
        if here == end:
            found.append(used)
            return
        for edge, ends in enumerate(graph.edges.tolist()):
            if here in ends:
                there = sum(ends) - here
                if there not in seen:
                    extend(there, seen | {there}, used | {edge})

    extend(start, {start}, frozenset())
    return found


def brute_force(graph, vertex, paths):
    # Lengths are compared after rounding, so that equal sums in another order are equal.
    def order(used):
        length = round(float(graph.lengths[sorted(used)].sum()), 6)
        return length, len(used), sorted(used, reverse=True)

    counts = np.array([float(vertex in ends) for ends in graph.edges.tolist()])
    for start in range(graph.vertices):
        if start != vertex:
            for used in sorted(simple_paths(graph, start, vertex), key=order)[:paths]:
                counts[sorted(used)] += 1
    return counts / counts.sum()


@given(st.integers(2, 7), st.integers(1, 5), st.integers(0, 10_000), st.sampled_from([1, 4, 1000]))
def test_equals_brute_force(n, paths, seed, steps):
    # On a coarse lattice, many paths are equally long.
    random = np.random.default_rng(seed)
    edges = {(int(random.integers(i)), i) for i in range(1, n)}
    edges |= {tuple(sorted(e)) for e in random.integers(n, size=(6, 2)).tolist() if e[0] != e[1]}
    xy = random.integers(0, steps, size=(n, 2)) / steps
    graph = Graph(random.permutation(sorted(edges)), xy=xy)
    vertex = int(random.integers(n))
    np.testing.assert_allclose(
        toward(graph, vertex, paths), brute_force(graph, vertex, paths), atol=1e-15
    )


def test_a_tree_has_one_path_from_each_vertex():
    # An edge is on the paths of all vertices beyond it, and at the vertex once more.
    graph = Graph([[0, 1], [1, 2], [1, 3], [3, 4]])
    np.testing.assert_allclose(toward(graph, 1), np.array([2, 2, 3, 1]) / 8)
    random_walk(graph, toward(graph, 1))


def test_equally_long_ways_across_a_grid_are_in_order():
    graph = Graph(np.array(nx.convert_node_labels_to_integers(nx.grid_2d_graph(7, 7)).edges))
    weights = toward(graph, 48, 2)
    np.testing.assert_array_equal(weights, toward(graph, 48, 2))
    assert weights.sum() == pytest.approx(1)


# Alam 2018, Table 4.2: the vertices by falling payoffs of the walk toward the first of them.
ROWS = {
    1: [1, 5, 2, 7, 6, 8, 3, 4],
    2: [2, 8, 3, 4, 7, 1, 5, 6],
    3: [3, 4, 2, 7, 8, 1, 5, 6],
    4: [4, 3, 8, 2, 1, 7, 5, 6],
    5: [5, 6, 7, 1, 2, 8, 3, 4],
    6: [6, 5, 7, 3, 1, 8, 2, 4],
    7: [7, 8, 2, 3, 6, 5, 4, 1],
    8: [8, 4, 2, 7, 3, 1, 6, 5],
}


def test_rows_of_the_small_graph():
    # Pairs of vertices whose hitting times are the other way round. Rows 1, 4 and 8 agree; in row
    # 1, vertices 8 and 3 are equally far. No other choice of equally long paths makes more agree.
    wrong = {}
    for vertex, row in ROWS.items():
        times = walk_hitting_times(SMALL, toward(SMALL, vertex - 1))[:, vertex - 1]
        pairs = itertools.combinations(np.array(row) - 1, 2)
        wrong[vertex] = sum(times[near] > times[far] + 1e-9 for near, far in pairs)
    assert wrong == {1: 0, 2: 2, 3: 1, 4: 0, 5: 1, 6: 3, 7: 4, 8: 0}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((4,), "vertex 4 does not exist; vertices are 0 to 3"),
        ((-1,), "vertex -1 does not exist"),
        ((0, 0), "paths: expected at least 1, got 0"),
        ((0, 3), "vertex 0 cannot be reached from vertex 2"),
    ],
)
def test_refuses(arguments, message):
    with pytest.raises(ValueError, match=message):
        toward(Graph([[0, 1], [2, 3]]), *arguments)
