"""Quantities of chains under jit, vmap and grad: values against the host, derivatives exactly.

The truth of a derivative is a central difference in rational numbers, in which nothing is rounded.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flint import fmpq

from jaxcell import examples, markov
from jaxcell.mapping import Chain, ChainSequence, persistent_groups

from ..oracles import exact_chains


CELLS = 9


def irreducible(rng):
    """A random chain whose probabilities are multiples of 2^-16, and sum to 1 exactly."""
    counts = rng.integers(1, 2**12, (CELLS, CELLS)) * (rng.random((CELLS, CELLS)) < 0.3)
    counts[np.arange(CELLS), (np.arange(CELLS) + 1) % CELLS] = 0
    counts[np.arange(CELLS), (np.arange(CELLS) + 1) % CELLS] = 2**16 - counts.sum(axis=1)
    return counts / 2**16


def absorbing(rng):
    P = irreducible(rng)
    P[[3, 7]] = np.eye(CELLS)[[3, 7]]
    return P


def groups(chain):
    return persistent_groups(chain)


def half(P):
    """A chain that leaves the space in a tenth of the steps, except from closed cells."""
    return np.where(np.diag(P)[:, None] == 1, P, 0.9 * P)


def exact_columns(matrix, sets):
    return np.array(exact_chains.ends(matrix, sets), dtype=object)


def exact_hitting_matrix(matrix):
    return [time for j in range(len(matrix)) for time in exact_chains.times(matrix, j)]


def exact_conditional(matrix):
    times = exact_chains.conditional_times(matrix, {3}, {7})
    return [times.get(i, fmpq(0)) for i in range(len(matrix))]


REWARD = np.array([np.arange(CELLS) % 4, np.arange(CELLS) % 3], float)
BACK = np.roll(np.eye(CELLS), -1, axis=1)


def optimum(chain):
    model = markov.DecisionModel.of([chain, Chain.from_scipy(BACK)], REWARD)
    return markov.value_iteration(model, 0.9)


def shortest(chain):
    model = markov.DecisionModel.of([chain, Chain.from_scipy(BACK)], REWARD)
    return markov.stochastic_shortest_path(model, 4)


# The quantity, the chain, and the exact quantity, if it is rational.
QUANTITIES = {
    "hitting_times": (
        lambda chain: markov.hitting_times(chain, 4).value,
        irreducible,
        lambda P: exact_chains.times(P, 4),
    ),
    "arrival_probabilities": (
        lambda chain: markov.arrival_probabilities(chain, 3).value,
        absorbing,
        lambda P: exact_columns(P, [{3}, {7}])[:, 0],
    ),
    "conditional_hitting_times": (
        lambda chain: jnp.where(
            jnp.arange(CELLS) == 7, 0.0, markov.conditional_hitting_times(chain, 3).value
        ),
        absorbing,
        exact_conditional,
    ),
    "absorption_probabilities": (
        lambda chain: markov.absorption_probabilities(chain, groups(chain)).value[:2].T,
        absorbing,
        lambda P: exact_columns(P, [{3}, {7}])[:, :2].ravel(),
    ),
    "absorption_times": (
        lambda chain: markov.absorption_times(chain, groups(chain)).value,
        absorbing,
        lambda P: exact_columns(P, [{3, 7}])[:, -1],
    ),
    "limiting_distribution": (
        lambda chain: markov.limiting_distribution(chain, groups(chain)).value,
        irreducible,
        exact_chains.stationary,
    ),
    "weights of groups": (
        lambda chain: markov.limiting_distribution(chain, groups(chain)).weights[:2],
        absorbing,
        lambda P: sum(exact_columns(P, [{3}, {7}])[:, :2]) / CELLS,
    ),
    "hitting_matrix": (
        lambda chain: markov.hitting_matrix(chain).value.T,
        irreducible,
        exact_hitting_matrix,
    ),
    "kemeny_constant": (
        markov.kemeny_constant,
        irreducible,
        lambda P: [exact_chains.kemeny(P)],
    ),
    "value_iteration": (
        lambda chain: optimum(chain).value,
        irreducible,
        lambda P: exact_chains.best_values([P, BACK], REWARD, 0.9),
    ),
    "commute_times": (lambda chain: markov.commute_times(chain).value, irreducible, None),
    "entropy_rate": (markov.entropy_rate, irreducible, None),
    "slem": (markov.slem, irreducible, None),
    "shortest path": (lambda chain: shortest(chain).time, irreducible, None),
    "surest path": (
        lambda chain: shortest(chain).probability,
        lambda rng: half(irreducible(rng)),
        None,
    ),
}


def direction(P, rng):
    """A change of possible steps, in multiples of 2^-10, that preserves the sums of the rows."""
    change = np.zeros(P.shape)
    for row, of_row in zip(change, P, strict=True):
        steps = np.flatnonzero(of_row)
        row[steps] = rng.integers(-(2**9), 2**9, steps.size) / 2**10
        row[steps[-1]] -= row.sum()
    return change


def of_matrix(quantity, P):
    """A quantity as a function of the matrix, whose pattern does not change."""
    chain = Chain.from_scipy(P)
    cells = np.arange(CELLS)
    used = np.asarray(chain.probability) > 0

    def function(matrix):
        return quantity(Chain(chain.image, jnp.where(used, matrix[cells, chain.image], 0.0)))

    return function


@pytest.mark.parametrize("name", QUANTITIES)
@pytest.mark.parametrize("seed", range(3))
def test_derivatives_are_exact(name, seed):
    quantity, make, exact = QUANTITIES[name]
    rng = np.random.default_rng(seed)
    P = make(rng)
    change = direction(P, rng)
    function = of_matrix(quantity, P)
    value, slope = jax.jit(lambda P, d: jax.jvp(function, (P,), (d,)))(P, change)
    step, accuracy = 2.0**-30, 1e-11
    if exact is None:
        function, step, accuracy = of_matrix(quantity, P), 2.0**-20, 1e-7
        ahead, behind = (np.asarray(function(P + h * change)) for h in (step, -step))
        truth = (ahead - behind) / (2 * step)
    else:
        np.testing.assert_allclose(np.ravel(value), exact_chains.as_floats(exact(P)), rtol=1e-12)
        ends = [exact(P + h * change) for h in (step, -step)]
        truth = exact_chains.as_floats([(a - b) * fmpq(2**29) for a, b in zip(*ends, strict=True)])
    scale = np.abs(truth).max()
    assert np.abs(np.ravel(slope) - np.ravel(truth)).max() <= accuracy * scale
    weight = rng.random(np.shape(value))
    backward = np.asarray(jax.grad(lambda P: jnp.sum(function(P) * weight))(P))
    forward = np.sum(np.asarray(slope) * weight)
    assert np.sum(backward * change) == pytest.approx(forward, rel=1e-9)


@pytest.mark.parametrize("name", QUANTITIES)
def test_batches_equal_loops(name):
    quantity, make, _ = QUANTITIES[name]
    rng = np.random.default_rng(5)
    P = make(rng)
    function = of_matrix(quantity, P)
    shared = direction(P, rng)
    batch = np.stack([P + h * shared for h in (0, 2**-19, 2**-18)])
    found = jax.jit(jax.vmap(function))(batch)
    for value, matrix in zip(found, batch, strict=True):
        alone = quantity(Chain.from_scipy(matrix))
        np.testing.assert_allclose(value, alone, rtol=1e-13, atol=1e-15)


def test_values_and_certificates_are_those_of_the_host():
    chain = examples.ruin()
    alone = markov.arrival_probabilities(chain, 3)
    traced = jax.jit(lambda chain: markov.arrival_probabilities(chain, 3))(chain)
    np.testing.assert_array_equal(traced.value, alone.value)
    assert traced.certificate.residual == alone.certificate.residual
    assert bool(traced.certificate.converged)


def test_values_that_cannot_be_computed_are_nan():
    chain = examples.ruin()
    with pytest.raises(ValueError, match="irreducible"):
        markov.kemeny_constant(chain)
    assert np.isnan(jax.jit(markov.kemeny_constant)(chain))
    found = jax.jit(markov.hitting_matrix)(chain)
    assert np.isnan(found.value).all()
    assert not found.certificate.converged


def test_targets_and_discounts_can_be_traced():
    chain = examples.walk()
    times = jax.jit(lambda target: markov.hitting_times(chain, target).value)
    for target in range(3):
        np.testing.assert_array_equal(times(target), markov.hitting_times(chain, target).value)
    masks = np.eye(3, dtype=bool)
    each = jax.vmap(lambda mask: markov.hitting_times(chain, mask).value)(masks)
    np.testing.assert_array_equal(each, [times(target) for target in range(3)])
    model = examples.line_model()
    # At the right end, V = g (1 + V) for the discount g, so that its derivative is 1 / (1 - g)^2.
    right = jax.grad(lambda discount: markov.value_iteration(model, discount).value[2])
    assert float(right(0.5)) == pytest.approx(4, rel=1e-12)
    # A number beside a batch of rewards.
    rewards = jnp.stack([model.reward, 2 * model.reward])

    def values(reward):
        return markov.value_iteration(dataclasses.replace(model, reward=reward), 0.5).value

    found = jax.vmap(values)(rewards)
    np.testing.assert_allclose(found, [[0.25, 0.5, 1], [0.5, 1, 2]], rtol=1e-12)


def test_second_derivatives_of_times():
    # A cell that is left with probability p is left after 1 / p steps.
    def time(p):
        chain = Chain(np.array([[0, 1], [1, 1]]), jnp.array([[1 - p, 1.0], [p, 0.0]]))
        return markov.hitting_times(chain, 1).value[0]

    assert float(jax.grad(time)(0.25)) == pytest.approx(-16, rel=1e-12)
    assert float(jax.grad(jax.grad(time))(0.25)) == pytest.approx(128, rel=1e-12)


@pytest.mark.parametrize("whole", [np.int32, np.int64, jnp.int32])
def test_whole_numbers_of_arrays_count_as_those_of_python(whole):
    chain, tide = examples.walk(), ChainSequence.of([examples.ruin(), examples.stream()])
    key = jax.random.key(0)

    def quantities(two, five):
        def compute(chain, tide):
            return (
                markov.leading_modes(tide, two, start=two, steps=five).value,
                markov.first_passage(chain, 0, 2, steps=five),
                markov.simulate_arrival(key, [chain], [0], 2, five, horizon=five).time,
            )

        return compute(chain, tide), jax.jit(compute)(chain, tide)

    expected = quantities(2, 5)
    for found, exact in zip(quantities(whole(2), whole(5)), expected, strict=True):
        for first, second in zip(found, exact, strict=True):
            np.testing.assert_array_equal(first, second)


def test_whole_numbers_that_are_traced_are_refused():
    with pytest.raises(TypeError, match="leading_modes reads the values of its arrays"):
        jax.jit(lambda n: markov.leading_modes(examples.walk(), 2, start=n).value)(1)
