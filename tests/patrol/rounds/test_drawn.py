"""Schedules of which one is drawn each night, against own linear programs and own draws."""

import dataclasses

import numpy as np
import pytest
from patrolled_rounds import draw_game_on_a_tree, least_risk, waits

from jaxcell.patrol import Graph
from jaxcell.patrol.rounds import Game, best_mixture, best_rounds, bound


@pytest.mark.parametrize("seed", range(12))
def test_draw_is_as_good_as_the_best_of_all_strategies(seed):
    random = np.random.default_rng(seed)
    edges, attack, value, robots = draw_game_on_a_tree(random, seed)
    ways = [float(time) for *_, time in edges]
    graph = Graph([edge[:2] for edge in edges], len(attack), ways=ways)
    game = Game.of(graph, attack, value=value, robots=robots, speed=1.0)
    drawn = best_mixture(game)
    least = least_risk(edges, attack, value, robots)
    assert drawn.risk == pytest.approx(least, abs=1e-7)
    assert drawn.least is bound(game).least is True
    assert drawn.chance.sum() == pytest.approx(1, abs=1e-12)
    late = np.zeros(len(attack))
    for routes, chance in zip(drawn.schedules, drawn.chance, strict=True):
        period = np.lcm.reduce([round(route.period) for route in routes])
        moments = np.arange(0, period, 0.5) + 0.25
        laps = int(2 * max(route.period for route in routes) / routes[0].period) + 3
        late += chance * np.array(
            [(waits(routes, v, moments, laps) > a).mean() for v, a in enumerate(attack)]
        )
    np.testing.assert_allclose(drawn.exposure, late, rtol=0, atol=1e-9)


def test_draw_and_bound_say_whether_they_are_the_best_of_all_strategies():
    ways = [2.0, 3.0, 2.0, 1.0, 3.0]
    graph = Graph([(v, (v + 1) % 5) for v in range(5)], ways=ways)
    game = Game.of(graph, [4.0, 3.0, 2.0, 3.0, 3.0], robots=3, speed=1.0)
    drawn, limit = best_mixture(game), bound(game)
    assert limit.preventable is limit.least is drawn.least is False
    assert drawn.risk > 1 - limit.capture
    safe = Game.of(graph, 20.0, robots=3, speed=1.0)
    assert best_mixture(safe).least is bound(safe).least is True
    assert bound(safe).capture == 1
    watched = dataclasses.replace(game, adversary="watcher")
    assert not bound(watched).least


def test_nights_that_are_drawn_expose_targets_as_said_at_a_fixed_moment():
    path = Graph([[0, 1], [1, 2], [2, 3]], xy=[[0, 0], [2, 0], [3, 0], [5, 0]])
    game = Game.of(path, [1.0, 2.0, 2.0, 1.0], robots=2, speed=1.0)
    drawn = best_mixture(game)
    nights = [drawn.draw(seed) for seed in range(1000)]
    for vertex, attack in enumerate(game.attack):
        late = np.array([waits(night, vertex, [50.0])[0] > attack for night in nights])
        error = 3 * (late.mean() * (1 - late.mean()) / late.size) ** 0.5 + 1e-9
        assert abs(late.mean() - drawn.exposure[vertex]) <= error


@pytest.mark.parametrize("robots", [1, 2, 3])
def test_draw_of_rounds_is_between_the_bound_and_the_best_rounds(robots):
    random = np.random.default_rng(robots)
    places = random.uniform(0, 10, (7, 2))
    graph = Graph([(a, b) for a in range(7) for b in range(a)], xy=places)
    game = Game.of(graph, random.uniform(1, 6, 7), robots=robots, speed=1.0)
    risk = best_mixture(game).risk
    assert 1 - bound(game).capture - 1e-9 <= risk
    assert risk <= best_rounds(game).evaluation.risk(game).max() + 1e-9


def test_watcher_sees_what_is_drawn():
    with pytest.raises(ValueError, match="adversary: expected blind"):
        best_mixture(Game.of(Graph([[0, 1]]), 1.0, adversary="watcher"))
