import itertools
import warnings

import cvxpy
import networkx as nx
import numpy as np
import pytest
from graphs import MIXING, SMALL, graph_of, incidence, random_graph
from hypothesis import given, strategies as st

from jaxcell.base.certificate import Outcome
from jaxcell.optimize.graph import Graph
from jaxcell.optimize.mixing import fastest_mixing


def second_modulus(matrix):
    """Of a matrix with eigenvalue 1, from its eigenvalues."""
    return float(np.sort(np.abs(np.linalg.eigvals(matrix)))[-2])


def check_chain(graph, walk, stationary):
    np.testing.assert_allclose(walk.transition.sum(axis=1), 1, atol=1e-12)
    assert walk.transition.min() >= 0
    flow = stationary[:, None] * walk.transition
    np.testing.assert_allclose(flow, flow.T, atol=1e-14)
    tail, head = graph.edges.T
    np.testing.assert_allclose(flow[tail, head], walk.weights, atol=1e-14)
    np.testing.assert_allclose(np.diag(flow), walk.holding, atol=1e-14)
    joined = graph.matrix(np.ones(len(tail))).toarray() + np.eye(graph.vertices)
    assert not walk.transition[joined == 0].any()
    assert walk.rate == pytest.approx(second_modulus(walk.transition), abs=1e-9)


def least_by_cvxpy(graph, stationary):
    n = graph.vertices
    w = cvxpy.Variable(len(graph.edges), nonneg=True)
    root = np.sqrt(stationary)
    scaled = incidence(graph) / root[:, None]
    matrix = np.eye(n) - np.outer(root, root) - scaled @ cvxpy.diag(w) @ scaled.T
    limits = [np.abs(incidence(graph)) @ w <= stationary]
    problem = cvxpy.Problem(cvxpy.Minimize(cvxpy.sigma_max(matrix)), limits)
    with warnings.catch_warnings():
        # Some versions stop a little before their own tolerance.
        warnings.filterwarnings("ignore", "Solution may be inaccurate")
        return float(problem.solve(solver="CLARABEL"))


def test_the_small_graph():
    # The rate is published with the example; the weights are by another interior-point method.
    walk = fastest_mixing(SMALL)
    assert walk.rate == pytest.approx(0.6809607, abs=5e-8)
    np.testing.assert_allclose(8 * walk.weights, MIXING, atol=2e-5)
    check_chain(SMALL, walk, np.full(8, 1 / 8))
    np.testing.assert_allclose(walk.weights[[1, 2, 8]], walk.weights[[4, 9, 11]], atol=1e-6)


def closed_forms():
    """Adjacency matrices of graphs, with the rate, matrix and tolerance of their fastest chains."""
    for n in (2, 3, 8, 30):
        path = nx.to_numpy_array(nx.path_graph(n))
        yield path, np.cos(np.pi / n), (path + np.diag(2 - path.sum(axis=0))) / 2, 1e-5
        yield 1 - np.eye(n), 0, np.full((n, n), 1 / n), 1e-6
    # A hub and a rim of four. With probabilities a along the rim and b along the spokes, the
    # eigenvalues are 1 - 5 b, 1 - 2 a - b twice and 1 - 4 a - b, and b is at most 1/4.
    wheel = nx.to_numpy_array(nx.wheel_graph(5))
    yield wheel, 1 / 4, (wheel + np.diag([0, 1, 1, 1, 1])) / 4, 1e-6


@pytest.mark.parametrize(("joined", "rate", "transition", "atol"), [*closed_forms()])
def test_closed_forms(joined, rate, transition, atol):
    walk = fastest_mixing(graph_of(nx.from_numpy_array(joined)))
    assert walk.rate == pytest.approx(rate, abs=1e-7)
    np.testing.assert_allclose(walk.transition, transition, atol=atol)


@given(st.integers(2, 9), st.integers(0, 12), st.integers(0, 10_000), st.booleans())
def test_no_chain_is_faster(n, more, seed, even):
    random = np.random.default_rng(seed)
    graph = random_graph(n, min(n - 1 + more, n * (n - 1) // 2), seed)
    pi = np.full(n, 1 / n) if even else random.dirichlet(np.full(n, 5.0))
    walk = fastest_mixing(graph, None if even else pi)
    assert walk.certificate.outcome is Outcome.CONVERGED
    check_chain(graph, walk, pi)
    # Other chains, near and far, are no faster than the certificate allows.
    least = walk.rate - walk.certificate.residual * (1 - walk.rate)
    for scale in (1e-3, 1e-1, 1):
        for _ in range(5):
            other = random.uniform(0, 1, len(graph.edges))
            at = np.bincount(graph.edges.ravel(), np.repeat(other, 2), n)
            other *= np.minimum(1, pi / at)[graph.edges].min(axis=1)
            mixed = walk.weights + scale * (other - walk.weights)
            flow = graph.matrix(mixed).toarray()
            np.fill_diagonal(flow, pi - flow.sum(axis=0))
            assert second_modulus(flow / pi[:, None]) >= least - 1e-9


@pytest.mark.parametrize(("vertices", "edges", "seed"), [(6, 9, 0), (12, 20, 1), (20, 35, 2)])
def test_equals_cvxpy(vertices, edges, seed):
    graph = random_graph(vertices, edges, seed)
    even = np.full(vertices, 1 / vertices)
    pi = np.random.default_rng(seed).dirichlet(np.full(vertices, 5.0))
    for stationary in (even, pi):
        expected = least_by_cvxpy(graph, stationary)
        assert fastest_mixing(graph, stationary).rate == pytest.approx(expected, abs=1e-6)


def test_a_given_distribution_is_that_of_the_chain():
    pi = np.array([0.1, 0.2, 0.3, 0.4])
    graph = Graph(list(itertools.combinations(range(4), 2)))
    walk = fastest_mixing(graph, pi)
    # Independent draws are possible, and nothing forgets faster.
    np.testing.assert_allclose(walk.transition, np.tile(pi, (4, 1)), atol=1e-6)
    later = walk.chain.push(np.array([1.0, 0, 0, 0]))
    np.testing.assert_allclose(later, pi, atol=1e-6)


def test_a_tolerance_below_rounding_is_not_met():
    with pytest.raises(RuntimeError, match="fastest_mixing: the residual stayed above"):
        fastest_mixing(SMALL, tolerance=1e-300)
    walk = fastest_mixing(SMALL, tolerance=1e-300, throw=False)
    assert walk.certificate.outcome is Outcome.STALLED
    assert walk.certificate.residual < 1e-9


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"stationary": [0.5, 0.5]}, r"stationary: expected 3 numbers, one per vertex, got \[2\]"),
        ({"stationary": [0.5, 0.5, 0.0]}, r"stationary\[2\] is 0.0; expected a positive finite"),
        ({"stationary": [0.5, np.nan, 0.5]}, r"stationary\[1\] is nan"),
        ({"stationary": [0.5, 0.5, 0.5]}, "stationary: expected numbers that sum to 1, got 1.5"),
        ({"tolerance": 0.0}, "tolerance: expected a positive number, got 0.0"),
    ],
)
def test_wrong_arguments_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        fastest_mixing(Graph([[0, 1], [1, 2]]), **arguments)
