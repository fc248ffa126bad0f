import jax
import numpy as np
import pytest
from hypothesis import given, strategies as st
from oracles import exact_chains as exact
from random_models import as_model, models, policies

from jaxcell.base.certificate import Outcome
from jaxcell.mapping.generalized import Chain
from jaxcell.markov import DecisionModel, policy_chain, value_iteration


def of_policy(matrices, reward, policy, discount):
    """Compute the value of a policy, with the first reward discounted, by a dense solve."""
    cell = np.arange(len(policy))
    chosen = matrices[policy, cell]
    return np.linalg.solve(np.eye(len(policy)) - discount * chosen, discount * reward[policy, cell])


def grid_model(seed, stays):
    """Make a model of four noisy directions on a torus, which cell 0 leaves unless it `stays`."""
    side, draw = 7, np.random.default_rng(seed)
    y, x = np.divmod(np.arange(side * side), side)
    to = [((y + v) % side) * side + (x + u) % side for u, v in ((1, 0), (0, 1), (-1, 0), (0, -1))]
    noise = draw.uniform(0.05, 0.2, side * side)
    chains = []
    for k in range(4):
        probability = np.stack([1 - 2 * noise, noise, noise])
        if not stays:
            probability[:, 0] /= 2
        chains.append(Chain(np.stack([to[k], to[k - 1], to[k - 3]]), probability))
    return DecisionModel.of(chains, draw.normal(size=(4, side * side)))


@given(models(), st.sampled_from([0.3, 0.9, 0.99]))
def test_value_is_that_of_the_best_policy(parts, discount):
    matrices, reward, allowed = parts
    result = value_iteration(as_model(*parts), discount, 1e-7)
    every = [of_policy(matrices, reward, policy, discount) for policy in policies(allowed)]
    best = np.max(every, axis=0)
    np.testing.assert_allclose(result.value, best, atol=result.gap + 1e-10)
    assert result.gap <= 1e-7 * np.abs(best).max()
    assert result.certificate.outcome is Outcome.CONVERGED
    policy = np.asarray(result.policy)
    assert allowed[policy, np.arange(policy.size)].all()
    own = of_policy(matrices, reward, policy, discount)
    assert (own >= best - 2 * result.gap - 1e-10).all()


def drawn_model(draw, rows, cells=6, actions=3):
    """Draw matrices whose rows stay, are short or long by rounding, or leave, and rewards."""
    matrices = draw.random((actions, cells, cells)) * (draw.random((actions, cells, cells)) < 0.5)
    matrices += 0.01 * np.eye(cells)
    if rows != "several classes":
        matrices += 0.2 * np.roll(np.eye(cells), 1, axis=1)
    matrices /= matrices.sum(axis=2, keepdims=True)
    if rows == "short":
        matrices *= 1 - 10.0 ** -draw.uniform(12, 14, (actions, cells, 1))
    if rows == "long":
        matrices *= 1 + 10.0 ** -draw.uniform(12.1, 14, (actions, cells, 1))
    if rows == "leave":
        matrices[:, 0] *= 0.7
    reward = draw.normal(size=(actions, cells)).round(1)
    if rows == "costs":
        leaving = draw.choice([0, 1e-5, 0.01, 0.1], (actions, cells, 1))
        matrices, reward = matrices * (1 - leaving), -np.abs(reward)
    return matrices, reward


@pytest.mark.parametrize("rows", ["stay", "short", "long", "leave", "several classes", "costs"])
@pytest.mark.parametrize("ahead", [0.5, 1e-2, 1e-5, 1e-7, 1e-9, 1e-11, 1e-13])
@pytest.mark.parametrize("seed", range(4))
def test_gap_bounds_the_error_at_any_discount(rows, ahead, seed):
    if rows == "long" and ahead < 1e-9:
        return  # Values are infinite if a row is longer than the discount allows.
    matrices, reward = drawn_model(np.random.default_rng(seed), rows)
    model = DecisionModel.of([Chain.from_scipy(matrix) for matrix in matrices], reward)
    stored = [chain.to_scipy().toarray() for chain in model.chains]
    best = exact.best_values(stored, reward, 1 - ahead)
    result = value_iteration(model, 1 - ahead)
    assert max(map(exact.distance, result.value, best)) <= result.gap
    assert result.certificate.residual <= 1e-8
    assert result.iterations < 20


def test_rows_that_outlast_the_discount_are_not_certified():
    matrix = np.array([[0.5, 0.5 + 9e-13], [0.5, 0.5]])
    model = DecisionModel.of([Chain.from_scipy(matrix)], np.ones((1, 2)))
    result = value_iteration(model, 1 - 1e-13, throw=False)
    assert result.certificate.residual == np.inf
    with pytest.raises(RuntimeError, match="value_iteration: the residual stayed above"):
        value_iteration(model, 1 - 1e-13)


def test_gap_is_small_if_nothing_leaves():
    # All values are equal, so that the first sweep finds them.
    chain = Chain(np.arange(5)[None], np.ones((1, 5)))
    result = value_iteration(DecisionModel.of([chain], np.full((1, 5), -2.0)), 0.9999)
    assert result.iterations == 1
    np.testing.assert_allclose(result.value, -2 * 0.9999 / (1 - 0.9999), rtol=1e-12)


def test_first_of_equal_actions_is_taken():
    image = np.zeros((1, 3), int)
    chains = [Chain(image, np.ones((1, 3)))] * 3
    reward = np.array([[0.0, 1, 1], [1, 1, 1 + 1e-15], [1, 0, 1]])
    assert value_iteration(DecisionModel.of(chains, reward), 0.9).policy.tolist() == [1, 0, 0]


def test_slightly_worse_action_is_not_taken():
    # Compared with the value of cell 0, the gain of the better action in cell 1 is rounding.
    ends, stays = np.zeros((2, 2)), np.diag([0.0, 1.0])
    chains = [Chain.from_scipy(stays), Chain.from_scipy(ends)]
    model = DecisionModel.of(chains, [[1e13, 0], [1e13, 1]])
    result = value_iteration(model, 0.9, tolerance=0.01)
    assert result.certificate.outcome is Outcome.CONVERGED
    np.testing.assert_allclose(result.value, [0.9e13, 0.9], rtol=1e-12)


def test_iteration_that_takes_too_many_rounds_is_reported():
    model = grid_model(0, True)
    with pytest.raises(RuntimeError, match=r"value_iteration: the residual stayed above"):
        value_iteration(model, 0.999, max_rounds=1)
    result = value_iteration(model, 0.999, max_rounds=1, throw=False)
    assert (result.certificate.outcome, result.iterations) == (Outcome.STALLED, 1)
    matrices = np.stack([chain.to_scipy().toarray() for chain in model.chains])
    value = np.zeros(model.cells)
    for _ in range(40_000):
        value = 0.999 * (np.asarray(model.reward) + matrices @ value).max(axis=0)
    assert np.abs(np.asarray(result.value) - value).max() <= result.gap


def test_tolerance_below_rounding_is_not_met():
    result = value_iteration(grid_model(0, True), 0.999, 1e-300, throw=False)
    assert result.certificate.outcome is Outcome.STALLED
    assert result.certificate.residual < 1e-12


@given(models(), st.data())
def test_policy_chain_follows_the_policy(parts, data):
    matrices, _, allowed = parts
    policy = data.draw(st.sampled_from(policies(allowed)))
    result = policy_chain(as_model(*parts), jax.device_put(policy)).to_scipy().toarray()
    np.testing.assert_array_equal(result, matrices[policy, np.arange(policy.size)])


def test_bad_models_and_policies_are_refused():
    chain = Chain(np.zeros((1, 2), int), np.ones((1, 2)))
    other = Chain(np.zeros((1, 3), int), np.ones((1, 3)))
    model = DecisionModel.of([chain, chain], np.zeros((2, 2)), [[True, True], [False, True]])
    for arguments, message in [
        (([], np.zeros((0, 2))), "expected a chain for each action"),
        (([chain, other], np.zeros((2, 2))), "the chain of action 1 has 3 cells"),
        (([chain], np.zeros((2, 2))), r"reward: expected an array \[actions, cells\] = \[1, 2\]"),
        (([chain], [[0.0, np.nan]]), r"reward\[0, 1\] is nan"),
        (([chain], np.zeros((1, 2)), [[True, False]]), "no action is allowed in cell 1"),
        (
            ([chain], np.zeros((1, 2)), [[1, 1]]),
            r"allowed: expected .* of bool, got",
        ),
    ]:
        with pytest.raises(ValueError, match=message):
            DecisionModel.of(*arguments)
    for discount in (0, 1, 1.5, np.nan):
        with pytest.raises(ValueError, match="stochastic_shortest_path"):
            value_iteration(model, discount)
    with pytest.raises(ValueError, match="tolerance: expected a positive number, got 0"):
        value_iteration(model, 0.9, 0)
    with pytest.raises(ValueError, match=r"policy\[1\]: action 2 does not exist; .* are 0 to 1"):
        policy_chain(model, jax.device_put(np.array([0, 2])))
    with pytest.raises(ValueError, match="action 1 is not allowed in cell 0"):
        policy_chain(model, jax.device_put(np.array([1, 1])))
