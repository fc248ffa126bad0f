import itertools

import numpy as np
import pytest
from walks import walk_on

from jaxcell.optimize import Graph
from jaxcell.patrol.team import charged


GRAPH = Graph([[0, 1], [1, 2], [2, 3], [3, 0], [0, 2], [3, 4]])
WALK = walk_on(GRAPH, [1, 2, 1, 1, 3, 1])
CHARGER, EVERY = 2, 5


def test_shares_and_intervals_are_those_of_a_run():
    charging = charged(GRAPH, WALK[None], CHARGER, EVERY)
    random, here, since = np.random.default_rng(0), CHARGER, 0
    visits, intervals = np.zeros(5), np.zeros(EVERY)
    for _ in range(40_000):
        here = int(random.choice(5, p=charging.chance[0, since, here]))
        visits[here] += 1
        since += 1
        if here == CHARGER:
            intervals[since - 1] += 1
            since = 0
        assert since < EVERY
    np.testing.assert_allclose(charging.share, visits / visits.sum(), atol=0.01)
    np.testing.assert_allclose(charging.interval, intervals / intervals.sum(), atol=0.015)
    assert charging.interval.sum() == pytest.approx(1)
    assert charging.mean_interval == pytest.approx(charging.idleness[CHARGER])


def test_capture_against_all_ways():
    """Of two steps for each vertex, from all states that occur, by enumeration."""
    attack, least = 3, 1.0
    charging = charged(GRAPH, WALK[None], CHARGER, EVERY, attack_time=attack)
    states = {(0, CHARGER)}
    while True:
        after = {
            (0 if there == CHARGER else since + 1, int(there))
            for since, here in states
            for there in np.flatnonzero(charging.chance[0, since, here])
        }
        if after <= states:
            break
        states |= after
    for (since, start), target in itertools.product(states, range(5)):
        caught = 0.0
        for way in itertools.product(range(5), repeat=attack):
            chance, age, here = 1.0, since, start
            for there in way:
                chance *= charging.chance[0, age % EVERY, here, there]
                age, here = (0 if there == CHARGER else age + 1), there
            caught += chance * (target in way)
        least = min(least, caught)
    assert charging.least_capture == pytest.approx(least, abs=1e-12)


def test_two_robots_are_independent():
    one = charged(GRAPH, WALK[None], CHARGER, EVERY, attack_time=3)
    two = charged(GRAPH, np.stack([WALK, WALK]), CHARGER, EVERY, attack_time=3)
    assert two.least_capture == pytest.approx(1 - (1 - one.least_capture) ** 2)
    np.testing.assert_allclose(two.idleness, 1 / (1 - (1 - one.share) ** 2))
    np.testing.assert_allclose(two.interval, one.interval)


def test_a_long_interval_does_not_change_the_shares():
    charging = charged(GRAPH, WALK[None], CHARGER, 200)
    share = np.linalg.matrix_power((WALK + np.eye(5)) / 2, 2000)[0]
    np.testing.assert_allclose(charging.share, share, atol=1e-6)


def test_a_walk_that_never_visits_the_charger_is_led_back():
    to_and_fro = np.zeros((5, 5))
    to_and_fro[[0, 1, 2, 3, 4], [1, 0, 1, 4, 3]] = 1
    charging = charged(GRAPH, to_and_fro[None], CHARGER, 4)
    assert charging.interval[-2:].sum() == pytest.approx(1)


def test_a_charger_that_is_too_far_is_refused():
    with pytest.raises(ValueError, match="every: expected at least 4 steps, to the far"):
        charged(GRAPH, WALK[None], CHARGER, 3)
    with pytest.raises(ValueError, match="every: expected at most 2,000,000 steps on 5 vertices"):
        charged(GRAPH, WALK[None], CHARGER, 2_000_001)
    with pytest.raises(ValueError, match="charger: expected a vertex, 0 to 4, got -1"):
        charged(GRAPH, WALK[None], -1, EVERY)
