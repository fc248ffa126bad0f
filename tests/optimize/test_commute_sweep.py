import itertools

import jax
import jax.numpy as jnp
import networkx as nx
import numpy as np
import pytest

from jaxcell.optimize.commute_sweep import commute_weights, minimum_commute_sweep
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


@pytest.mark.parametrize("share", [0.0, 0.3, 0.8, 0.99, 1 - 1e-6])
def test_emphases_equal_one_by_one(share):
    found = minimum_commute_sweep(SMALL, emphasis=SOME, share=share)
    weights, times, gaps = map(np.asarray, (found.weights, found.commute_time, found.gap))
    assert weights.shape == (len(SOME), 13)
    for problem in range(0, len(SOME), 7):
        single = minimum_commute(SMALL, SOME[problem], share)
        assert times[problem] == pytest.approx(single.commute_time, rel=1e-7)
        np.testing.assert_allclose(weights[problem], single.weights, atol=1e-4)
        tour = on_walk(SMALL, single.tour)
        assert weights[problem][tour].sum() >= share - 1e-12
    assert weights.min() >= 0
    np.testing.assert_allclose(weights.sum(axis=1), 1, atol=1e-12)
    assert gaps.max() <= 1e-8


@pytest.mark.parametrize("kept", [0.6, 0.8])
def test_subsets_of_edges_equal_one_by_one(kept):
    graph = random_graph(9, 16, 0)
    allowed = np.random.default_rng(1).random((60, len(graph.edges))) < kept
    found = minimum_commute_sweep(graph, allowed=allowed)
    weights, times, gaps = map(np.asarray, (found.weights, found.commute_time, found.gap))
    apart = np.array([not connected(graph, edges) for edges in allowed])
    assert apart.any()
    assert not apart.all()
    np.testing.assert_array_equal(np.isinf(times), apart)
    np.testing.assert_array_equal(np.isnan(weights).all(axis=1), apart)
    assert not gaps[apart].any()
    for problem in np.flatnonzero(~apart):
        edges = allowed[problem]
        single = minimum_commute(Graph(graph.edges[edges], graph.vertices))
        assert times[problem] == pytest.approx(single.commute_time, rel=1e-7)
        np.testing.assert_allclose(weights[problem][edges], single.weights, atol=1e-4)
        assert not weights[problem][~edges].any()


def test_tours_keep_to_the_edges_that_are_allowed():
    graph = random_graph(10, 22, 3)
    allowed = np.random.default_rng(2).random((20, len(graph.edges))) < 0.8
    shares = np.linspace(0.1, 0.95, 20)
    found = minimum_commute_sweep(graph, allowed=allowed, emphasis=[[0, 4, 9]], share=shares)
    several = 0
    for edges, share, time in zip(allowed, shares, found.commute_time, strict=True):
        if connected(graph, edges):
            single = minimum_commute(Graph(graph.edges[edges], 10), [0, 4, 9], float(share))
            assert time == pytest.approx(single.commute_time, rel=1e-7)
            several += 1
    assert several > 3


def test_runs_under_vmap_and_jit():
    # Over the share, which the sweep does not compile again for.
    on_tour = on_walk(SMALL, np.array([1, 2, 3]))
    solve = jax.vmap(commute_weights, in_axes=(None, None, None, None, 0, None))
    shares = jnp.array([0.2, 0.9])
    found = jax.jit(solve, static_argnums=0)(
        8, jnp.asarray(SMALL.edges), on_tour, jnp.ones(13, bool), shares, jnp.array(1e-9)
    )
    singles = [minimum_commute(SMALL, [1, 2, 3], share) for share in (0.2, 0.9)]
    expected = [single.commute_time for single in singles]
    np.testing.assert_allclose(found.commute_time, expected, rtol=1e-8)


def test_a_tolerance_below_rounding_is_not_met():
    with pytest.raises(RuntimeError, match=r"minimum_commute_sweep, problem \d+: the residual"):
        minimum_commute_sweep(SMALL, emphasis=SOME, tolerance=1e-300)
    found = minimum_commute_sweep(SMALL, emphasis=SOME, tolerance=1e-300, throw=False)
    assert float(found.gap.max()) < 1e-10


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
