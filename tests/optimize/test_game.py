import itertools
import os

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
from graphs import TABLE_4_2
from hypothesis import given, strategies as st
from hypothesis.extra import numpy as hnp

from jaxcell.base.certificate import Outcome
from jaxcell.optimize.game import stackelberg
from jaxcell.optimize.stakes import Stakes, payoffs


# Alam 2018, Table 4.2: the payoffs at the closest vertex, at the next, and so on.
PATROLLER = [8.0, 3.5625, 1.5938, 0.7344, 0.3672, 0.2148, 0.1543, 0.1318]
ADVERSARY = [1.0, 1.0625, 0.8438, 0.6094, 0.4297, 0.3086, 0.2324, 0.1865]
METHODS = ("dobss", "multiple-lp")


def integers(*shape):
    # Small whole numbers make ties, dominated strategies and answers that are never best.
    return hnp.arrays(np.float64, shape, elements=st.integers(-3, 3).map(float))


@st.composite
def games(draw):
    types, strategies, targets = (draw(st.integers(1, most)) for most in (2, 3, 3))
    weights = np.array([draw(st.integers(0, 3)) for _ in range(types)], float) + 0.5
    leader = draw(st.sampled_from([(), (types,)]))
    return (
        draw(integers(*leader, strategies, targets)),
        draw(integers(types, strategies, targets)),
        weights / weights.sum(),
    )


def best_by_corners(leader, follower, prior):
    """Tries every corner of the commitments to which given targets are the best answers."""
    types, strategies, targets = follower.shape
    leader = np.broadcast_to(leader, follower.shape)
    best = -np.inf
    for answer in itertools.product(range(targets), repeat=types):
        paid = sum(
            share * R[:, target] for share, R, target in zip(prior, leader, answer, strict=True)
        )
        rows = [-np.eye(strategies)]
        rows += [(C - C[:, [target]]).T for C, target in zip(follower, answer, strict=True)]
        rows = np.unique(np.concatenate(rows), axis=0)
        for active in itertools.combinations(rows, strategies - 1):
            matrix = np.stack([np.ones(strategies), *active])
            if abs(np.linalg.det(matrix)) > 1e-9:
                corner = np.linalg.solve(matrix, np.eye(strategies)[0])
                if (rows @ corner <= 1e-9).all():
                    best = max(best, float(paid @ corner))
    return best


def assert_consistent(leader, follower, prior, solution):
    weights, answer = np.asarray(solution.weights), np.asarray(solution.answer)
    assert (weights >= 0).all()
    assert weights.sum() == pytest.approx(1, abs=1e-12)
    leader = np.broadcast_to(leader, follower.shape)
    replies = weights @ follower
    each = np.arange(len(answer))
    assert (replies[each, answer] >= replies.max(axis=1) - 1e-5).all()
    np.testing.assert_allclose(solution.follower_value, replies[each, answer], atol=1e-12)
    assert solution.value == pytest.approx(prior @ (weights @ leader)[each, answer], abs=1e-12)
    assert solution.certificate.outcome is Outcome.CONVERGED


@given(games())
def test_both_methods_equal_brute_force(game):
    leader, follower, prior = game
    best = best_by_corners(*game)
    for method in METHODS:
        solution = stackelberg(leader, follower, prior, method=method)
        assert_consistent(leader, follower, prior, solution)
        assert solution.value == pytest.approx(best, abs=1e-6)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("pay", [0, 10**8])
def test_a_game_by_hand(method, pay):
    # Of the commitments that keep the follower on its second target, the leader takes the one
    # where it is indifferent. What the first strategy pays for either target does not matter.
    solution = stackelberg([[2, 4], [1, 3]], [[1 + pay, pay], [0, 2]], method=method)
    np.testing.assert_allclose(solution.weights, [2 / 3, 1 / 3], atol=1e-6 if pay else 1e-9)
    assert solution.answer.tolist() == [1]
    assert solution.value == pytest.approx(11 / 3, rel=1e-6)
    assert solution.follower_value.tolist() == pytest.approx([2 / 3 * (1 + pay)])


@pytest.mark.parametrize("scale", [1e-150, 1e-6, 1e6, 1e150])
def test_the_scale_does_not_matter(scale):
    draw = np.random.default_rng(5)
    leader, follower = draw.normal(size=(3, 4)), draw.normal(size=(2, 3, 4))
    one, other = stackelberg(leader, follower), stackelberg(scale * leader, scale * follower)
    np.testing.assert_allclose(one.weights, other.weights, atol=1e-8)
    assert other.value == pytest.approx(scale * one.value)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("difference", 10.0 ** np.arange(-11, -3))
def test_answers_that_nearly_tie(method, difference):
    # The leader is paid only if the follower takes the target that pays it a little less.
    solution = stackelberg(
        [[0.0, 1.0, 0.0]], [[1.0, 1.0 - difference, 0.0]], method=method, throw=False
    )
    assert solution.value in (0, 1)
    if solution.certificate.outcome is Outcome.CONVERGED and difference > 1e-5:
        assert solution.value == 0
    if difference < 1e-10:
        assert solution.value == 1


@pytest.mark.parametrize("compute", [payoffs, jax.jit(payoffs)])
def test_payoffs_are_those_of_the_table(compute):
    patroller, adversary = compute(TABLE_4_2)
    for paid, expected in ((patroller, PATROLLER), (adversary, ADVERSARY)):
        by_place = np.take_along_axis(np.asarray(paid), TABLE_4_2, axis=1)
        np.testing.assert_allclose(by_place, np.tile(expected, (10, 1)), atol=5.1e-5)


@pytest.mark.parametrize(
    ("leader", "follower", "prior", "message"),
    [
        (np.ones(3), np.ones((1, 3)), None, r"leader: expected \[strategies, targets\]"),
        (np.ones((0, 3)), np.ones((0, 3)), None, r"leader: expected .* got the shape \[0, 3\]"),
        (np.ones((2, 3)), np.ones((3, 2)), None, r"got \[2, 3\] and \[3, 2\]"),
        (np.ones((3, 2, 2)), np.ones((2, 2, 2)), None, "follower: expected payoffs of 3 types"),
        ([[1.0, np.nan]], np.ones((1, 2)), None, r"leader\[0, 1\] is nan"),
        (np.ones((1, 2)), [[[np.inf, 0]]], None, r"follower\[0, 0, 0\] is inf"),
        ([["a", "b"]], np.ones((1, 2)), None, "leader: expected an array of numbers"),
        ([[1.0], [1.0, 2.0]], np.ones((2, 2)), None, "leader: expected an array of numbers"),
        (np.ones((1, 2)), np.ones((2, 1, 2)), [1.0], r"prior: expected 2 numbers, .* got \[1\]"),
        (np.ones((1, 2)), np.ones((2, 1, 2)), [0.5, 0.6], "prior: .* sum to 1, got 1.1"),
        (np.ones((1, 2)), np.ones((2, 1, 2)), [1.5, -0.5], r"prior\[1\] is -0.5; expected .* 0"),
    ],
)
def test_bad_games_are_refused(leader, follower, prior, message):
    with pytest.raises(ValueError, match=message):
        stackelberg(leader, follower, prior)


def test_bad_methods_are_refused():
    with pytest.raises(ValueError, match="method: expected one of"):
        stackelberg(np.ones((1, 2)), np.ones((1, 2)), method="nash")
    with pytest.raises(ValueError, match="5 types and 9 targets have 59049 combinations"):
        stackelberg(np.ones((1, 9)), np.ones((5, 1, 9)), method="multiple-lp")


def test_jax_arrays_are_taken():
    assert stackelberg(jnp.eye(2), -jnp.eye(2)).value == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("order", "stakes", "message"),
    [
        ([[0, 1, 2], [0, 1, 1]], None, r"order\[1\]: expected each vertex from 0 to 2 once"),
        ([[1, 2, 3]], None, r"order\[0\]"),
        (TABLE_4_2, Stakes(costs=np.ones(3)), "costs: expected 8 finite numbers, one per vertex"),
    ],
)
def test_bad_orders_and_stakes_are_refused(order, stakes, message):
    with pytest.raises(ValueError, match=message):
        payoffs(np.array(order), stakes)


def larger(types, strategies, targets, seed=0):
    random = np.random.default_rng(seed)
    return random.random((2, types, strategies, targets))


def test_a_program_that_is_not_good_enough_is_solved_by_another(monkeypatch):
    # HiGHS keeps to 1e-6, and a bound may be off by as much.
    milp = scipy.optimize.milp

    def off(*arguments, **options):
        program = milp(*arguments, **options)
        program.mip_dual_bound -= 2e-6
        return program

    leader, follower = larger(2, 3, 4)
    exact = stackelberg(leader, follower, method="multiple-lp")
    monkeypatch.setattr("scipy.optimize.milp", off)
    solution = stackelberg(leader, follower)
    assert solution.value == pytest.approx(exact.value, abs=1e-9)
    with pytest.raises(RuntimeError, match="residual stayed above"):
        stackelberg(leader, follower, method="dobss")


def test_an_exceeded_time_limit_is_reported():
    # Without one this game takes minutes.
    leader, follower = larger(4, 20, 50)
    with pytest.raises(RuntimeError, match=r"stackelberg: (HiGHS found no|the residual stayed)"):
        stackelberg(leader, follower, time_limit=0.5)
    with pytest.raises(ValueError, match="time_limit: expected more than 0 s, got 0"):
        stackelberg(leader, follower, time_limit=0.0)


def test_the_solver_writes_nothing(capfd, monkeypatch):
    milp = scipy.optimize.milp

    def speaks(*args, **options):
        os.write(1, b"the solver writes\n")
        return milp(*args, **options)

    monkeypatch.setattr("scipy.optimize.milp", speaks)
    stackelberg(*larger(2, 3, 4), method="dobss")
    print("after")
    assert capfd.readouterr().out == "after\n"


def test_a_linear_program_that_fails_is_solved_with_the_tolerances_of_the_solver(monkeypatch):
    solve = scipy.optimize.linprog
    payoff = np.random.default_rng(3).random((2, 4, 5))
    best = stackelberg(*payoff).value

    def fails(*arguments, options, **rest):
        if options:
            return scipy.optimize.OptimizeResult(status=4, message="HiGHS Status 0: Not Set")
        return solve(*arguments, options=options, **rest)

    monkeypatch.setattr("scipy.optimize.linprog", fails)
    assert stackelberg(*payoff).value == pytest.approx(best)
