import itertools

import jax
import networkx as nx
import numpy as np
import pytest
from graphs import graph_of
from walks import walk_on

from jaxcell import patrol
from jaxcell.base.secondary import Secondary
from jaxcell.optimize import Graph
from jaxcell.patrol.team.charging import Charged, in_time_for_charge
from jaxcell.patrol.walks.optimal.charged_capture import charged_capture
from jaxcell.patrol.walks.steps import ChargedSteps, Steps
from jaxcell.study import PatrolGraph


KITE = Graph([[0, 1], [1, 2], [2, 0], [2, 3]])
CHARGER, EVERY, ATTACK = 2, 3, 4


def policy(leave, stray):
    """All walks on the kite that are back at the charger every third step."""
    chance = np.zeros((EVERY, 4, 4))
    chance[0, CHARGER, [0, 1, 3]] = leave
    chance[1, 0, [1, 2]] = stray[0], 1 - stray[0]
    chance[1, 1, [0, 2]] = stray[1], 1 - stray[1]
    chance[1, 3, 2] = 1
    chance[2, [0, 1], 2] = 1
    return chance[None]


def test_steps_are_those_of_the_law():
    near = Steps.of(KITE)
    image = np.asarray(near.image)
    allowed = in_time_for_charge(KITE, CHARGER, 5)[:, image] & (np.asarray(near.even) > 0)
    steps = ChargedSteps(near, *jax.device_put((allowed, CHARGER, 0.05)))
    unseen = jax.device_put(np.tile(1 - np.eye(4), (5, 1)))

    @jax.jit
    def law(logits):
        drawn, late = steps.chances(logits, 0.0)[0], unseen
        for _ in range(ATTACK - 1):
            late = unseen * steps.pull(drawn, late)
        often = steps.often(drawn)
        return drawn, often, often / often.sum(), steps.pull(drawn, late)

    logits = np.random.default_rng(0).normal(size=(1, image.shape[0], 20))
    drawn, often, share, late = (np.asarray(one) for one in law(logits))
    chance = np.zeros((5, 4, 4))
    by_age = drawn.reshape(-1, 5, 4).swapaxes(0, 1)
    np.add.at(chance, (np.arange(5)[:, None, None], np.arange(4), image), by_age)
    expected = Charged.of(chance[None], CHARGER, attack_time=ATTACK)
    assert expected.interval.sum() == pytest.approx(1)
    assert chance[chance > 0].min() > 0.04
    np.testing.assert_allclose(share.reshape(5, 4).sum(axis=0), expected.share, atol=1e-12)
    assert 1 - late[often > 0].max() == pytest.approx(expected.least_capture)


def test_no_walk_of_a_fine_grid_of_all_captures_more():
    walk = charged_capture(KITE, walk_on(KITE)[None], CHARGER, EVERY, ATTACK)
    tenths = np.arange(0, 1.01, 0.1)
    best = max(
        Charged.of(policy([a, b, 1 - a - b], stray), CHARGER, attack_time=ATTACK).least_capture
        for a, b in itertools.product(tenths, tenths)
        if a + b < 1 + 1e-9
        for stray in itertools.product(tenths[::2], tenths[::2])
    )
    assert walk.least_capture > best - 1e-3 > walk.led_back


@pytest.mark.parametrize(
    ("graph", "every", "attack", "optimum", "led_back"),
    [
        # To the other end and back, which walks that are led back never learn.
        (nx.path_graph(8), 14, 14, 1.0, 0.1),
        # A leaf out of three, twice within the attack; the program is that of the kite.
        (nx.star_graph(3), EVERY, ATTACK, 5 / 9, 5 / 9),
    ],
)
def test_known_optima(graph, every, attack, optimum, led_back):
    graph = graph_of(graph)
    walk = charged_capture(graph, walk_on(graph)[None], 0, every, attack, starts=1)
    assert walk.least_capture == pytest.approx(optimum, abs=1e-3)
    assert walk.led_back < led_back + 1e-9
    assert walk.interval.sum() == pytest.approx(1)
    assert (walk.chance[0, -1].argmax(axis=1)[walk.chance[0, -1].any(axis=1)] == 0).all()


def test_two_robots_capture_no_less_than_when_they_are_led_back():
    star = graph_of(nx.star_graph(3))
    walk = charged_capture(star, np.stack([walk_on(star)] * 2), 0, 2, 2, starts=2)
    # A robot that goes to each leaf equally often captures a third there; two may share them.
    assert walk.led_back == pytest.approx(1 - (2 / 3) ** 2)
    assert walk.least_capture >= walk.led_back
    assert walk.chance.shape == (2, 2, 4, 4)


def test_too_large_graphs_are_refused():
    line = Graph([(i, i + 1) for i in range(99)])
    with pytest.raises(ValueError, match="every: 200 steps, times 100 vertices squared, times att"):
        charged_capture(line, walk_on(line)[None], 0, 200, 200)


def test_capture_with_a_charger_is_sought(monkeypatch, tmp_path):
    asked = {}
    monkeypatch.setattr(patrol.walks, "charged_capture", lambda *a, **b: asked.update(a=a, **b))
    file = tmp_path / "kite.edges"
    options = {"strategy": "capture", "charger": "2", "every": 3, "attack_time": 4}
    study = PatrolGraph(file=file, **options)
    found = patrol.GraphPatrol.of(KITE, patrol.random_walk(KITE, np.ones(4)))
    study._charged(found, Secondary(), print)
    assert asked["a"][2:] == (2, 3)
    assert asked["attack_time"] == 4
    assert asked["names"] == ["0", "1", "2", "3"]
