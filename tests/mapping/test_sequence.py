import jax
import jax.numpy as jnp
import networkx as nx
import numpy as np
import pytest

from jaxcell.mapping import Chain, ChainSequence, persistent_groups, transient_groups
from jaxcell.markov import (
    absorption_times,
    arrival_probabilities,
    hitting_times,
    limiting_distribution,
)


CELLS, PHASES = 12, 3


def sparse(random, leak=0.0):
    """Draw a matrix of one to three entries per row; some rows sum to `1 - leak`."""
    matrix = np.zeros((CELLS, CELLS))
    for row in matrix:
        some = random.choice(CELLS, random.integers(1, 4), replace=False)
        row[some] = random.dirichlet(np.ones(some.size)) * (1 - leak * (random.random() < 0.2))
    return matrix


@pytest.fixture(scope="module", params=[(0, 0.0), (5, 0.0), (7, 0.5)], ids=str)
def tide(request):
    """Matrices, and the sequence of their chains."""
    seed, leak = request.param
    random = np.random.default_rng(seed)
    matrices = [sparse(random, leak) for _ in range(PHASES)]
    return matrices, ChainSequence.of([Chain.from_scipy(one) for one in matrices])


def product(matrices, steps=PHASES):
    matrix = np.eye(CELLS)
    for n in range(steps):
        matrix = matrix @ matrices[n % PHASES]
    return matrix


def test_push_and_pull_equal_the_product(tide):
    matrices, sequence = tide
    values = np.random.default_rng(1).random(CELLS)
    for steps in (0, 3, 5):
        whole = product(matrices, steps)
        np.testing.assert_allclose(sequence.push(values, steps), values @ whole)
        *_, last = sequence.pushed(values, steps)
        np.testing.assert_allclose(last, values @ whole)
        np.testing.assert_allclose(sequence.pull(values, steps), whole @ values)


def test_groups_equal_those_of_the_product(tide):
    matrices, sequence = tide
    whole = product(matrices)
    graph = nx.from_numpy_array(whole, create_using=nx.DiGraph)
    leaves = set(np.flatnonzero(whole.sum(axis=1) < 1 - 1e-12).tolist())
    closed = [one for one in nx.attracting_components(graph) if not leaves & one]
    groups = persistent_groups(sequence)
    group = np.asarray(groups.group)
    assert sorted(map(sorted, closed)) == [
        np.flatnonzero(group == k).tolist() for k in range(groups.count)
    ]
    assert groups.size.tolist() == np.bincount(group[group >= 0], minlength=groups.count).tolist()
    direct = persistent_groups(Chain.from_scipy(whole))
    np.testing.assert_array_equal(groups.period, direct.period)
    unrolled = sequence.unrolled
    parts = transient_groups(unrolled, persistent_groups(unrolled)).first(CELLS)
    expected = transient_groups(Chain.from_scipy(whole), direct)
    assert parts.domiciles == expected.domiciles
    np.testing.assert_array_equal(parts.group, expected.group)
    np.testing.assert_array_equal(parts.size, expected.size)


def test_group_may_span_several_periods():
    turn = np.roll(np.eye(4), 1, axis=1)
    sequence = ChainSequence.of([Chain.from_scipy(turn), Chain.from_scipy(np.eye(4))])
    groups = persistent_groups(sequence)
    assert (groups.count, groups.period.tolist()) == (1, [4])


def test_arrivals_equal_iterating_the_matrices(tide):
    matrices, sequence = tide
    there = np.zeros(CELLS, bool)
    there[[0, 5]] = True
    chance = there.astype(float)
    # Step by step backwards in time, until phase 0 acts next.
    for n in range(1500 * PHASES - 1, -1, -1):
        chance = np.where(there, 1, matrices[n % PHASES] @ chance)
    target = np.tile(there, PHASES)
    arrival = arrival_probabilities(sequence.unrolled, target).value[:CELLS]
    np.testing.assert_allclose(arrival, chance, atol=1e-9)
    time = np.asarray(hitting_times(sequence.unrolled, target).value[:CELLS])
    sure = np.asarray(arrival) == 1
    assert np.isinf(time[~sure]).all()
    # The mean time is the sum over time of the probability of no arrival yet.
    for start in np.flatnonzero(sure & ~there):
        p, total = np.eye(CELLS)[start], 0.0
        for n in range(600):
            total += p.sum()
            p = np.where(there, 0, p @ matrices[n % PHASES])
        assert time[start] == pytest.approx(total, rel=1e-8)


def test_limiting_distribution_equals_that_of_the_product(tide):
    matrices, sequence = tide
    unrolled = sequence.unrolled
    groups = persistent_groups(unrolled)
    times = np.asarray(absorption_times(unrolled, groups).value).reshape(sequence.shape)
    transient = np.asarray(groups.group).reshape(sequence.shape) < 0
    for phase, matrix in enumerate(matrices):
        after = 1 + matrix @ times[(phase + 1) % PHASES]
        np.testing.assert_allclose(times[phase][transient[phase]], after[transient[phase]])
    limit = limiting_distribution(unrolled, groups)
    value = np.asarray(limit.value).reshape(sequence.shape)
    for phase, matrix in enumerate(matrices):
        np.testing.assert_allclose(value[phase] @ matrix, value[(phase + 1) % PHASES], atol=1e-9)
    assert value.sum() + limit.leaving == pytest.approx(1)


def test_chains_of_different_cells_are_refused():
    with pytest.raises(ValueError, match=r"chains: expected one or more over the same cells, got"):
        ChainSequence.of([Chain.from_scipy(np.eye(n)) for n in (2, 3)])
    with pytest.raises(ValueError, match=r"got sizes \[\]"):
        ChainSequence.of([])


@pytest.mark.parametrize("way", ["push", "pull"])
def test_steps_in_a_program_have_the_derivatives_of_the_product(tide, way):
    matrices, sequence = tide
    random = np.random.default_rng(2)
    values, weights = random.random((2, CELLS))
    change = random.normal(size=sequence.probability.shape)

    def total(probability, values, steps=5):
        return jnp.vdot(
            weights, getattr(ChainSequence(sequence.image, probability), way)(values, steps)
        )

    def changed(h):
        """The same number from the product of dense matrices; the chains are changed by `h`."""
        image = np.eye(CELLS)[np.asarray(sequence.image)]
        other = matrices + h * (image * change[..., None]).sum(axis=1)
        whole = product(other, 5)
        return values @ whole @ weights if way == "push" else weights @ whole @ values

    slope, by_value = jax.jit(jax.grad(total, (0, 1)))(sequence.probability, jnp.asarray(values))
    np.testing.assert_allclose(
        np.vdot(slope, change), (changed(1e-6) - changed(-1e-6)) / 2e-6, rtol=1e-7
    )
    np.testing.assert_allclose(np.vdot(by_value, values), changed(0.0), rtol=1e-12)
    each = jax.vmap(lambda n: total(sequence.probability, values, n))(jnp.arange(6))
    assert each[5] == pytest.approx(changed(0.0), rel=1e-12)
