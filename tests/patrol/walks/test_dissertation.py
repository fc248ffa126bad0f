import itertools
import math

import numpy as np
import pytest
from graphs import SMALL, TABLE_4_2

from jaxcell.markov.arrival import Distinct, first_arrival, mean_first_arrival
from jaxcell.optimize import minimum_commute, payoffs, stackelberg
from jaxcell.patrol import Graph, random_walk
from jaxcell.patrol.perimeter import (
    Movement,
    Perimeter,
    detection_polynomials,
    maximin,
    mean_hitting_times,
)
from jaxcell.patrol.walks.game import strategy_game


@pytest.mark.parametrize(
    ("robots", "uniform", "anywhere"),
    [(2, 30.35, 30.58), (4, 14.22, 14.70), (8, 7.11, 7.30), (16, 3.21, 3.40)],
)
def test_first_arrivals_of_table_4_1(robots, uniform, anywhere):
    # Alam 2018: means of 30 experiments with MAECT on the complete graph of 64 vertices.
    graph = Graph(list(itertools.combinations(range(64), 2)))
    walk = [random_walk(graph, minimum_commute(graph).weights)] * robots
    mean = mean_first_arrival(walk, Distinct(range(64)), 5).value
    law = np.asarray(first_arrival(walk, Distinct(range(64)), 5, 1200))
    time = np.arange(1201)
    assert law.sum() == pytest.approx(1, abs=1e-12)
    assert law @ time == pytest.approx(mean, rel=1e-10)
    error = math.sqrt(law @ (time - mean) ** 2 / 30)
    # Placed at equal distances, robots arrive no later than at random: vertices are all alike.
    even = [mean_first_arrival(walk, list(range(0, 64, 64 // robots)), v).value for v in (0, 5)]
    assert (1 - robots / 64) * even[1] == pytest.approx(mean, rel=1e-9)
    assert even[0] == 0
    for published in (uniform, anywhere):
        assert abs(published - mean) < error / 2


def test_walkers_and_guards():
    # Alam 2018, Figure 4.4: of four robots, those without synchrony are faster than BMP.
    mean = {}
    for movement in Movement:
        ring = Perimeter(64, 4, movement)
        p = maximin(detection_polynomials(ring, 12)).p
        mean[movement] = float(mean_hitting_times(ring, p)[1:].sum()) / 16
    walkers = (1 - 4 / 64) / (1 - (62 / 63) ** 4)
    assert mean[Movement.BMP] == pytest.approx(42.5)
    assert mean[Movement.DNCP] < walkers < mean[Movement.DCP] < mean[Movement.BMP]


def test_the_game_of_the_small_graph():
    # Alam 2018, Tables 4.2 and 4.3: strategies 7 and 9 keep the adversary at vertex 7, where both
    # pay most.
    leader, follower = map(np.asarray, payoffs(TABLE_4_2))
    for method in ("dobss", "multiple-lp"):
        solution = stackelberg(leader, follower, method=method)
        assert solution.value == pytest.approx(8, abs=1e-6)
        assert int(solution.answer[0]) == 6
        assert np.asarray(solution.weights)[[6, 8]].sum() == pytest.approx(1, abs=1e-6)
    # Against the published mixture, an attack on vertex 7 is as good as any.
    replies = np.array([0.9012, 0.0988]) @ follower[[6, 8]]
    assert replies[6] == pytest.approx(replies.max(), abs=1e-4)
    # Neither does so alone.
    assert follower[6].argmax() != 6
    assert follower[8].argmax() != 6
    # Where vertices are equally close, the orders of our walks are others than those of the table,
    # and no mixture of them keeps the adversary where both pay most.
    game = strategy_game(SMALL, (1, 4, 7))
    share, attacked = np.asarray(game.share), int(np.argmax(game.share @ game.adversary_payoff))
    alone = game.patroller_payoff[np.arange(len(share)), game.adversary_payoff.argmax(axis=1)]
    assert alone.max() <= game.alone < game.value < 8
    assert game.value == pytest.approx(share @ game.patroller_payoff[:, attacked], abs=1e-6)
