import math

import jax
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from small_seas import random_sea

from jaxcell.base.certificate import Outcome
from jaxcell.drift.layered_cells import Sea
from jaxcell.drift.voyage_policies import (
    ACTIONS,
    discounted_voyage,
    simulate_voyages,
    surest_voyage,
    voyage_model,
)
from jaxcell.examples import water
from jaxcell.mapping import Chain
from jaxcell.markov import first_passage, hitting_times


seeds = st.integers(0, 2**16)


def algorithm(sea, goal, discount, rounds):
    """Alg. 5.5 cell by cell, with the reward of each image and with being lost as a cell."""
    drift = sea.drift.to_scipy().toarray()
    value = dict.fromkeys([*range(sea.cells), "lost"], -1.0)
    reward = {image: 100.0 if image == goal else -1.0 for image in value}

    def gain(images):
        return sum(p * (reward[image] + value[image]) for image, p in images.items())

    def actions(z):
        images = {int(w): drift[z, w] for w in np.flatnonzero(drift[z])}
        images["lost"] = max(0.0, 1 - sum(images.values()))
        moves = {0: images}
        if sea.above[z] >= 0:
            moves[-1] = {int(sea.above[z]): 1.0}
        if sea.below[z] >= 0:
            moves[1] = {int(sea.below[z]): 1.0}
        return moves

    moves = {z: actions(z) for z in range(sea.cells)}
    for _ in range(rounds):
        later = {z: discount * max(map(gain, moves[z].values())) for z in moves}
        later["lost"] = discount * (-1 + value["lost"])
        value = later | {goal: 0.0}
    return value, {z: {u: gain(images) for u, images in moves[z].items()} for z in moves}


@given(seeds, st.sampled_from([0.0, 0.2]))
@settings(max_examples=8)
def test_values_are_those_of_the_algorithm_cell_by_cell(seed, leak):
    sea = random_sea(seed, shape=(3, 3), leak=leak)
    goal = int(np.random.default_rng(seed).integers(sea.cells))
    voyage = discounted_voyage(sea, goal, 0.9)
    value, gains = algorithm(sea, goal, 0.9, 250)
    expected = [value[z] for z in range(sea.cells)]
    np.testing.assert_allclose(voyage.value, expected, atol=1e-7)
    for z in range(sea.cells):
        if z != goal:
            assert gains[z][int(voyage.action[z])] >= max(gains[z].values()) - 1e-6
    assert voyage.action[goal] == 0


def test_a_drifter_that_cannot_arrive_drifts():
    # Three separate cells in a row over two more, each of which stays put.
    wets = [np.array([[True, True, True]]), np.array([[True, True, False]])]
    chains = [Chain(np.arange(n)[None], np.ones((1, n))) for n in (3, 2)]
    sea = Sea.of([water(wet) for wet in wets], chains)
    for best in (discounted_voyage(sea, 4, 0.9), surest_voyage(sea, 4)):
        assert best.action.tolist() == [0, 1, 0, 0, 0]
        assert best.probability.tolist() == [0, 1, 0, 0, 1]
        assert best.time.tolist() == [math.inf, 1, math.inf, math.inf, 0]
    best = discounted_voyage(sea, 4, 0.9)
    never = -0.9 / (1 - 0.9)
    np.testing.assert_allclose(best.value, [never, 90, never, never, 0], atol=1e-12)


@given(seeds, st.sampled_from([0.0, 0.3]))
@settings(max_examples=15)
def test_the_closed_loop_follows_the_actions(seed, leak):
    sea = random_sea(seed, leak=leak)
    goal = int(np.random.default_rng(seed).integers(sea.cells))
    surest = surest_voyage(sea, goal)
    for best in (discounted_voyage(sea, goal, 0.95), surest):
        action = np.asarray(best.action)
        up, down = action == -1, action == 1
        assert (sea.above[up] >= 0).all()
        assert (sea.below[down] >= 0).all()
        expected = sea.drift.to_scipy().toarray()
        expected[up] = np.eye(sea.cells)[sea.above[up]]
        expected[down] = np.eye(sea.cells)[sea.below[down]]
        expected[goal] = np.eye(sea.cells)[goal]
        np.testing.assert_array_equal(best.chain.to_scipy().toarray(), expected)
        law = np.linalg.matrix_power(expected, 2**20)[:, goal]
        np.testing.assert_allclose(best.probability, law, atol=1e-9)
        np.testing.assert_allclose(best.time, hitting_times(best.chain, goal).value, rtol=1e-9)
        assert best.certificate.outcome is Outcome.CONVERGED
        assert (np.asarray(best.probability) <= np.asarray(surest.probability) + 1e-9).all()
        assert (np.asarray(best.time) >= np.asarray(surest.time) * (1 - 1e-9)).all()


def test_a_goal_may_have_several_cells():
    sea = random_sea(3)
    goals = np.array([2, sea.cells - 1])
    model = voyage_model(sea, goals, 0.9)
    matrix = sea.drift.to_scipy().toarray()
    expected = 101 * matrix[:, goals].sum(axis=1) - 1
    np.testing.assert_allclose(
        model.reward[0], np.where(np.isin(np.arange(sea.cells), goals), 0, expected)
    )
    assert len(ACTIONS) == model.actions
    voyage = discounted_voyage(sea, goals, 0.9)
    assert np.asarray(voyage.value)[goals].tolist() == [0, 0]
    assert np.asarray(voyage.probability)[goals].tolist() == [1, 1]


@pytest.mark.parametrize("leak", [0.0, 0.3])
def test_simulated_drifters_arrive_as_often_as_predicted(leak):
    sea = random_sea(11, leak=leak)
    drifters, steps = 20_000, 400
    # A goal that is neither sure nor hopeless.
    voyages = (discounted_voyage(sea, goal, 0.5) for goal in range(sea.cells))
    voyage = next(v for v in voyages if 0.1 < np.asarray(v.probability).mean() < 0.9)
    start = np.flatnonzero(~voyage.goal)
    tracks = simulate_voyages(jax.random.key(0), voyage, start, drifters, steps)
    assert tracks.cell.shape == (steps + 1, drifters)
    law = np.asarray(first_passage(voyage.chain, start, voyage.goal, steps))
    predicted = float(np.asarray(voyage.probability)[start].mean())
    assert law.sum() == pytest.approx(predicted, abs=1e-3)
    error = math.sqrt(predicted * (1 - predicted) / drifters)
    assert abs(float(tracks.arrived.mean()) - predicted) < 4 * error + 1e-3
    for step in (1, 3, 10):
        by_then = float((tracks.time <= step).mean())
        share = law[: step + 1].sum()
        assert abs(by_then - share) < 4 * math.sqrt(share * (1 - share) / drifters) + 1e-12
    # Every step is one that the closed loop may make, and no drifter comes back.
    cell = np.asarray(tracks.cell)
    here, there = cell[:-1].ravel(), cell[1:].ravel()
    matrix = voyage.chain.to_scipy().toarray()
    stayed = (here >= 0) & (there >= 0)
    assert (matrix[here[stayed], there[stayed]] > 0).all()
    assert (there[here < 0] == -1).all()
    gone = (here >= 0) & (there < 0)
    assert gone.any() == (leak > 0)
    assert (np.asarray(voyage.chain.leaving)[here[gone]] > 0).all()
    np.testing.assert_array_equal(
        tracks.arrived, np.asarray(voyage.goal)[cell[-1]] & (cell[-1] >= 0)
    )


def test_simulation_is_reproducible_from_its_key_and_start():
    voyage = surest_voyage(random_sea(1), 0)
    key = jax.random.key(7)
    one, two = (simulate_voyages(key, voyage, 5, 30, 20) for _ in range(2))
    np.testing.assert_array_equal(one.cell, two.cell)
    assert (one.cell[0] == 5).all()
    there = simulate_voyages(key, voyage, 0, 3, 0)
    assert there.cell.tolist() == [[0, 0, 0]]
    assert there.time.tolist() == [0, 0, 0]


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda sea, key: discounted_voyage(sea, 999), "goal: cell 999 does not exist"),
        (lambda sea, key: surest_voyage(sea, []), "goal: expected at least one cell"),
        (lambda sea, key: discounted_voyage(sea, 0, 1.0), "discount: expected more than 0"),
        (lambda sea, key: simulate_voyages(key, surest_voyage(sea, 0), 1, 0, 5),
         "drifters: expected 1 or more, got 0"),
        (lambda sea, key: simulate_voyages(key, surest_voyage(sea, 0), 1, 5, -1),
         "steps: expected 0 or more, got -1"),
        (lambda sea, key: simulate_voyages(key, surest_voyage(sea, 0), 999, 5, 5),
         "start: cell 999 does not exist"),
    ],
)  # fmt: skip
def test_invalid_goals_discounts_and_simulations_are_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call(random_sea(0), jax.random.key(0))
