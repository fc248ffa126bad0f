import networkx as nx
import numpy as np
import pytest
from hypothesis import given, strategies as st

from jaxcell.base.connected import check_connected, vertices_apart


@st.composite
def graphs(draw):
    vertices = draw(st.integers(1, 7))
    ends = st.integers(0, vertices - 1)
    edges = draw(st.lists(st.tuples(ends, ends), max_size=10))
    return vertices, np.array(edges, np.int32).reshape(-1, 2)


@given(graphs())
def test_finds_the_smallest_part(graph):
    vertices, edges = graph
    network = nx.Graph()
    network.add_nodes_from(range(vertices))
    network.add_edges_from(edges.tolist())
    found = vertices_apart(vertices, edges)
    assert (found is None) == nx.is_connected(network)
    if found is not None:
        apart, other = found
        parts = list(nx.connected_components(network))
        assert set(apart.tolist()) in parts
        assert apart.size == min(map(len, parts))
        assert other == min(set(range(vertices)) - set(apart.tolist()))


def test_names_vertices_of_two_parts():
    check_connected(3, np.array([[0, 1], [2, 1]]))
    expected = "graph: expected all vertices connected, but "
    with pytest.raises(ValueError, match=rf"^{expected}vertex 2 \(1 of 3\) .* from vertex 0$"):
        check_connected(3, np.array([[0, 1]]))
    path = np.stack([np.arange(19), np.arange(1, 20)], axis=1)
    with pytest.raises(ValueError, match=r"^walls: vertices 10, 11, .*, 17, \.\.\. \(10 of 20\)"):
        check_connected(20, np.delete(path, 9, axis=0), "walls:")
