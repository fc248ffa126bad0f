import networkx as nx
import numpy as np
import pytest
from graphs import graph_of
from walks import walk_on

from jaxcell.optimize import Graph
from jaxcell.patrol.team import simulate_idleness


@pytest.mark.usefixtures("unchecked")
def test_a_walk_comes_as_often_as_its_share_of_time_says():
    graph = Graph([[0, 1], [1, 2], [2, 3], [3, 0], [0, 2]])
    P = walk_on(graph, [1, 2, 1, 1, 3])
    share = np.linalg.matrix_power((P + np.eye(4)) / 2, 200)[0]
    idleness = simulate_idleness(graph, P[None], attack_time=3)
    # A thousandth of a move is a visit more or less.
    assert idleness.mean[0] == pytest.approx((1 / share).mean(), rel=0.1)
    assert idleness.worst[0] == pytest.approx((1 / share).max(), rel=0.15)
    # From any time on, the attack of three steps fails unless the vertex is avoided.
    missed = []
    for target in range(4):
        keep = np.arange(4) != target
        Q = P[np.ix_(keep, keep)]
        missed.append(float(share @ P[:, keep] @ Q @ Q @ np.ones(3)))
    assert idleness.least_capture[0] == pytest.approx(1 - max(missed), abs=0.06)


@pytest.mark.usefixtures("unchecked")
def test_robots_on_a_tour_are_equally_far_apart():
    """Of networkx's ring of 12, and with edges that take longer than others."""
    graph = graph_of(nx.cycle_graph(12))
    matrices = np.stack([walk_on(graph)] * 3)
    idleness = simulate_idleness(graph, matrices)
    assert idleness.patrol == ["walk", "tour", "random", "reactive"]
    tour = [getattr(idleness, name)[1] for name in ("mean", "worst", "longest")]
    assert tour == pytest.approx([4, 4, 4])
    # No patrol does better than that, and random robots do worse.
    assert idleness.mean.min() >= 4 - 1e-9
    assert idleness.worst[2] > 4
    times = np.where(np.arange(12) < 6, 1, 3)
    slow = simulate_idleness(graph, matrices, times=times)
    assert slow.mean[1] == pytest.approx(times.sum() / 3, rel=1e-3)


def test_a_reactive_robot_walks_round_a_ring():
    graph = graph_of(nx.cycle_graph(9))
    idleness = simulate_idleness(graph, walk_on(graph)[None], attack_time=[5] * 9)
    assert idleness.longest[3] == idleness.mean[3] == 9
    assert idleness.least_capture[3] == pytest.approx(5 / 9)


@pytest.mark.usefixtures("unchecked")
def test_idleness_of_vertices_that_a_walk_leaves_out_is_infinite():
    graph = Graph([[0, 1], [1, 2]])
    to_and_fro = np.array([[[0.0, 1, 0], [1, 0, 0], [0, 1, 0]]])
    idleness = simulate_idleness(graph, to_and_fro, attack_time=2)
    assert idleness.worst[0] == idleness.longest[0] == np.inf
    assert idleness.least_capture[0] == 0
    assert np.isfinite(idleness.worst[1:]).all()


@pytest.mark.usefixtures("unchecked")
def test_a_unit_of_time_only_scales_idleness():
    """Visits that coincide at 0.1 + 0.2 = 0.3 count once."""
    graph = graph_of(nx.complete_graph(8))
    matrices = np.stack([walk_on(graph)] * 9)
    times = np.arange(28) % 3 + 1
    whole = simulate_idleness(graph, matrices, times=times, attack_time=2)
    tenths = simulate_idleness(graph, matrices, times=times * 0.1, attack_time=0.2)
    for name in ("mean", "worst", "longest"):
        np.testing.assert_allclose(getattr(tenths, name), getattr(whole, name) / 10)
    np.testing.assert_allclose(tenths.least_capture, whole.least_capture)


@pytest.mark.usefixtures("unchecked")
def test_the_error_says_how_far_a_simulation_is_from_the_exact_idleness():
    """On a line of 12, whose random walk is slow to spread, over four simulations."""
    graph = Graph([[i, i + 1] for i in range(11)])
    walk = walk_on(graph)[None]
    degree = np.bincount(graph.edges.ravel())
    exact = degree.sum() / degree
    found = [simulate_idleness(graph, walk, seed=seed) for seed in range(4)]
    for name, value in (("mean", exact.mean()), ("worst", exact.max())):
        off = np.array([getattr(one, name)[0] for one in found]) - value
        error = np.array([getattr(one, f"{name}_error")[0] for one in found])
        assert np.sqrt((off**2).mean()) < 2.5 * error.mean()
        assert error.max() < value / 5
