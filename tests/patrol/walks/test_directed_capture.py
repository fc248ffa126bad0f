"""Capture on directed graphs, and with prescribed shares, against own recursions and searches."""

import itertools

import numpy as np
import pytest
import scipy.optimize

from jaxcell.patrol import Graph, maximin_capture
from jaxcell.patrol.walks import blind_capture, capture_bound, walk_capture_probabilities


# A ring of one-way streets with chords: the time from each vertex to each, and of waits.
TIMES = np.array([[1, 2, 0, 3], [0, 1, 1, 0], [2, 0, 0, 1], [1, 2, 3, 1]])
GRAPH = Graph([(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)])
SHARES = np.array([0.3, 0.2, 0.2, 0.3])


def reached(matrix, times, attack):
    """Compute the probability of the first visit to each vertex by each time, with plain loops."""
    count = len(times)
    first = np.zeros((attack + 1, count, count))
    ways = list(zip(*np.nonzero(times), strict=True))
    for now, target in itertools.product(range(1, attack + 1), range(count)):
        for start, end in ways:
            left = now - times[start, end]
            if end == target:
                first[now, start, target] += matrix[start, end] * (left == 0)
            elif left > 0:
                first[now, start, target] += matrix[start, end] * first[left, end, target]
    return first.sum(axis=0)


def test_capture_with_directed_times_is_that_of_plain_loops():
    weights = np.random.default_rng(1).uniform(size=(4, 4)) * (TIMES > 0)
    matrix = weights / weights.sum(axis=1, keepdims=True)
    for attack in (3, 6):
        found = walk_capture_probabilities(GRAPH, matrix, attack, TIMES)
        np.testing.assert_allclose(found, reached(matrix, TIMES, attack), rtol=0, atol=1e-14)


def test_blind_capture_with_directed_times_is_that_of_a_long_walk():
    weights = np.random.default_rng(2).uniform(size=(4, 4)) * (TIMES > 0)
    matrix = weights / weights.sum(axis=1, keepdims=True)
    random, place, now = np.random.default_rng(3), 0, 0
    visits = []
    for draw in random.uniform(size=40_000):
        after = int(np.searchsorted(np.cumsum(matrix[place]), draw))
        now, place = now + TIMES[place, after], after
        visits.append((now, place))
    at, where = np.array(visits).T
    for vertex, share in enumerate(blind_capture(GRAPH, [matrix], 4, TIMES)):
        gaps = np.diff(at[where == vertex])
        parts = [part for part in np.array_split(gaps, 20) if part.size]
        each = [np.minimum(part, 4).sum() / part.sum() for part in parts]
        assert abs(np.mean(each) - share) <= 3 * np.std(each) / len(each) ** 0.5 + 1e-3


def best_with_shares(times, attack, shares, seeds):
    """Maximise the least capture by SLSQP, with its level as a variable, from random starts."""
    ways = np.nonzero(times)
    best = 0.0

    def matrix_of(x):
        matrix = np.zeros(times.shape)
        matrix[ways] = x[:-1]
        return matrix

    def equal(x):
        matrix = matrix_of(x)
        return np.append(matrix.sum(axis=1) - 1, (shares @ matrix - shares)[:-1])

    def above(x):
        return reached(matrix_of(x), times, attack).ravel() - x[-1]

    for seed in range(seeds):
        start = np.append(np.random.default_rng(seed).dirichlet(np.ones(ways[0].size)), 0.0)
        found = scipy.optimize.minimize(
            lambda x: -x[-1], start, method="SLSQP", bounds=[(0, 1)] * start.size,
            constraints=[
                {"type": "eq", "fun": equal},
                {"type": "ineq", "fun": above},
            ],
        )  # fmt: skip
        if found.success and abs(equal(found.x)).max() < 1e-7:
            best = max(best, float(reached(matrix_of(found.x), times, attack).min()))
    return best


def test_walk_with_prescribed_shares_is_that_of_an_own_search():
    attack = 8
    given = {"travel_times": TIMES, "stay": True}
    found = maximin_capture(GRAPH, attack, stationary=SHARES, throw=False, **given)
    matrix = found.matrices[0]
    assert (matrix[TIMES == 0] == 0).all()
    np.testing.assert_allclose(matrix.sum(axis=1), 1, rtol=0, atol=1e-12)
    np.testing.assert_allclose(SHARES @ matrix, SHARES, rtol=0, atol=1e-9)
    assert found.value == pytest.approx(reached(matrix, TIMES, attack).min(), abs=1e-12)
    assert found.value == pytest.approx(best_with_shares(TIMES, attack, SHARES, 6), abs=1e-3)
    free = maximin_capture(GRAPH, attack, throw=False, **given).value
    assert found.value <= free + 1e-6 <= capture_bound(GRAPH, attack, **given) + 2e-6


def test_team_keeps_the_shares_of_each_robot():
    given = {"travel_times": TIMES, "stay": True, "stationary": SHARES, "throw": False}
    found = maximin_capture(GRAPH, 8, robots=2, starts=2, **given)
    for matrix in found.matrices:
        np.testing.assert_allclose(SHARES @ matrix, SHARES, rtol=0, atol=1e-9)
    missed = [1 - reached(matrix, TIMES, 8).min(axis=0) for matrix in found.matrices]
    assert found.value == pytest.approx(1 - np.prod(missed, axis=0).max(), abs=1e-12)


def test_wrong_times_and_shares_are_refused():
    path = Graph([(0, 1), (1, 2)])
    with pytest.raises(ValueError, match="only between the ends of edges"):
        maximin_capture(path, 3, travel_times=np.ones((3, 3), int))
    with pytest.raises(ValueError, match=r"an array \[3, 3\]"):
        walk_capture_probabilities(path, np.eye(3), 3, np.full((2, 2), 1))
    with pytest.raises(ValueError, match="stationary: expected no memory"):
        maximin_capture(path, 4, stationary=[0.25, 0.5, 0.25], memory=2)
    with pytest.raises(ValueError, match="stationary: vertices"):
        maximin_capture(path, 4, stationary=[0.4, 0.2, 0.4])
    one_way = np.array([[0, 1, 0], [0, 0, 1], [0, 1, 0]])
    with pytest.raises(ValueError, match="attack_time: a robot needs inf"):
        maximin_capture(path, 4, travel_times=one_way)
