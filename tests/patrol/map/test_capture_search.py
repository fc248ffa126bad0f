import itertools

import numpy as np
import pytest
from graphs import on_map
from walks import missed, times_by_solves

from jaxcell import examples
from jaxcell.patrol.map.attack import Attack
from jaxcell.patrol.map.capture import capture_by_tours, capture_probabilities
from jaxcell.patrol.map.capture_search import capture_frontier, capture_policies, entropy_rate
from jaxcell.patrol.map.policies import distributed_policies


STEPS = 4


def least_capture(matrix, visible, start):
    return 1 - max(missed(matrix, view, STEPS, start) for view in visible)


@pytest.mark.parametrize("start", ["uniform", "stationary", "worst"])
def test_no_walk_on_a_fine_grid_captures_more(start):
    graph, visible = examples.patrol()
    search = capture_policies(graph, visible, 1, Attack(STEPS, start), starts=2)
    (policy,) = search.policies
    matrix = policy.chain.to_scipy().toarray()
    assert search.value == pytest.approx(least_capture(matrix, visible, start), abs=1e-6)
    best = 0.0
    for chances in itertools.product(np.linspace(0, 1, 15), repeat=3):
        walk = np.zeros((5, 5))
        walk[0, 1] = walk[4, 3] = 1
        for place, right in enumerate(chances, 1):
            walk[place, place + 1], walk[place, place - 1] = right, 1 - right
        best = max(best, least_capture(walk, visible, start))
    assert search.value > best - 1e-3
    (commuting,) = distributed_policies(graph, visible, 1, 0.0)
    assert search.value > 1.05 * least_capture(commuting.chain.to_scipy().toarray(), visible, start)


@pytest.fixture(scope="module")
def lab():
    graph, visible = on_map("lab_b", 2.5)
    return graph, visible, capture_policies(graph, visible, 2, Attack(6), randomness=0.3, starts=1)


def test_every_step_keeps_the_floor_of_randomness(lab):
    graph, visible, found = lab
    for policy in found.policies:
        matrix = policy.chain.to_scipy().toarray()
        tail, head = np.concatenate([graph.edges, graph.edges[:, ::-1]]).T
        degree = np.bincount(tail)
        assert (matrix[tail, head] >= 0.3 / degree[tail] - 1e-12).all()
        np.testing.assert_allclose(matrix.sum(axis=1), 1, atol=1e-12)
        share = policy.share_of_time(graph)
        np.testing.assert_allclose(share @ matrix, share, atol=1e-12)
    plain = distributed_policies(graph, visible, 2, 0.0)
    before = capture_probabilities(graph, visible, plain, Attack(6)).min()
    assert found.value > 1.2 * before


def test_capture_falls_along_the_frontier_and_entropy_rises():
    graph, visible = examples.patrol()
    frontier = capture_frontier(graph, visible, 1, Attack(STEPS), [0.5, 0.0, 0.9])
    assert frontier.floor.tolist() == [0.0, 0.5, 0.9]
    assert (np.diff(frontier.least_capture) < 0).all()
    # A corridor has no more entropy than log 2 at each of its three inner places.
    assert 0 <= frontier.entropy.min() < frontier.entropy.max() < np.log(2)
    uniform = capture_policies(graph, visible, 1, Attack(STEPS), randomness=0.9999, starts=1)
    (policy,) = uniform.policies
    assert entropy_rate(graph, policy) == pytest.approx(0.75 * np.log(2), abs=1e-3)


def test_the_best_of_several_starts_captures_more_than_tours_and_visits_all_cells(lab):
    graph, visible, _ = lab
    search = capture_policies(graph, visible, 2, Attack(6), starts=3)
    assert search.tried.shape == (3,)
    assert search.value == search.tried.max() > 1.3 * search.tours
    for policy in search.policies:
        share = policy.share_of_time(graph)
        matrix = policy.chain.to_scipy().toarray()
        np.testing.assert_allclose(share @ matrix, share, atol=1e-12)
        # An average cell has 1e-5, and one that is far away a fifth of it per edge.
        degree = np.bincount(graph.edges.ravel())
        assert (share >= 0.2 * 1e-5 * degree / degree.mean()).all()
        times = times_by_solves(matrix)
        mean = (times + times.T).sum() / (len(times) * (len(times) - 1))
        assert policy.commute_time == pytest.approx(mean, rel=1e-6)
        assert mean < 1e6


def test_tours_capture_as_often_as_simulated_robots_on_them():
    graph, visible = examples.patrol()
    covers = [[1, 3], [0, 4]]
    least = capture_by_tours(graph, visible, covers, Attack(2))
    tours = [[1, 2, 3, 2], [0, 1, 2, 3, 4, 3, 2, 1]]
    left = np.ones(5)
    for tour in tours:
        for target in range(5):
            hidden = [k for k in range(len(tour)) if not visible[tour[k], target]]
            late = [
                k
                for k in hidden
                if not any(visible[tour[(k + step) % len(tour)], target] for step in (1, 2))
            ]
            left[target] *= len(late) / len(hidden) if hidden else 0
    assert least == pytest.approx(1 - left.max())
    assert capture_by_tours(graph, visible, [[2]], Attack(2)) is None


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"robots": 0}, "robots: expected 1 to 5, the number of cells, got 0"),
        ({"randomness": 1.0}, "randomness: expected 0 or more and less than 1, got 1.0"),
        ({"starts": 0}, "starts: expected a whole number of at least 1, got 0"),
    ],
)
def test_wrong_searches_are_refused(change, message):
    graph, visible = examples.patrol()
    with pytest.raises(ValueError, match=message):
        capture_policies(graph, visible, **{"robots": 1, "attack": Attack(4), **change})
    with pytest.raises(ValueError, match="floors: expected at least one, got none"):
        capture_frontier(graph, visible, 1, Attack(4), [])


def test_nothing_is_searched_if_all_cells_are_always_seen():
    graph, visible = examples.patrol()
    search = capture_policies(graph, np.ones_like(visible), 1, Attack(1))
    assert (search.value, search.iterations) == (1.0, 0)
