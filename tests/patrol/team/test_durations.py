import numpy as np
import pytest
from walks import times_by_solves, walk_on

from jaxcell.optimize import Graph
from jaxcell.patrol.team import timed, whole_times


GRAPH = Graph([[0, 1], [1, 2], [2, 3], [3, 0], [0, 2]])
TIMES = [1, 4, 2, 3, 5]


def in_units(matrix, taken):
    """The chain that needs a step for each unit of time, with states on the way after vertices."""
    states = len(matrix) + int((taken - 1)[matrix > 0].sum())
    whole, free = np.zeros((states, states)), len(matrix)
    for tail, head in np.argwhere(matrix > 0):
        here, chance = tail, matrix[tail, head]
        for _ in range(taken[tail, head] - 1):
            whole[here, free] = chance
            here, chance, free = free, 1.0, free + 1
        whole[here, head] += chance
    return whole


def test_times_are_those_of_the_graph_with_vertices_on_the_way():
    lazy = 0.8 * walk_on(GRAPH, [1, 2, 1, 1, 3]) + 0.2 * np.eye(4)
    taken = 2 * np.eye(4, dtype=int)
    for (tail, head), time in zip(GRAPH.edges, TIMES, strict=True):
        taken[tail, head] = taken[head, tail] = time
    whole = in_units(lazy, taken)
    shares = np.stack([np.linalg.matrix_power(lazy, 2000)[0]] * 2)
    found = timed(GRAPH, np.stack([lazy, lazy]), shares, TIMES, 2.0)
    np.testing.assert_allclose(found.hitting_time, times_by_solves(whole)[:4, :4], rtol=1e-9)
    share = np.linalg.matrix_power((whole + np.eye(len(whole))) / 2, 4096)[0]
    # Each of the two robots begins a stay, or passes, as often as the chain in units of time does.
    np.testing.assert_allclose(found.idleness, 1 / (2 * share[:4]), rtol=1e-6)
    assert found.checks()["timed_hitting_time_residual"][0] < 1e-12


def test_vertices_left_out_are_never_reached():
    walk = np.array([[[0, 1, 0], [1, 0, 0], [0, 1, 0.0]]])
    found = timed(Graph([[0, 1], [1, 2]]), walk, np.array([[0.5, 0.5, 0]]), [2, 7], 1.0)
    assert found.hitting_time.tolist() == [[0, 2, np.inf], [2, 0, np.inf], [9, 7, 0]]
    assert found.idleness.tolist() == [4, 4, np.inf]


def test_times_are_whole_and_at_least_one_unit():
    graph = Graph([[0, 1], [1, 2]], ways=[0.2, 12.4])
    assert whole_times(graph, 0.5, 2.0).tolist() == [1, 13]
    assert whole_times(graph, 0.5, 0.1).tolist() == [4, 248]
    assert whole_times(graph, 0.5, 0.1) @ [0.1, 0] == pytest.approx(0.4)


def test_no_whole_time_is_shorter_than_the_travel_time():
    graph = Graph([[0, 1], [1, 2], [2, 0]], ways=[14.0, 0.3, 20.0])
    assert whole_times(graph, 1.0, 10.0).tolist() == [2, 1, 2]
    # 0.3 / 0.1 is more than 3 in floating point.
    assert whole_times(graph, 1.0, 0.1).tolist() == [140, 3, 200]
