import numpy as np
import pytest
from walks import walk_on

from jaxcell.optimize import Graph
from jaxcell.patrol.team import age_of_news


GRAPH = Graph([[0, 1], [1, 2], [2, 3], [3, 0], [0, 2]])
TIMES = np.array([1, 3, 2, 1, 2])
BASE, STEPS = 1, 60_000


def positions(matrix, delays, random):
    """The vertex of a robot at each unit of time; -1 between vertices."""
    place, here = np.full(STEPS, -1), 0
    total, time = matrix.cumsum(axis=1), 0
    while time < STEPS:
        place[time] = here
        there = int(np.searchsorted(total[here], random.random() * total[here, -1]))
        time, here = time + int(delays[here, there]), there
    return place


def ages(team):
    """Since a robot passed the base, and of the news of each vertex, at each time of a run."""
    vertices = GRAPH.vertices
    seen = np.full((len(team), vertices), -np.inf)
    known, passed = np.full(vertices, -np.inf), -np.inf
    found = []
    for time in range(STEPS):
        for robot, place in enumerate(team):
            if place[time] >= 0:
                seen[robot, place[time]] = time
            if place[time] == BASE:
                known, passed = np.maximum(known, seen[robot]), time
        found.append(time - np.append(known, passed))
    return np.array(found)[1000:]


@pytest.mark.parametrize("times", [None, TIMES])
def test_two_robots_against_a_run_of_them(times):
    lazy = 0.7 * walk_on(GRAPH, [3, 1, 1, 4, 1]) + 0.3 * np.eye(4)
    walks = np.stack([walk_on(GRAPH, [1, 2, 1, 1, 3]), lazy])
    news = age_of_news(GRAPH, walks, BASE, times=times, unit=2.0)
    each = np.ones(5) if times is None else times.astype(float)
    delays = GRAPH.matrix(each).toarray() + np.eye(4)
    random = np.random.default_rng(0)
    aged = ages([positions(walk, delays, random) for walk in walks])
    np.testing.assert_allclose(news.mean_age, 2 * aged[:, :4].mean(axis=0), rtol=0.04)
    assert news.mean_since_passed == pytest.approx(2 * aged[:, 4].mean(), rel=0.04)
    for age in (0, 2, 5, 9):
        law = (aged <= age).mean(axis=0)
        np.testing.assert_allclose(news.known[age], law[:4], atol=0.015)
        assert news.passed[age] == pytest.approx(law[4], abs=0.015)
    assert news.checks()["news_newer_than_the_robot"][0] <= 1e-12
    late = np.quantile(2 * aged[:, :4], 0.95, axis=0)
    np.testing.assert_allclose(news.late_age, late, atol=4)


def test_news_of_a_vertex_that_is_never_visited_are_infinitely_old():
    to_and_fro = np.array([[0.0, 1, 0], [1, 0, 0], [0, 1, 0]])
    graph = Graph([[0, 1], [1, 2]])
    news = age_of_news(graph, to_and_fro[None], 0)
    assert news.mean_age.tolist() == [0.5, 1.5, np.inf]
    assert np.isinf(news.late_age[2])
