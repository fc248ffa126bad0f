"""Batches of chains under vmap: exact values, several sets of steps, and members left to the host.

The truth is rational arithmetic, or a call for each member.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxcell import markov
from jaxcell.mapping import Chain, classes, persistent_groups
from jaxcell.mapping.batch import Batch
from jaxcell.markov import discounted, transient
from jaxcell.markov.solving import rounds

from ..oracles import exact_chains


CELLS, MEMBERS = 12, 5


def batch_of(rng, closed=(), leak=0.0):
    """Matrices with the same random steps; some cells are closed, others may leave the space."""
    steps = rng.random((CELLS, CELLS)) < 0.2
    steps[np.arange(CELLS), (np.arange(CELLS) + 1) % CELLS] = True
    matrices = rng.random((MEMBERS, CELLS, CELLS)) ** 4 * steps
    matrices /= matrices.sum(axis=-1, keepdims=True) * (1 + leak * (rng.random((CELLS, 1)) < 0.3))
    matrices[:, closed] = np.eye(CELLS)[list(closed)]
    return matrices


def chain_of(matrix):
    """A chain with room for a step to each cell, so that any batch of chains has one shape."""
    image = np.tile(np.arange(CELLS, dtype=np.int32)[:, None], (1, CELLS))
    return Chain(image, jnp.asarray(matrix).T)


def alone(*_):
    raise AssertionError("a member was computed alone")


@pytest.mark.parametrize("seed", range(3))
def test_hitting_times_are_exact(seed, monkeypatch):
    matrices = batch_of(np.random.default_rng(seed))
    monkeypatch.setattr(transient.Transient, "of", alone)

    @jax.jit
    @jax.vmap
    def found(P):
        solution = markov.hitting_times(chain_of(P), 4)
        return solution.value, solution.certificate.residual

    for value, bound, matrix in zip(*found(matrices), matrices, strict=True):
        truth = exact_chains.times(matrix, 4)
        assert exact_chains.relative(value, truth) <= min(1e-13, float(bound))


@pytest.mark.parametrize("seed", range(3))
def test_weights_and_shares_are_exact(seed, monkeypatch):
    matrices = batch_of(np.random.default_rng(seed), closed=(3, 7), leak=0.1)
    monkeypatch.setattr(transient.Transient, "of", alone)

    @jax.jit
    @jax.vmap
    def found(P):
        chain = chain_of(P)
        limits = markov.limiting_distribution(chain, persistent_groups(chain))
        return limits.value, limits.weights, limits.leaving, limits.certificate.converged

    for value, weights, leaving, converged, matrix in zip(*found(matrices), matrices, strict=True):
        assert converged
        out = np.zeros((CELLS + 1, CELLS + 1))
        out[:CELLS, :CELLS], out[:CELLS, CELLS] = matrix, 1 - matrix.sum(axis=1)
        table = exact_chains.ends(out, [{3}, {7}, {CELLS}])[:CELLS]
        truth = [sum(column) / CELLS for column in zip(*table, strict=True)][:2]
        assert exact_chains.relative(weights[:2], truth) <= 1e-13
        assert exact_chains.relative(value[jnp.array([3, 7])], truth) <= 1e-13
        assert exact_chains.distance(leaving, 1 - sum(truth)) <= 1e-14


def test_rare_steps_keep_their_digits():
    # Cell 2 is reached by two steps in a row of probability p, so after 2 / p + 1 / p^2 steps.
    def time(p):
        P = jnp.array([[1 - p, p, 0], [1 - p, 0, p], [0, 0, 1.0]])
        image = jnp.tile(jnp.arange(3)[:, None], (1, 3))
        return markov.hitting_times(Chain(image, P.T), 2).value[0]

    p = 2.0 ** -np.array([1.0, 20, 26])
    np.testing.assert_allclose(jax.vmap(time)(p), 1 / p + 1 / p**2, rtol=1e-14)


def test_members_with_numbers_too_small_for_64_bits_are_left_to_the_host():
    def time(p):
        image = jnp.array([[1, 2, 3, 3], [0, 0, 0, 3]])
        P = jnp.array([[p, p, p, 1.0], [1 - p, 1 - p, 1 - p, 0.0]])
        return markov.hitting_times(Chain(image, P), 3).value

    p = np.array([0.5, 1e-120, 0.25])
    found = jax.vmap(time)(p)
    np.testing.assert_allclose(found, [jax.jit(time)(each) for each in p], rtol=1e-12)
    assert np.isinf(found[1, 0])


def test_several_sets_of_steps_in_one_batch():
    rng = np.random.default_rng(0)
    matrices = np.concatenate(
        [batch_of(rng), batch_of(rng, closed=(3, 7)), batch_of(rng, closed=(5,), leak=0.2)]
    )
    matrices = matrices[rng.permutation(len(matrices))]

    def quantities(P):
        chain = chain_of(P)
        groups = persistent_groups(chain)
        limits = markov.limiting_distribution(chain, groups)
        times = markov.hitting_times(chain, 5).value
        return limits.value, limits.leaving, groups.group, times

    found = jax.jit(jax.vmap(quantities))(matrices)
    for number, matrix in enumerate(matrices):
        for value, truth in zip(found, quantities(matrix), strict=True):
            np.testing.assert_allclose(value[number], truth, rtol=1e-12, atol=1e-15)


def test_groups_are_found_once_for_members_with_the_same_steps(monkeypatch):
    calls = []

    def counted(matrix):
        calls.append(matrix.shape)
        return classes_of(matrix)

    classes_of = classes.closed_classes
    monkeypatch.setattr(classes, "closed_classes", counted)
    matrices = batch_of(np.random.default_rng(0), closed=(3, 7))
    group = jax.vmap(lambda P: persistent_groups(chain_of(P)).group)(matrices)
    assert len(calls) == 1
    assert (np.asarray(group) == np.asarray(persistent_groups(chain_of(matrices[0])).group)).all()


def test_batches_of_batches_and_of_targets():
    matrices = batch_of(np.random.default_rng(2))

    def time(P, target):
        return markov.hitting_times(chain_of(P), target).value

    targets = np.array([1, 4, 9])
    found = jax.jit(jax.vmap(jax.vmap(time, (None, 0)), (0, None)))(matrices, targets)
    for row, matrix in zip(found, matrices, strict=True):
        for value, target in zip(row, targets, strict=True):
            np.testing.assert_allclose(value, time(matrix, int(target)), rtol=1e-13)


@pytest.mark.parametrize("quantity", ["times", "shares"])
def test_gradients_of_batches_equal_loops(quantity, monkeypatch):
    rng = np.random.default_rng(3)
    matrices, weight = batch_of(rng), rng.standard_normal(CELLS)

    def total(P):
        chain = chain_of(P)
        if quantity == "times":
            return markov.hitting_times(chain, 4).value @ weight
        return markov.limiting_distribution(chain, persistent_groups(chain)).value @ weight

    loop = np.array([jax.grad(total)(matrix) for matrix in matrices])
    if quantity == "times":
        monkeypatch.setattr(transient.Transient, "of", alone)
    scale = np.abs(loop).max()
    np.testing.assert_allclose(jax.vmap(jax.grad(total))(matrices), loop, atol=1e-12 * scale)


@pytest.mark.parametrize("adjoint", [False, True])
def test_elimination_in_rounds_solves_both_equations(adjoint):
    rng = np.random.default_rng(4)
    matrices = batch_of(rng, leak=0.5)
    inside, right = rng.random(CELLS) < 0.8, rng.standard_normal((CELLS, MEMBERS))
    image = np.tile(np.arange(CELLS)[:, None], (1, CELLS))
    batch = Batch.of(image, matrices.transpose(0, 2, 1))
    found, error = rounds.eliminated(batch, inside, right, adjoint=adjoint)
    assert (error < 1e-12).all()
    for number, matrix in enumerate(matrices):
        Q = matrix[inside][:, inside]
        system = np.eye(len(Q)) - (Q.T if adjoint else Q)
        truth = np.linalg.solve(system, right[inside, number])
        np.testing.assert_allclose(found[inside, number], truth, rtol=1e-9, atol=1e-12)
    assert not found[~inside].any()


def test_long_eliminations_are_left_to_the_host(monkeypatch):
    matrices = batch_of(np.random.default_rng(5))
    monkeypatch.setattr(rounds, "_MOST", 0)
    monkeypatch.setattr(rounds, "_MOST_PER_STEP", 0)
    rounds._PLANS.clear()
    found = jax.vmap(lambda P: markov.hitting_times(chain_of(P), 4).value)(matrices)
    rounds._PLANS.clear()
    for value, matrix in zip(found, matrices, strict=True):
        truth = markov.hitting_times(Chain.from_scipy(matrix), 4).value
        np.testing.assert_array_equal(value, truth)


def test_as_many_plans_are_kept_as_fit(monkeypatch):
    rounds._PLANS.clear()
    image = (np.arange(CELLS) + np.array([[1], [5]])) % CELLS
    batch = Batch.of(image, np.full((1, 2, CELLS), 0.5))
    cells = np.eye(CELLS, dtype=bool)

    def solve(number):
        rounds.eliminated(batch, ~cells[number], np.ones((CELLS, 1)))
        return list(rounds._PLANS)

    assert len({key for number in (0, 1, 0, 1) for key in solve(number)}) == 2
    (first, second) = solve(1)
    assert solve(0) == [second, first]
    monkeypatch.setattr(rounds, "_KEPT", 0)
    assert solve(1) == [second]
    rounds._PLANS.clear()


def plain_values(matrices, reward, allowed, discount):
    """Values by the equation, repeated until rounding stops it."""
    value = np.zeros(CELLS)
    for _ in range(int(40 / (1 - discount))):
        gain = np.where(allowed, reward + matrices @ value, -np.inf)
        value = discount * gain.max(axis=0)
    return value


@pytest.mark.parametrize("seed", range(3))
def test_best_values_of_many_discounts_and_rewards(seed, monkeypatch):
    rng = np.random.default_rng(seed)
    matrices, reward = batch_of(rng, leak=0.1)[:3], rng.normal(size=(MEMBERS, 3, CELLS))
    allowed = rng.random((3, CELLS)) < 0.6
    allowed[0] |= ~allowed.any(axis=0)
    chains = tuple(chain_of(matrix) for matrix in matrices)
    discounts = np.array([0.1, 0.5, 0.8, 0.97, 0.99])

    @jax.jit
    @jax.vmap
    def found(discount, reward):
        model = markov.DecisionModel(chains, reward, jnp.asarray(allowed))
        best = markov.value_iteration(model, discount, 1e-9)
        return best.value, best.policy, best.certificate.residual

    with monkeypatch.context() as patch:
        patch.setattr(discounted, "_optimum", alone)
        results = found(discounts, reward)
    for value, policy, bound, discount, gains in zip(*results, discounts, reward, strict=True):
        truth = plain_values(matrices, gains, allowed, discount)
        assert np.abs(value - truth).max() <= float(bound) * np.abs(truth).max()
        assert bound <= 1e-9
        only = np.arange(3)[:, None] == np.asarray(policy)
        assert (allowed & only).any(axis=0).all()
        own = plain_values(matrices, gains, only, discount)
        assert (truth - own).max() <= 3e-9 * np.abs(truth).max()


def test_discounts_near_1_are_left_to_each_member():
    matrix = batch_of(np.random.default_rng(0))[0]
    reward = np.random.default_rng(1).normal(size=(1, CELLS))

    @jax.jit
    @jax.vmap
    def found(discount):
        model = markov.DecisionModel(
            (chain_of(matrix),), jnp.asarray(reward), jnp.ones((1, CELLS), bool)
        )
        return markov.value_iteration(model, discount).value

    discounts = np.array([0.5, 0.999999])
    assert np.isnan(found(np.array([0.5, 0.0, -0.5, 1.0]))).all(axis=1).tolist() == [
        False,
        *[True] * 3,
    ]
    for value, discount in zip(found(discounts), discounts, strict=True):
        truth = np.linalg.solve(np.eye(CELLS) - discount * matrix, discount * reward[0])
        np.testing.assert_allclose(value, truth, rtol=1e-8)


def test_equal_calls_without_jit_are_compiled_once():
    matrices = batch_of(np.random.default_rng(3))
    compiled = []

    def listen(event, _, **__):
        compiled.extend([event] * ("backend_compile" in event))

    def quantities(P):
        chain = chain_of(P)
        share = markov.limiting_distribution(chain, persistent_groups(chain)).value
        return share, markov.mixing_time(chain, 0.1), markov.hitting_matrix(chain).value

    first = jax.vmap(quantities)(matrices)
    jax.monitoring.register_event_duration_secs_listener(listen)
    again = jax.vmap(quantities)(matrices[::-1])
    jax.monitoring.unregister_event_duration_listener(listen)
    assert not compiled
    for number, matrix in enumerate(matrices):
        for one, other, alone in zip(first, again, quantities(matrix), strict=True):
            np.testing.assert_array_equal(one[number], other[-1 - number])
            np.testing.assert_allclose(one[number], alone, rtol=1e-12)
