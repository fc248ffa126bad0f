"""Numbers in a program that no chain has, and derivatives that are not computed."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxcell import examples, mapping, markov, patrol


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
TARGETS = {
    "hitting": lambda cell: markov.hitting_times(examples.walk(), cell).value,
    "arrival": lambda cell: markov.arrival_probabilities(examples.walk(), cell).value,
    "conditional": lambda cell: markov.conditional_hitting_times(examples.walk(), cell).value,
    "passage": lambda cell: markov.first_passage(examples.walk(), 0, cell, steps=4),
    "start": lambda cell: markov.first_passage(examples.walk(), cell, 0, steps=4),
    "quickest": lambda cell: markov.stochastic_shortest_path(LINE, cell).time,
}


@pytest.mark.parametrize("name", TARGETS)
@pytest.mark.parametrize("cell", [-1, 3])
def test_cells_that_do_not_exist_have_no_value(name, cell):
    compute = jax.jit(jax.vmap(TARGETS[name]))
    values = compute(jnp.array([0, cell, 1]))
    assert np.isnan(values[1]).all()
    assert not np.isnan(values[::2]).any()
    assert np.isnan(jax.jit(TARGETS[name])(jnp.array([0, cell]))).all()


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


def test_second_derivatives_of_solutions_are_right():
    # From state 0 to state 1 with probability e: 1 / e steps.
    def time(e):
        return markov.hitting_times(jnp.array([[1 - e, e], [0.0, 1.0]]), 1).value[0]

    assert jax.hessian(time)(0.25) == pytest.approx(2 / 0.25**3, rel=1e-12)


def test_weights_of_groups_in_a_batch():
    chain = mapping.Chain.from_scipy(np.array([[1.0, 0, 0], [0.5, 0, 0.5], [0, 0, 1.0]]))
    groups = mapping.persistent_groups(chain)

    def share(weights):
        return markov.limiting_distribution(chain, groups, weights).value

    shares = jax.jit(jax.vmap(share))(jnp.array([[0.2, 0.8], [0.5, 0.5]]))
    np.testing.assert_allclose(shares, [[0.2, 0, 0.8], [0.5, 0, 0.5]])


def test_the_second_eigenvalue_of_one_cell_has_no_slope():
    assert jax.grad(lambda p: markov.slem(p))(jnp.ones((1, 1))).tolist() == [[0.0]]
