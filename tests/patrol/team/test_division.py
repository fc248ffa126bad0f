import itertools

import networkx as nx
import numpy as np
import pytest
from graphs import graph_of
from walks import walk_on

from jaxcell.optimize import Graph
from jaxcell.patrol.team import divide_graph, part_of_graph, walk_in_part


def least_squares(network, parts):
    """The least sum of squared sizes over all divisions into connected parts of two or more."""
    vertices, least = len(network), np.inf
    for owner in itertools.product(range(parts), repeat=vertices - 1):
        sizes = np.bincount([0, *owner], minlength=parts)
        if sizes.min() >= 2 and (sizes**2).sum() < least:
            groups = [[v for v, o in enumerate((0, *owner)) if o == part] for part in range(parts)]
            if all(nx.is_connected(network.subgraph(group)) for group in groups):
                least = (sizes**2).sum()
    return least


@pytest.mark.parametrize("seed", range(12))
def test_no_division_is_more_even_than_the_one_that_is_found(seed):
    """Against all divisions of trees and of random graphs, some of which cannot be divided."""
    vertices = 5 + seed % 4
    network = nx.random_labeled_tree(vertices, seed=seed)
    if seed % 2:
        extra = np.random.default_rng(seed).choice(vertices, 2, replace=False).tolist()
        network.add_edge(*extra)
    graph = graph_of(network)
    for parts in range(2, vertices // 2 + 1):
        least = least_squares(network, parts)
        if np.isfinite(least):
            sizes = np.bincount(divide_graph(graph, parts))
            assert sizes.size == parts
            assert (sizes**2).sum() == least
        else:
            with pytest.raises(ValueError, match="a part is a single vertex"):
                divide_graph(graph, parts)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("parts", [1, 2, 3, 5])
def test_parts_are_connected_and_of_one_size(seed, parts):
    network = nx.connected_watts_strogatz_graph(30, 4, 0.2, seed=seed)
    graph = graph_of(network)
    part = divide_graph(graph, parts)
    sizes = np.bincount(part, minlength=parts)
    assert (sizes > 1).all()
    for one in range(parts):
        inside = np.flatnonzero(part == one)
        assert nx.is_connected(network.subgraph(inside.tolist()))
        assert part_of_graph(graph, inside).vertices == inside.size
    assert np.ptp(sizes) <= 1


def test_a_walk_in_a_part_goes_there_and_stays():
    graph = Graph([[0, 1], [1, 2], [2, 3], [3, 4]], ways=[1, 1, 5, 1])
    inside = np.array([0, 1])
    within = walk_on(part_of_graph(graph, inside))
    whole = walk_in_part(graph, inside, within)
    assert whole.argmax(axis=1).tolist() == [1, 0, 1, 2, 3]
    assert (whole.sum(axis=1) == 1).all()
    assert part_of_graph(graph, np.array([2, 3, 4])).lengths.tolist() == [5, 1]


def test_too_many_parts_are_refused():
    star = Graph([[0, 1], [0, 2], [0, 3], [0, 4], [0, 5]])
    with pytest.raises(ValueError, match="expected 1 to 3 parts of 6 vertices, got 4"):
        divide_graph(star, 4)
    with pytest.raises(ValueError, match=r"into 2 parts .* is a single vertex, as [b-f]; expected"):
        divide_graph(star, 2, names="abcdef")


def test_a_graph_that_is_not_connected_is_refused():
    with pytest.raises(ValueError, match=r"vertices 2, 3 .* cannot be reached from vertex 0"):
        divide_graph(Graph([[0, 1], [2, 3]]), 2)
