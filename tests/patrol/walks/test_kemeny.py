import networkx as nx
import numpy as np
import pytest
from graphs import graph_of
from walks import by_slsqp

from jaxcell.base.certificate import Outcome
from jaxcell.markov import kemeny_constant
from jaxcell.patrol.walks.optimal.kemeny import minimum_kemeny
from jaxcell.patrol.walks.optimal.polytope import ChainPolytope


def kemeny(matrix):
    """By the eigenvalues."""
    values = np.linalg.eigvals(matrix)
    values = np.delete(values, np.argmin(np.abs(values - 1)))
    return float(np.sum(1 / (1 - values)).real)


TREES = [nx.star_graph(5), nx.path_graph(6), nx.Graph([(0, 1), (1, 2), (1, 3), (3, 4), (3, 5)])]
# A Hamiltonian graph and, with as many edges, one whose longest cycle has 4 vertices.
GRID = nx.grid_2d_graph(2, 3)
KITES = nx.Graph([(0, 1), (1, 2), (2, 3), (3, 0), (0, 2), (0, 4), (4, 5)])


@pytest.mark.parametrize("network", [*TREES, GRID, KITES])
def test_the_least_of_all_chains(network):
    # (2 n - k - 1) / 2 with k the length of the longest cycle (Kirkland 2010).
    longest = max(len(cycle) for cycle in nx.simple_cycles(network.to_directed()))
    walk = minimum_kemeny(graph_of(network))
    assert walk.value == pytest.approx((2 * 6 - longest - 1) / 2, rel=1e-5)
    assert walk.value == pytest.approx(kemeny(walk.matrix), rel=1e-6)
    assert walk.certificate.outcome is Outcome.CONVERGED


def test_the_default_start_goes_round():
    walk = minimum_kemeny(graph_of(GRID), starts=1)
    assert walk.value == pytest.approx(2.5, rel=1e-6)
    assert kemeny_constant(walk.chain) == pytest.approx(walk.value, rel=1e-6)


def test_no_chain_of_another_solver_is_better():
    share = np.random.default_rng(1).dirichlet(np.full(6, 4.0))
    graph = graph_of(GRID)
    walk = minimum_kemeny(graph, share, stay=True)
    np.testing.assert_allclose(share @ walk.matrix, share, atol=1e-9)
    among = ChainPolytope.on(graph, share, stay=True)
    assert walk.value <= min(by_slsqp(among, kemeny, 6, 5)) * (1 + 1e-5)


def test_no_starts_and_a_gap_that_stays_are_refused():
    with pytest.raises(ValueError, match="starts: expected a whole number of at least 1, got 0"):
        minimum_kemeny(graph_of(GRID), starts=0)
    with pytest.raises(RuntimeError, match=r"minimum_kemeny: the residual stayed above"):
        minimum_kemeny(graph_of(GRID), tolerance=1e-15)
    assert minimum_kemeny(graph_of(GRID), tolerance=1e-15, throw=False).value < 2.6
