"""Plans and policies of a robot that slips against general solvers."""

import itertools

import numpy as np
import pytest
import scipy.sparse

from jaxcell import bounce, mapping, markov
from jaxcell.bounce.slip.policy import PolicyRobot


CELLS, GOAL = 6, 5


@pytest.fixture(scope="module")
def choices():
    rng = np.random.default_rng(0)
    free = rng.random(CELLS)[:, None] * 0.8
    moves = rng.dirichlet(np.ones(CELLS) / 2, CELLS) * free
    bumps = [rng.dirichlet(np.ones(CELLS) / 2, CELLS) * (1 - free) for _ in range(3)]
    return [tuple(map(scipy.sparse.csr_array, (moves, one))) for one in bumps]


GOALS = np.arange(CELLS) == GOAL
START = np.eye(CELLS)[0]


def test_the_policy_is_that_of_the_stochastic_shortest_path(choices):
    policy = bounce.slip_policy(choices, GOALS, START)
    chains = [mapping.Chain.from_scipy(moves + bumps) for moves, bumps in choices]
    model = markov.DecisionModel.of(chains, np.zeros((3, CELLS)))
    best = markov.stochastic_shortest_path(model, GOAL)
    assert policy.sure
    gap = policy.certificate.residual
    assert (policy.time <= np.asarray(best.time) + 1e-9).all()
    assert (policy.time >= np.asarray(best.time) * (1 - gap) - 1e-9).all()
    others = np.arange(CELLS) != GOAL
    np.testing.assert_array_equal(policy.choice[others], np.asarray(best.policy)[others])


def test_arrival_is_the_first_passage_of_the_policy(choices):
    policy = bounce.slip_policy(choices, GOALS, START)
    arrival = bounce.arrival_by(choices, policy.choice, GOALS, START, 12)
    rows = [(choices[0][0] + choices[c][1]).toarray()[z] for z, c in enumerate(policy.choice)]
    chain = mapping.Chain.from_scipy(np.array(rows))
    law = np.asarray(markov.first_passage(chain, START, GOAL, 12))
    np.testing.assert_allclose(arrival, np.cumsum(law), atol=1e-12)


def test_a_plan_arrives_as_often_as_all_its_paths(choices):
    actions = [-1, 1, -1, 0]
    told = bounce.plan_probability(choices, START, actions)
    matrices = [choices[max(a, 0)][int(a >= 0)].toarray() for a in actions]
    again = np.zeros(CELLS)
    for path in itertools.product(range(CELLS), repeat=len(actions)):
        steps = zip(matrices, (0, *path), path, strict=False)
        again[path[-1]] += np.prod([m[a, b] for m, a, b in steps])
    np.testing.assert_allclose(told, again, atol=1e-14)


def test_a_goal_that_cannot_be_reached_for_sure_is_said():
    moves = scipy.sparse.csr_array(np.array([[0, 0.5, 0.5], [0, 1.0, 0], [0, 0, 1.0]]))
    never = scipy.sparse.csr_array((3, 3))
    goal = np.array([False, True, False])
    policy = bounce.slip_policy([(moves, never)], goal, np.array([1.0, 0, 0]))
    assert not policy.sure
    arrival = bounce.arrival_by([(moves, never)], policy.choice, goal, np.array([1.0, 0, 0]), 5)
    assert arrival.tolist() == [0, 0.5, 0.5, 0.5, 0.5, 0.5]


def test_a_robot_chooses_what_its_belief_says(choices):
    policy = bounce.slip_policy(choices, GOALS, START)
    robot = PolicyRobot(choices, policy, START)
    assert robot.turn(0) is None
    after = START @ choices[0][0].toarray()
    np.testing.assert_allclose(robot.weight, after / after.sum())
    before = robot.weight
    chosen = robot.turn(1)
    times = [policy.time @ (before @ bumps.toarray()) for _, bumps in choices]
    assert chosen == int(np.argmin(times))
    assert robot.weight.sum() == pytest.approx(1)
