import itertools

import networkx as nx
import numpy as np
import pytest

from jaxcell.optimize.commute_sweep import minimum_commute_sweep
from jaxcell.optimize.conductance import minimum_commute
from jaxcell.optimize.graph import Graph
from jaxcell.optimize.tour import on_walk


# The small example of Boyd et al., "Convex optimization of graph Laplacian eigenvalues" (2006).
TAILS = [1, 2, 3, 1, 2, 2, 6, 5, 7, 8, 6, 7, 2]
HEADS = [2, 3, 4, 5, 8, 4, 5, 7, 3, 4, 7, 8, 7]
XY = [[1, 3], [2, 2.5], [3, 3], [3, 2], [1, 2], [1, 1], [2, 1.5], [3, 1]]
SMALL = Graph(np.array([TAILS, HEADS]).T - 1, xy=XY)
SOME = [list(c) for k in (2, 3) for c in itertools.combinations(range(8), k)]


def connected(graph, allowed):
    network = nx.Graph(graph.edges[allowed].tolist())
    return network.number_of_nodes() == graph.vertices and nx.is_connected(network)


def random_graph(vertices, edges, seed):
    network = nx.gnm_random_graph(vertices, edges, seed=seed)
    nx.add_path(network, range(vertices))
    return Graph(np.array(network.edges), vertices)


def test_emphases_equal_one_by_one():
    shares = np.resize([0.0, 0.3, 0.8, 0.99, 1 - 1e-6], len(SOME))
    found = minimum_commute_sweep(SMALL, emphasis=SOME, share=shares)
    weights, times, gaps = map(np.asarray, (found.weights, found.commute_time, found.gap))
    assert weights.shape == (len(SOME), 13)
    for problem in range(0, len(SOME), 3):
        share = float(shares[problem])
        single = minimum_commute(SMALL, SOME[problem], share)
        assert times[problem] == pytest.approx(single.commute_time, rel=1e-7)
        np.testing.assert_allclose(weights[problem], single.weights, atol=1e-4)
        tour = on_walk(SMALL, single.tour)
        assert weights[problem][tour].sum() >= share - 1e-12
    assert weights.min() >= 0
    np.testing.assert_allclose(weights.sum(axis=1), 1, atol=1e-12)
    assert gaps.max() <= 1e-8


# Sixteen edges and those of a path; of some, more are left than of others.
NINE = random_graph(9, 16, 0)
ALLOWED = np.random.default_rng(1).random((40, len(NINE.edges))) < np.resize(
    [[0.6], [0.8]], (40, 1)
)


def test_subsets_of_edges_equal_one_by_one():
    graph, allowed = NINE, ALLOWED
    found = minimum_commute_sweep(graph, allowed=allowed)
    weights, times, gaps = map(np.asarray, (found.weights, found.commute_time, found.gap))
    apart = np.array([not connected(graph, edges) for edges in allowed])
    assert apart.any()
    assert not apart.all()
    np.testing.assert_array_equal(np.isinf(times), apart)
    np.testing.assert_array_equal(np.isnan(weights).all(axis=1), apart)
    assert not gaps[apart].any()
    for problem in np.flatnonzero(~apart)[::3]:
        edges = allowed[problem]
        single = minimum_commute(Graph(graph.edges[edges], graph.vertices))
        assert times[problem] == pytest.approx(single.commute_time, rel=1e-7)
        np.testing.assert_allclose(weights[problem][edges], single.weights, atol=1e-4)
        assert not weights[problem][~edges].any()


def test_tours_keep_to_the_edges_that_are_allowed():
    graph, allowed, shares = NINE, ALLOWED, np.linspace(0.1, 0.95, 40)
    found = minimum_commute_sweep(graph, allowed=allowed, emphasis=[[0, 4, 8]], share=shares)
    several = 0
    times = np.asarray(found.commute_time)
    for edges, share, time in zip(allowed[1::2], shares[1::2], times[1::2], strict=True):
        if connected(graph, edges):
            single = minimum_commute(Graph(graph.edges[edges], 9), [0, 4, 8], float(share))
            assert time == pytest.approx(single.commute_time, rel=1e-7)
            several += 1
    assert several > 3


def test_a_tolerance_below_rounding_is_not_met():
    with pytest.raises(RuntimeError, match=r"minimum_commute_sweep, problem \d+: the residual"):
        minimum_commute_sweep(SMALL, emphasis=SOME, tolerance=1e-300)
    found = minimum_commute_sweep(SMALL, emphasis=SOME, tolerance=1e-300, throw=False)
    assert np.asarray(found.gap).max() < 1e-10


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"allowed": np.ones((2, 3), bool)}, r"allowed: expected booleans \[problems, 13\], got"),
        ({"allowed": np.ones((2, 13))}, "allowed: expected booleans .*, got float64"),
        ({"share": 1.0}, r"share: expected numbers of 0 or more and less than 1, got \[1.\]"),
        ({"share": [0.5, np.nan]}, "share: expected numbers of 0 or more"),
        ({"emphasis": SOME, "share": [0.1, 0.2]}, "share: expected one problem, or 84, got 2"),
        ({"emphasis": []}, "emphasis: expected one problem, or 1, got 0"),
        ({"emphasis": [[0, 1], [0, 8]]}, r"emphasis\[1\]: vertex 8 does not exist"),
        ({"emphasis": [[0, 1], [2]]}, r"emphasis\[1\]: expected two or more vertices"),
        ({"tolerance": 0.0}, "tolerance: expected a positive number, got 0.0"),
    ],
)
def test_refuses(arguments, message):
    with pytest.raises(ValueError, match=message):
        minimum_commute_sweep(SMALL, **arguments)
