"""Best actions for a number of steps and in the long run, against all policies."""

import itertools

import jax
import numpy as np
import pytest

from jaxcell import markov
from jaxcell.mapping import Chain


def drawn(seed, cells=4, actions=3):
    draw = np.random.default_rng(seed)
    matrices = draw.dirichlet(np.full(cells, 0.4), (actions, cells))
    # All policies have one group, because all cells lead to cell 0.
    matrices = 0.9 * matrices + 0.1 * np.eye(cells)[0]
    reward = draw.normal(size=(actions, cells))
    allowed = draw.random((actions, cells)) < 0.7
    allowed[0] = True
    model = markov.DecisionModel.of([Chain.from_scipy(m) for m in matrices], reward, allowed)
    return matrices, reward, allowed, model


@pytest.mark.parametrize("seed", range(4))
def test_actions_for_some_steps_are_those_of_a_search(seed):
    matrices, reward, allowed, model = drawn(seed)

    def best(cell, left):
        if not left:
            return 0.0, -1
        after = [best(to, left - 1)[0] for to in range(4)]
        totals = [reward[u, cell] + matrices[u, cell] @ after for u in range(3) if allowed[u, cell]]
        names = [u for u in range(3) if allowed[u, cell]]
        return max(totals), names[int(np.argmax(totals))]

    value, policy = markov.finite_horizon(model, 4)
    for left, cell in itertools.product(range(1, 5), range(4)):
        total, action = best(cell, left)
        assert value[left, cell] == pytest.approx(total, rel=1e-12)
        assert policy[left - 1, cell] == action


@pytest.mark.parametrize("seed", range(6))
def test_average_is_the_largest_of_all_policies(seed):
    matrices, reward, allowed, model = drawn(seed)
    averages = []
    for policy in itertools.product(range(3), repeat=4):
        if allowed[list(policy), range(4)].all():
            chain = matrices[list(policy), range(4)]
            share = np.linalg.solve(np.eye(4) - chain.T + 1, np.ones(4))
            averages.append(share @ reward[list(policy), range(4)])
    best = markov.average_reward(model)
    assert best.reward == pytest.approx(max(averages), rel=1e-12)
    assert best.certificate.residual < 1e-12
    chosen = np.asarray(best.policy)
    chain, gain = matrices[chosen, range(4)], reward[chosen, range(4)]
    np.testing.assert_allclose(best.bias + best.reward, gain + chain @ best.bias, atol=1e-12)


def test_average_is_the_limit_of_discounted_values_and_has_derivatives():
    _, reward, allowed, model = drawn(9)
    best = markov.average_reward(model)
    value = markov.value_iteration(model, 1 - 1e-9).value
    np.testing.assert_allclose(1e-9 * value, best.reward, rtol=1e-6)

    def average(x):
        return markov.average_reward(
            markov.DecisionModel.of(model.chains, reward * (1 + x), allowed)
        ).reward

    assert jax.jit(jax.grad(average))(0.0) == pytest.approx(best.reward, rel=1e-12)


def test_models_without_one_average_are_refused():
    for matrix, message in ((np.eye(2), "2 persistent groups"), (0.5 * np.eye(2), "may leave")):
        model = markov.DecisionModel.of([Chain.from_scipy(matrix)], np.ones((1, 2)))
        with pytest.raises(ValueError, match=message):
            markov.average_reward(model)
