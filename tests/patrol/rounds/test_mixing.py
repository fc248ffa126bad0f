"""Targets that are left out, and rounds in turn, against the best of all strategies.

The optimum is a linear program over all moves of robots in whole units of time, with the ages of
visits as the state.
"""

import numpy as np
import pytest
from patrolled_rounds import least_risk, waits

from jaxcell.patrol import Graph
from jaxcell.patrol.rounds import Game, Guarded, best_rounds, best_routes, bound, evaluate


def game_of(edges, attack, value, robots=1, **others):
    times = np.array([time for *_, time in edges], float)
    graph = Graph([edge[:2] for edge in edges], len(attack), ways=times)
    return Game.of(
        graph, np.array(attack, float), value=np.array(value, float), robots=robots, speed=1.0,
        **others,
    )  # fmt: skip


@pytest.mark.parametrize("worth", [2.0, 100.0])
@pytest.mark.parametrize("adversary", ["blind", "watcher"])
def test_guard_stays_at_the_valuable_target(worth, adversary):
    star = [(0, leaf, 1) for leaf in range(1, 7)]
    game = game_of(star, [1] * 7, [1, worth, 1, 1, 1, 1, 1], adversary=adversary)
    found = best_rounds(game)
    assert found.evaluation.risk(game).max() == 1.0
    assert found.routes[0].vertex.tolist() == [1]
    answer = Guarded.of(game, found.routes, bound=bound(game)).answer
    assert any("and 5 others" in line and "No guard ever visits" in line for line in answer)


@pytest.mark.parametrize(
    ("edges", "attack", "value", "robots"),
    [
        ([(0, 1, 3)], [1, 1], [1, 1], 1),
        ([(0, 1, 3)], [1, 1], [3, 1], 1),
        ([(0, 1, 1)], [4, 1], [1, 1], 1),
        ([(0, 1, 1), (1, 2, 1)], [6, 1, 6], [1, 1, 1], 1),
        ([(0, 1, 2), (1, 2, 1)], [2, 1, 1], [1, 1, 1], 1),
        ([(0, 1, 1), (0, 2, 1), (0, 3, 1)], [1, 1, 1, 1], [1, 1, 1, 1], 2),
        ([(0, 1, 1), (1, 2, 2), (2, 3, 1)], [2, 1, 1, 2], [2, 1, 1, 2], 2),
    ],
)
def test_rounds_in_turn_are_nearly_the_best_strategy(edges, attack, value, robots):
    game = game_of(edges, attack, value, robots)
    least = least_risk(edges, attack, value, robots)
    routes = best_routes(game)
    found = evaluate(game, routes)
    risk = found.risk(game).max()
    # A share of .01 is for walks from one round to the next, and rounds in turn gain .05 at least.
    allowed = 0.011 if routes[0].period > 20 else 0.061
    assert least * (1 - 1e-9) <= risk <= least + allowed * max(value)
    assert (1 - bound(game).capture) * max(value) <= least + 1e-9
    assert risk < best_rounds(game).evaluation.risk(game).max() + 1e-9
    moments = np.random.default_rng(0).uniform(0, 40 * routes[0].period, 500)
    missed = [(waits(routes, v, moments) > a).mean() for v, a in enumerate(attack)]
    np.testing.assert_allclose(found.exposure, missed, atol=0.09)


def test_watcher_is_not_met_with_long_stays():
    game = game_of([(0, 1, 3)], [1, 1], [1, 1], adversary="watcher")
    assert [r.vertex.size for r in best_routes(game)] == [2]


def test_bound_on_the_risk_stands_beside_it():
    game = game_of([(0, 1, 3)], [1, 1], [4, 2])
    guarded = Guarded.of(game, best_routes(game), bound=bound(game))
    assert guarded.bound_risk == pytest.approx(4 / 3)
    assert guarded.bound_risk < guarded.risk < 4 / 3 + 0.04
    assert guarded.risk == pytest.approx(max(guarded.evaluation.exposure * game.value), rel=1e-12)
    assert any("None has a risk below 1.333" in line for line in guarded.answer)
