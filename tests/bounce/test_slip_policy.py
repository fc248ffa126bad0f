"""Policies of a robot that slips, compared with general solvers."""

import numpy as np
import pytest

from jaxcell import bounce, mapping, markov
from jaxcell.automata import HiddenMap
from jaxcell.bounce.slip.policy import PolicyRobot


CELLS, GOAL = 6, 5
GOALS = np.arange(CELLS) == GOAL
START = np.eye(CELLS)[0]


@pytest.fixture(scope="module")
def hidden():
    rng = np.random.default_rng(0)
    free = rng.random(CELLS)[:, None] * 0.8
    moves = rng.dirichlet(np.ones(CELLS) / 2, CELLS) * free
    bumps = [rng.dirichlet(np.ones(CELLS) / 2, CELLS) * (1 - free) for _ in range(3)]
    return HiddenMap.of(moves, bumps, np.arange(CELLS), START)


def test_the_policy_is_that_of_the_stochastic_shortest_path(hidden):
    policy = bounce.slip_policy(hidden, GOALS, START)
    chains = [mapping.Chain.from_scipy(hidden.moves + one) for one in hidden.bumps]
    model = markov.DecisionModel.of(chains, np.zeros((3, CELLS)))
    best = markov.stochastic_shortest_path(model, GOAL)
    assert policy.sure
    time, gap = np.asarray(best.time), policy.certificate.residual
    assert (policy.time <= time + 1e-9).all()
    assert (policy.time >= time * (1 - gap) - 1e-9).all()
    np.testing.assert_array_equal(policy.choice[~GOALS], np.asarray(best.policy)[~GOALS])


def test_arrival_is_the_first_passage_of_the_policy(hidden):
    policy = bounce.slip_policy(hidden, GOALS, START)
    arrival = bounce.arrival_by(hidden, policy.choice, GOALS, START, 12)
    rows = [(hidden.moves + hidden.bumps[c]).toarray()[z] for z, c in enumerate(policy.choice)]
    chain = mapping.Chain.from_scipy(np.array(rows))
    law = np.asarray(markov.first_passage(chain, START, GOAL, 12))
    np.testing.assert_allclose(arrival, np.cumsum(law), atol=1e-12)


def test_a_policy_that_may_miss_its_goal_is_not_sure():
    moves = np.array([[0, 0.5, 0.5], [0, 1.0, 0], [0, 0, 1.0]])
    goal, start = np.array([False, True, False]), np.array([1.0, 0, 0])
    hidden = HiddenMap.of(moves, np.zeros((3, 3)), np.arange(3), start)
    policy = bounce.slip_policy(hidden, goal, start)
    assert not policy.sure
    arrival = bounce.arrival_by(hidden, policy.choice, goal, start, 5)
    assert arrival.tolist() == [0, 0.5, 0.5, 0.5, 0.5, 0.5]


def test_a_robot_chooses_the_angle_with_the_least_mean_time_of_its_belief(hidden):
    policy = bounce.slip_policy(hidden, GOALS, START)
    robot = PolicyRobot(hidden, policy, START)
    assert robot.turn(0) is None
    after = START @ hidden.moves.toarray()
    np.testing.assert_allclose(robot.weight, after / after.sum())
    before = robot.weight
    chosen = robot.turn(1)
    times = [policy.time @ (before @ bumps.toarray()) for bumps in hidden.bumps]
    assert chosen == int(np.argmin(times))
    assert robot.weight.sum() == pytest.approx(1)
