import networkx as nx
import numpy as np
import pytest

from jaxcell.optimize import Graph
from jaxcell.patrol import random_walk
from jaxcell.patrol.team import divide_graph, part_of_graph, walk_in_part


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("parts", [1, 2, 3, 5])
def test_parts_are_connected_and_of_nearly_one_size(seed, parts):
    network = nx.connected_watts_strogatz_graph(30, 4, 0.2, seed=seed)
    graph = Graph(np.array(network.edges), 30)
    part = divide_graph(graph, parts)
    sizes = np.bincount(part, minlength=parts)
    assert (sizes > 1).all()
    for one in range(parts):
        inside = np.flatnonzero(part == one)
        assert nx.is_connected(network.subgraph(inside.tolist()))
        assert part_of_graph(graph, inside).vertices == inside.size
    assert sizes.max() <= 2 * 30 / parts


def test_a_walk_in_a_part_goes_there_and_stays():
    graph = Graph([[0, 1], [1, 2], [2, 3], [3, 4]], ways=[1, 1, 5, 1])
    inside = np.array([0, 1])
    within = random_walk(part_of_graph(graph, inside), [1]).to_scipy().toarray()
    whole = walk_in_part(graph, inside, within)
    assert whole.argmax(axis=1).tolist() == [1, 0, 1, 2, 3]
    assert (whole.sum(axis=1) == 1).all()
    assert part_of_graph(graph, np.array([2, 3, 4])).lengths.tolist() == [5, 1]


def test_too_many_parts_are_refused():
    star = Graph([[0, 1], [0, 2], [0, 3], [0, 4], [0, 5]])
    with pytest.raises(ValueError, match="expected 1 to 3 parts of 6 vertices, got 4"):
        divide_graph(star, 4)
    with pytest.raises(ValueError, match="a part of 2 would be a single vertex, number"):
        divide_graph(star, 2)


def test_a_graph_that_is_not_connected_is_refused():
    with pytest.raises(ValueError, match=r"vertices 2, 3 .* cannot be reached from vertex 0"):
        divide_graph(Graph([[0, 1], [2, 3]]), 2)
