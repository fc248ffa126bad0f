import jax.numpy as jnp
import networkx as nx
import numpy as np
import pytest
import scipy.optimize
from graphs import connected_graphs
from hypothesis import given, strategies as st

from jaxcell.optimize import Graph
from jaxcell.patrol.walks.optimal.descent import descend
from jaxcell.patrol.walks.optimal.polytope import ChainPolytope
from jaxcell.patrol.walks.optimal.sinkhorn import scale_to_stationary


PATH = Graph([[0, 1], [1, 2], [2, 3]])
SQUARE = Graph([[0, 1], [1, 2], [2, 3], [3, 0], [0, 2]])


def most_flow(moves, share, move):
    """The largest flow through one move of all with the distribution, or None if there are none."""
    sums = np.zeros((2 * share.size, len(moves)))
    sums[moves[:, 0], np.arange(len(moves))] = 1
    sums[share.size + moves[:, 1], np.arange(len(moves))] = 1
    cost = -(np.arange(len(moves)) == move).astype(float)
    found = scipy.optimize.linprog(cost, A_eq=sums, b_eq=np.tile(share, 2))
    return None if found.status == 2 else -found.fun


@given(connected_graphs(6), st.booleans(), st.integers(0, 1000))
def test_moves_are_those_that_the_distribution_allows(graph, stay, seed):
    # Small whole numbers, so that many sums are just reached.
    share = np.random.default_rng(seed).integers(1, 4, graph.vertices).astype(float)
    share /= share.sum()
    loops = np.repeat(np.arange(graph.vertices * stay)[:, None], 2, axis=1)
    moves = np.concatenate([graph.edges, graph.edges[:, ::-1], loops])
    flows = [most_flow(moves, share, move) for move in range(len(moves))]
    allowed = {tuple(m) for m, f in zip(moves.tolist(), flows, strict=True) if f and f > 1e-7}
    try:
        among = ChainPolytope.on(graph, share, stay=stay)
    except ValueError as error:
        if flows[0] is None:
            assert "of the time, but" in str(error)
        else:
            # Flows that balance come back, so that parts without a way have none back either.
            assert "no chain with it visits all" in str(error)
            parts = nx.empty_graph(graph.vertices)
            parts.add_edges_from(allowed)
            assert not nx.is_connected(parts)
        return
    assert allowed == set(zip(among.tails.tolist(), among.heads.tolist(), strict=True))


@given(connected_graphs(6), st.integers(0, 1000), st.booleans())
def test_starts_are_inside(graph, seed, free):
    share = np.random.default_rng(seed).dirichlet(np.full(graph.vertices, 3.0))
    among = ChainPolytope.on(graph, None if free else share, stay=True)
    sums, sides = among.equalities()
    for start in among.starts(3, 2, seed).reshape(-1, among.tails.size):
        assert start.min() > 0
        np.testing.assert_allclose(sums @ start, sides, atol=1e-12)
        matrix = among.matrix(start)
        np.testing.assert_allclose(matrix.sum(axis=1), 1, atol=1e-12)
        if not free:
            np.testing.assert_allclose(share @ matrix, share, atol=1e-12)


def test_scaling_keeps_the_weights_up_to_rows_and_columns():
    random = np.random.default_rng(0)
    share = random.dirichlet(np.ones(6))
    # Some flows almost vanish.
    weights = np.exp(random.normal(scale=6, size=(6, 6)))
    matrix = scale_to_stationary(weights, share)
    np.testing.assert_allclose(share @ matrix, share, atol=1e-14)
    ratio = np.log(matrix / weights)
    ratio -= ratio[:1]
    np.testing.assert_allclose(ratio, np.repeat(ratio[:, :1], 6, axis=1), atol=1e-9)


@given(connected_graphs(6), st.integers(0, 1000), st.booleans())
def test_gap_is_that_of_the_best_corner(graph, seed, free):
    random = np.random.default_rng(seed)
    share = random.dirichlet(np.full(graph.vertices, 3.0))
    among = ChainPolytope.on(graph, None if free else share, stay=True)
    here = among.starts(2, 1, seed)[1, 0]
    gains = random.normal(size=here.size)
    sums, sides = among.equalities()
    best = -scipy.optimize.linprog(-gains, A_eq=sums, b_eq=sides).fun
    assert among.gap(here, gains) == pytest.approx(best - gains @ here, abs=1e-6)


def off_target(matrices, target):
    return jnp.sum((matrices[0] - target) ** 2)


@pytest.mark.parametrize("given_share", [False, True])
def test_descent_to_the_nearest_chain(given_share):
    cvxpy = pytest.importorskip("cvxpy")
    random = np.random.default_rng(3)
    share = random.dirichlet(np.full(4, 3.0))
    # Far outside, so that the nearest is on the boundary.
    target = random.normal(size=(4, 4))
    among = ChainPolytope.on(SQUARE, share if given_share else None, stay=True)
    found, values, _ = descend(off_target, among, among.starts(3, 1, 0), (target,))
    chain = cvxpy.Variable(among.tails.size, nonneg=True)
    sums, sides = among.equalities()
    wanted = target[among.tails, among.heads]
    problem = cvxpy.Problem(
        cvxpy.Minimize(cvxpy.sum_squares(chain - wanted)), [sums @ chain == sides]
    )
    problem.solve(solver="CLARABEL")
    outside = (target**2).sum() - (wanted**2).sum()
    np.testing.assert_allclose(values, problem.value + outside, rtol=1e-7)
    np.testing.assert_allclose(found[:, 0], np.tile(chain.value, (3, 1)), atol=1e-4)


def test_starts_differ_and_the_first_is_not_random():
    among = ChainPolytope.on(SQUARE)
    first, again = among.starts(2, 2, 0), among.starts(2, 2, 1)
    np.testing.assert_array_equal(first[0, 0], again[0, 0])
    assert np.abs(first[1] - again[1]).max() > 0.01
    assert np.abs(first[0, 0] - first[0, 1]).max() > 0.01
    # It goes round one way.
    matrix = among.matrix(first[0, 0])
    assert np.abs(matrix - matrix.T).max() > 0.5


@pytest.mark.parametrize(
    ("graph", "arguments", "message"),
    [
        (Graph([[0, 1], [2, 3]]), {}, r"vertices 2, 3 \(2 of 4\) cannot be reached from vertex 0"),
        (PATH, {"stationary": [0.25] * 4}, "visits all vertices, because vertices 2, 3 .* cannot"),
        (
            PATH,
            {"stationary": [0.4, 0.2, 0.2, 0.2]},
            "vertices 0.* have .* of the time, but .* only .*; a patroller that may stay could",
        ),
    ],
)
def test_chains_that_do_not_exist_are_refused(graph, arguments, message):
    with pytest.raises(ValueError, match=message):
        ChainPolytope.on(graph, **arguments)
