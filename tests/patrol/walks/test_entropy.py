import itertools

import jax
import jax.numpy as jnp
import networkx as nx
import numpy as np
import pytest
from graphs import connected_graphs, graph_of, random_graph
from hypothesis import given, strategies as st
from walks import by_slsqp

from jaxcell.base.certificate import Outcome
from jaxcell.markov import dense
from jaxcell.optimize import Graph
from jaxcell.patrol.walks.optimal.entropy import (
    maximum_entropy_rate,
    maximum_return_time_entropy,
    return_time_entropy,
)
from jaxcell.patrol.walks.optimal.polytope import ChainPolytope


TRIANGLE = Graph([[0, 1], [1, 2], [2, 0], [2, 3]])


@given(connected_graphs(), st.booleans())
def test_free_entropy_rate_is_the_growth_of_the_number_of_walks(graph, stay):
    walk = maximum_entropy_rate(graph, stay=stay)
    ways = graph.matrix(np.ones(len(graph.edges))).toarray() + stay * np.eye(graph.vertices)
    assert walk.value == pytest.approx(np.log(np.linalg.norm(ways, 2)), abs=1e-10)
    values, vectors = np.linalg.eig(walk.matrix.T)
    share = vectors[:, np.argmin(np.abs(values - 1))].real
    surprise = -np.log(np.where(walk.matrix > 0, walk.matrix, 1))
    rate = share @ (walk.matrix * surprise).sum(axis=1) / share.sum()
    assert walk.value == pytest.approx(rate, abs=1e-9)
    assert walk.certificate.outcome is Outcome.CONVERGED


@pytest.mark.parametrize("seed", range(5))
def test_given_entropy_rate_against_cvxpy(seed):
    cvxpy = pytest.importorskip("cvxpy")
    graph = random_graph(6, 9, seed)
    share = np.random.default_rng(seed).dirichlet(np.full(6, 3.0))
    walk = maximum_entropy_rate(graph, share, stay=True)
    np.testing.assert_allclose(share @ walk.matrix, share, atol=1e-12)
    among = ChainPolytope.on(graph, share, stay=True)
    chain = cvxpy.Variable(among.tails.size, nonneg=True)
    sums, sides = among.equalities()
    rate = share[among.tails] @ cvxpy.entr(chain)
    problem = cvxpy.Problem(cvxpy.Maximize(rate), [sums @ chain == sides])
    problem.solve(solver="CLARABEL")
    assert walk.value == pytest.approx(problem.value, abs=1e-6)
    assert walk.certificate.outcome is Outcome.CONVERGED


def test_traced_entropy_rate_has_the_derivatives_of_independent_places():
    """A patroller who may step anywhere does best by drawing each place from its shares of time."""
    graph = Graph([[0, 1], [1, 2], [2, 0]])
    shares = np.random.default_rng(0).dirichlet(np.full(3, 3.0), 3)

    def found(share):
        walk = maximum_entropy_rate(graph, share, stay=True)
        return walk.matrix, walk.value

    def exact(share):
        share = share / share.sum()
        return jnp.tile(share, (3, 1)), -share @ jnp.log(share)

    for function, tolerance in ((lambda f: f, 1e-14), (jax.jacrev, 1e-12)):
        values = jax.jit(jax.vmap(function(found)))(shares)
        for value, truth in zip(values, jax.vmap(function(exact))(shares), strict=True):
            np.testing.assert_allclose(value, truth, atol=tolerance)


@pytest.mark.parametrize("edges", [TRIANGLE.edges, [[0, 1], [1, 2], [2, 3]]])
def test_traced_entropy_rate_has_the_derivatives_of_the_host(edges):
    graph = Graph(edges)
    share = np.array([0.2, 0.25, 0.3, 0.25])
    # The second graph has two sides, and each has half of the time.
    change = np.array([1.0, 2.0, -1.0, -2.0])

    def found(at):
        walk = maximum_entropy_rate(graph, share + at * change)
        return walk.matrix, walk.value

    slopes = jax.jit(jax.jacfwd(found))(0.0)
    for slope, above, below in zip(slopes, found(1e-5), found(-1e-5), strict=True):
        np.testing.assert_allclose(slope, (above - below) / 2e-5, atol=1e-8)
    refused = jax.jit(lambda share: maximum_entropy_rate(graph, share).value)
    assert np.isnan(refused(np.array([0.7, 0.1, 0.1, 0.1])))


def test_entropy_rate_where_some_moves_are_ruled_out():
    # All that is at 0 must come from 1 and go there, which leaves nothing for the edge from 1 to 2.
    with pytest.raises(ValueError, match="no chain with it visits all"):
        maximum_entropy_rate(Graph([[0, 1], [1, 2], [2, 3], [3, 4], [4, 2]]), [0.2] * 5)
    share = np.array([0.25, 0.375, 0.25, 0.125])
    path = Graph([[0, 1], [1, 2], [2, 3]])
    # In a tree the flows are determined: 2/8 between 0 and 1, 1/8 between the others.
    walk = maximum_entropy_rate(path, share)
    expected = [[0, 1, 0, 0], [2 / 3, 0, 1 / 3, 0], [0, 1 / 2, 0, 1 / 2], [0, 0, 1, 0]]
    np.testing.assert_allclose(walk.matrix, expected, atol=1e-9)


def test_return_time_entropy_against_all_walks():
    P = np.random.default_rng(0).dirichlet(np.full(3, 0.5), 3)
    expected = np.zeros((5, 3))
    for steps in range(1, 6):
        for start in range(3):
            others = [i for i in range(3) if i != start]
            for between in itertools.product(others, repeat=steps - 1):
                walk = [start, *between, start]
                expected[steps - 1, start] += np.prod(P[walk[:-1], walk[1:]])
    share = np.asarray(dense.stationary(P))
    entropy_within = jax.jit(return_time_entropy, static_argnums=1)
    entropy = -(share * (expected * np.log(expected)).sum(axis=0)).sum()
    assert float(entropy_within(P, 5)) == pytest.approx(entropy, rel=1e-12)
    # Without a horizon, it is between the entropy rate and n times that.
    rate = float(dense.entropy_rate(P))
    assert rate <= float(entropy_within(P, 2000)) <= 3 * rate


def test_independent_draws_have_the_most_return_time_entropy():
    # Of laws with the mean 1 / pi_i, the geometric law has most entropy, and a patroller that draws
    # each vertex independently from pi has it at all of them.
    graph = graph_of(nx.complete_graph(3))
    share = np.array([0.25, 0.35, 0.4])
    walk = maximum_return_time_entropy(graph, share, stay=True, horizon=80, starts=2)
    most = -np.sum((1 - share) * np.log(1 - share) + share * np.log(share))
    assert walk.value == pytest.approx(most, rel=1e-7)
    np.testing.assert_allclose(share @ walk.matrix, share, atol=1e-9)


# SLSQP of SciPy before 1.16 leaves its bounds by rounding.
@pytest.mark.filterwarnings("ignore:Values in x were outside bounds:RuntimeWarning")
def test_no_chain_of_another_solver_is_better():
    walk = maximum_return_time_entropy(TRIANGLE, horizon=12, starts=4)
    entropy = jax.jit(return_time_entropy, static_argnums=1)
    assert walk.value == pytest.approx(float(entropy(walk.matrix, 12)))
    among = ChainPolytope.on(TRIANGLE)
    others = by_slsqp(among, lambda matrix: -float(entropy(matrix, 12)), 4, 7)
    assert walk.value >= -min(others) - 1e-6


def test_no_horizon_is_refused():
    with pytest.raises(ValueError, match="horizon: expected a whole number of at least 1, got 0"):
        maximum_return_time_entropy(TRIANGLE, horizon=0)
