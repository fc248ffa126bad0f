"""Numbers in a program that no chain has, and derivatives that are not computed."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxcell import bounce as bounce_, examples, mapping, markov, patrol


RIGHT = np.array([[0.5, 0.5, 0.0], [0.25, 0.25, 0.5], [0.0, 0.5, 0.5]])


def changed(cell, *row):
    matrix = RIGHT.copy()
    matrix[cell] = row
    return matrix


WRONG = {
    "nan": changed(1, 0.25, np.nan, 0.5),
    "sum": changed(1, 0.25, 0.25, 0.5 + 1e-9),
    "negative": changed(0, 1.1, -0.1, 0.0),
}
QUANTITIES = {
    "limiting": lambda chain: markov.limiting_distribution(chain),
    "hitting": lambda chain: markov.hitting_times(chain, 2),
    "arrival": lambda chain: markov.arrival_probabilities(chain, 2),
    "matrix": markov.hitting_matrix,
}


def found(name):
    def compute(matrix):
        solution = QUANTITIES[name](mapping.Chain.from_scipy(matrix))
        return solution.value, solution.certificate.converged

    return compute


@pytest.mark.parametrize("name", QUANTITIES)
@pytest.mark.parametrize("wrong", WRONG)
def test_wrong_probabilities_have_no_value(name, wrong):
    value, converged = jax.jit(found(name))(WRONG[wrong])
    assert np.isnan(value).any()
    assert not converged
    batch = jnp.stack([RIGHT, WRONG[wrong], RIGHT])
    values, converged = jax.jit(jax.vmap(found(name)))(batch)
    assert converged.tolist() == [True, False, True]
    assert np.isnan(values[1]).any()
    np.testing.assert_allclose(values[::2], [found(name)(RIGHT)[0]] * 2, rtol=1e-13)


LINE = examples.line_model()
WALK = examples.walk()
RUIN = examples.ruin()
CELLS = examples.corridor(directions=4)


def with_reward(reward):
    model = markov.DecisionModel.of(LINE.chains, reward)
    return markov.value_iteration(model, 0.5)


def with_allowed(solve):
    def compute(allowed):
        return solve(markov.DecisionModel.of(LINE.chains, np.zeros((2, 3)), allowed))

    return compute


def noisy(reliability, bounce=np.pi):
    chain = bounce_.noisy_bounce_map(CELLS, bounce, np.pi / 2, reliability)
    return markov.absorption_times(chain).value


# A call, what it takes, and what it refuses.
REFUSED = {
    "hitting": (lambda x: markov.hitting_times(WALK, x), 2, 3),
    "arrival": (lambda x: markov.arrival_probabilities(WALK, x), 2, -1),
    "conditional": (lambda x: markov.conditional_hitting_times(WALK, x), 2, 3),
    "passage": (lambda x: markov.first_passage(WALK, 0, x, steps=4), 2, -1),
    "passage from": (lambda x: markov.first_passage(WALK, x, 2, steps=4), 0, 7),
    "passage from probabilities": (
        lambda x: markov.first_passage(WALK, x, 2, steps=4),
        np.array([0.5, 0.25, 0.25]),
        np.array([0.5, 0.5, 0.5]),
    ),
    "first arrival": (lambda x: markov.first_arrival([WALK], [0], x, steps=4), 2, 7),
    "first arrival from": (lambda x: markov.first_arrival([WALK], [x], 2, steps=4), 0, 7),
    "mean": (lambda x: markov.mean_first_arrival([WALK], [x], 2), 0, -1),
    "mean from probabilities": (
        lambda x: markov.mean_first_arrival([WALK], [x], 2),
        np.array([0.5, 0.25, 0.25]),
        np.array([-0.5, 1.0, 0.5]),
    ),
    "simulation": (
        lambda x: markov.simulate_arrival(jax.random.key(0), [WALK], [x], 2, runs=3).time,
        0,
        7,
    ),
    "weights": (
        lambda x: markov.limiting_distribution(RUIN, weights=x),
        np.array([0.25, 0.75]),
        np.array([-0.5, 1.5]),
    ),
    "reward": (with_reward, np.ones((2, 3)), np.full((2, 3), np.nan)),
    "discount": (lambda x: markov.value_iteration(LINE, x), 0.5, 1),
    "allowed": (
        with_allowed(lambda model: markov.value_iteration(model, 0.5)),
        np.ones((2, 3), bool),
        np.array([[1, 1, 0], [1, 0, 0]], bool),
    ),
    "allowed on the way": (
        with_allowed(lambda model: markov.stochastic_shortest_path(model, 2).time),
        np.ones((2, 3), bool),
        np.array([[1, 1, 0], [1, 0, 0]], bool),
    ),
    "goal": (lambda x: markov.stochastic_shortest_path(LINE, x).time, 2, 3),
    "reliability": (noisy, 0.5, 0.0),
    "turns": (noisy, np.array([0.5, 0.25, 0.25]), np.array([0.2, 0.2, 0.2])),
    "angle": (lambda x: noisy(0.5, x), np.pi, np.nan),
    "images": (
        lambda x: markov.hitting_times(mapping.Chain(x, np.full((1, 3), 0.5)), 0),
        np.array([[1, 2, 0]]),
        np.array([[1, 2, 9]]),
    ),
    "push": (
        lambda x: mapping.Chain(x, np.full((1, 3), 0.5)).push(np.ones(3) / 3),
        np.array([[1, 2, 0]]),
        np.array([[1, 2, -1]]),
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_refused_numbers_have_no_value_in_a_program(name):
    call, right, wrong = REFUSED[name]
    with pytest.raises(ValueError, match=r"expected|does not exist|is not a whole|no action"):
        call(wrong)

    def numbers(given):
        result = call(given)
        certificate = getattr(result, "certificate", None)
        sure = True if certificate is None else certificate.converged
        return getattr(result, "value", result), sure, certificate is not None

    value, sure, certified = jax.jit(numbers)(wrong)
    assert np.isnan(value).any()
    assert not (certified and sure)
    batch = jnp.stack([jnp.asarray(member) for member in (right, wrong)])
    values, sure, certified = jax.jit(jax.vmap(numbers))(batch)
    assert np.isnan(values[1]).any()
    assert sure[0]
    assert not (certified[1] and sure[1])
    np.testing.assert_allclose(values[0], numbers(right)[0], rtol=1e-12)


@pytest.mark.parametrize("action", [-1, 2])
def test_actions_that_do_not_exist_have_no_value(action):
    def compute(policy):
        return markov.hitting_times(markov.policy_chain(LINE, policy), 2).value

    policies = jnp.array([[0, 0, 0], [0, action, 0]])
    first, second = jax.jit(jax.vmap(compute))(policies)
    assert first.tolist() == [2, 1, 0]
    assert np.isnan(second).any()


def walk(e):
    return jnp.array([[0.5 - e, 0.35 + e, 0.15], [0.1, 0.7, 0.2], [0.25 + e, 0.1, 0.65 - e]])


FIRST_ONLY = {
    "entropy_rate": lambda e: markov.entropy_rate(walk(e)),
    "slem": lambda e: markov.slem(walk(e)),
    "leading_modes": lambda e: markov.leading_modes(
        jnp.array([[0.7 - e, 0.3 + e], [0.2, 0.8]]), 2
    ).value.real.sum(),
    "maximum_entropy_rate": lambda e: (
        patrol.walks.maximum_entropy_rate(
            patrol.Graph([[0, 1], [1, 2], [2, 0]]), stationary=jnp.stack([0.3 + e, 0.3 - e, 0.4])
        ).value
    ),
}


@pytest.mark.parametrize("name", FIRST_ONLY)
def test_second_derivatives_that_lack_a_term_are_refused(name):
    compute = FIRST_ONLY[name]
    step = 1e-5
    difference = (compute(step) - compute(-step)) / (2 * step)
    assert jax.jit(jax.grad(compute))(0.0) == pytest.approx(float(difference), rel=1e-6)
    for inner, outer in ((jax.grad, jax.jacfwd), (jax.jacfwd, jax.jacrev)):
        with pytest.raises(TypeError, match=f"{name}: expected no second derivative"):
            outer(inner(compute))(0.0)


def test_weights_of_groups_in_a_batch():
    chain = mapping.Chain.from_scipy(np.array([[1.0, 0, 0], [0.5, 0, 0.5], [0, 0, 1.0]]))
    groups = mapping.persistent_groups(chain)

    def share(weights):
        return markov.limiting_distribution(chain, groups, weights).value

    shares = jax.jit(jax.vmap(share))(jnp.array([[0.2, 0.8], [0.5, 0.5]]))
    np.testing.assert_allclose(shares, [[0.2, 0, 0.8], [0.5, 0, 0.5]])


def test_the_second_eigenvalue_of_one_cell_has_no_slope():
    assert jax.grad(lambda p: markov.slem(p))(jnp.ones((1, 1))).tolist() == [[0.0]]
