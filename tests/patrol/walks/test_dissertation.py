import itertools
import math

import numpy as np
import pytest
from graphs import SMALL, TABLE_4_2

from jaxcell.markov.arrival import Distinct, first_arrival
from jaxcell.markov.mean_arrival import mean_first_arrival
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


def best_coin(d, time, turn):
    """The probability of heads that maximises the least detection, on a grid.

    `turn` is 1 if a robot that turns also moves (DNCP), and 0 if it stays (DCP).
    """
    p = np.linspace(0.3, 1, 7001)
    i = np.arange(d)
    near, far = (i - 1) % d, (i + 1) % d
    toward = away = np.broadcast_to((i == 0)[:, None], (d, p.size)).astype(float)
    for step in range(time):
        ahead, behind = (near, far) if turn else (i, i)
        new = p * toward[near] + (1 - p) * away[behind], p * away[far] + (1 - p) * toward[ahead]
        if step == time - 1:
            return p[new[0].min(axis=0).argmax()]
        toward, away = (np.where((i == 0)[:, None], 1.0, values) for values in new)


def mean_time(d, p, turn):
    """The mean steps until a robot comes to a segment, over all segments; 0 where one stands.

    Robots begin with the same heading. `turn` is as for `best_coin`.
    """
    state = {(x, heading): k for k, (x, heading) in enumerate(itertools.product(range(d), (1, -1)))}
    system = np.eye(2 * d)
    for (x, heading), k in state.items():
        for chance, to, then in ((p, x + heading, heading), (1 - p, x - turn * heading, -heading)):
            # The robot looks for segment 0.
            if x and to % d:
                system[k, state[to % d, then]] -= chance
    steps = [float(x > 0) for x, _ in state]
    return np.linalg.solve(system, steps)[::2].mean()


def test_walkers_and_guards():
    # Alam 2018, Figure 4.4: of four robots, those without synchrony are faster than BMP.
    mean = {}
    for movement in Movement:
        ring = Perimeter(64, 4, movement)
        p = maximin(detection_polynomials(ring, 12)).p
        mean[movement] = float(mean_hitting_times(ring, p)[1:].sum()) / 16
        if movement is not Movement.BMP:
            turn = int(movement is Movement.DNCP)
            assert p == pytest.approx(best_coin(16, 12, turn), abs=2e-4)
            assert mean[movement] == pytest.approx(mean_time(16, p, turn), rel=1e-9)
    walkers = (1 - 4 / 64) / (1 - (62 / 63) ** 4)
    # A fair coin: the mean of i (16 - i).
    assert mean[Movement.BMP] == pytest.approx(42.5)
    assert mean[Movement.DNCP] < walkers < mean[Movement.DCP] < mean[Movement.BMP]


def without_heading(d, p, back):
    """Mean and variance of the steps from a random segment without a robot to the next robot.

    A robot moves ahead with probability `p`, and otherwise `back` segments back.
    """
    inside = np.zeros((d + 1, d + 1))
    for segment in range(1, d):
        inside[segment, segment - 1] += p
        inside[segment, segment + back] += 1 - p
    inside = inside[1:d, 1:d]
    mean = np.linalg.solve(np.eye(d - 1) - inside, np.ones(d - 1))
    square = np.linalg.solve(np.eye(d - 1) - inside, 2 * mean - 1)
    return mean.mean(), square.mean() - mean.mean() ** 2


def test_robots_that_do_not_keep_their_heading_fit_table_4_1():
    # The columns of DCP and DNCP: means of 30 experiments, by the number of robots.
    table = {2: (17.29, 20.85), 4: (9.26, 11.74), 8: (5.90, 6.90), 16: (3.10, 3.16)}
    chi_squared, means = 0.0, []
    for robots, published in table.items():
        d, time = 64 // robots, 48 // robots
        for turn, source, movement in zip((0, 1), published, ("DCP", "DNCP"), strict=True):
            p = best_coin(d, time, turn)
            ring = Perimeter(64, robots, Movement[movement])
            assert maximin(detection_polynomials(ring, time)).p == pytest.approx(p, abs=2e-4)
            mean, variance = without_heading(d, p, turn)
            means.append(round(float(mean), 2))
            chi_squared += (source - mean) ** 2 / (variance / 30)
    expected = [17.93, 20.07, 9.73, 11.75, 5.46, 6.83, 3.09, 3.33]
    np.testing.assert_allclose(means, expected, atol=0.02)
    # A test at 5 % rejects above 15.5.
    assert 1.0 < chi_squared < 1.4


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
