"""Chains from counts, against closed forms, a numerical maximum, and simulated walkers."""

import numpy as np
import pytest
import scipy.optimize
import scipy.sparse
import scipy.stats

from jaxcell import markov
from jaxcell.mapping import Chain


def counts(seed, cells=5, most=60):
    draw = np.random.default_rng(seed)
    table = draw.integers(1, most, (cells, cells)) * (draw.random((cells, cells)) < 0.6)
    table[np.arange(cells), (np.arange(cells) + 1) % cells] += 3
    return table


def test_shares_of_steps_are_the_most_likely_chain():
    table = counts(0)
    chain = markov.maximum_likelihood(scipy.sparse.csr_array(table))
    expected = table / table.sum(axis=1, keepdims=True)
    np.testing.assert_allclose(chain.to_scipy().toarray(), expected, rtol=1e-15)


@pytest.mark.parametrize("seed", range(4))
def test_reversible_chain_has_the_largest_likelihood(seed):
    table = counts(seed, 4)
    both = (table + table.T) > 0
    up = np.triu(both)

    def flux_of(logs):
        flux = np.zeros(table.shape)
        flux[up] = np.exp(logs)
        return np.triu(flux, 1).T + flux

    def loss(logs):
        flux = flux_of(logs)
        share = flux / flux.sum(axis=1, keepdims=True)
        return -(table[table > 0] * np.log(share[table > 0])).sum()

    best = scipy.optimize.minimize(loss, np.zeros(up.sum()), tol=1e-12)
    found = markov.maximum_likelihood(table, reversible=True)
    flux = flux_of(best.x)
    matrix = found.to_scipy().toarray()
    np.testing.assert_allclose(matrix, flux / flux.sum(axis=1, keepdims=True), atol=1e-5)
    likelihood = (table[table > 0] * np.log(matrix[table > 0])).sum()
    assert likelihood >= -best.fun - 1e-9
    share = np.asarray(markov.limiting_distribution(found).value)
    np.testing.assert_allclose(share[:, None] * matrix, (share[:, None] * matrix).T, atol=1e-13)


def test_two_cells_and_symmetric_counts_are_reversible_anyway():
    for table in (np.array([[7, 3], [1, 9]]), np.array([[5, 2, 1], [2, 0, 4], [1, 4, 3]])):
        free, bound = (markov.maximum_likelihood(table, reversible=x) for x in (False, True))
        np.testing.assert_allclose(
            bound.to_scipy().toarray(), free.to_scipy().toarray(), rtol=1e-11
        )


def test_posterior_has_the_moments_of_dirichlet_distributions():
    table, samples = counts(1), 4000
    for prior in (0, 0.5):
        spread = markov.posterior(
            table, lambda chain: chain.to_scipy().toarray(), samples, prior=prior
        )
        number = np.where(table > 0, table + prior, 0)
        total = number.sum(axis=1, keepdims=True)
        mean, error = number / total, np.sqrt(number * (total - number) / (total + 1)) / total
        np.testing.assert_allclose(spread.value, mean, rtol=1e-14)
        assert (np.abs(spread.mean - mean) <= 5 * error / np.sqrt(samples)).all()
        np.testing.assert_allclose(spread.error, error, rtol=0.1)
        assert ((spread.low <= spread.mean) & (spread.mean <= spread.high)).all()


def test_intervals_of_hitting_times_hold_in_most_experiments():
    draw = np.random.default_rng(5)
    matrix = np.array([[0.6, 0.4, 0], [0.3, 0.5, 0.2], [0.5, 0, 0.5]])
    true = np.asarray(markov.hitting_times(matrix, 2).value)[0]
    held = 0
    for number in range(40):
        table = np.array([draw.multinomial(150, row) for row in matrix])
        spread = markov.posterior(
            table, lambda chain: markov.hitting_times(chain, 2).value[0], 60, seed=number
        )
        held += spread.low <= true <= spread.high
    # Of 40 intervals of 90 %, 30 or fewer hold with probability .01.
    assert held > 30


@pytest.mark.parametrize("samples", [19, 60])
def test_intervals_have_nine_tenths_of_a_beta_distribution(samples):
    draw, mass = np.random.default_rng(7), []
    for number in range(200):
        table = draw.integers(1, 40, (2, 2))
        spread = markov.posterior(table, lambda chain: chain.to_scipy()[0, 1], samples, seed=number)
        of = scipy.stats.beta(table[0, 1], table[0, 0])
        mass.append(of.cdf(spread.high) - of.cdf(spread.low))
    # The standard deviation of the mean of 200 masses is at most .005.
    assert np.mean(mass) == pytest.approx(0.9, abs=0.015)


def test_walkers_with_a_memory_fail_the_chapman_kolmogorov_test():
    draw = np.random.default_rng(6)
    chain = Chain.from_scipy(np.array([[0.9, 0.1], [0.2, 0.8]]))
    walks = markov.sample_walks(chain, np.zeros(20_000, int), 4, draw)
    # A walker with a memory goes round in four steps, so that it is seen in pairs of equal cells.
    memory = (draw.integers(0, 4, 20_000) + np.arange(5)[:, None]) % 4 // 2
    for steps, is_markov in ((walks, True), (memory, False)):
        table = np.zeros((2, 2))
        np.add.at(table, (steps[:-1].ravel(), steps[1:].ravel()), 1)
        seen = [(n, steps[0], steps[n]) for n in (1, 2, 4)]
        test = markov.chapman_kolmogorov(markov.maximum_likelihood(table), np.array([0, 1]), seen)
        apart = np.abs(test.by_chain - test.seen)[~np.isnan(test.seen)]
        assert (apart.max() < 0.02) == is_markov
    assert test.walkers.sum(axis=1).tolist() == [20_000] * 3


def test_counts_without_a_chain_are_refused():
    with pytest.raises(ValueError, match="cell 1 has no steps"):
        markov.maximum_likelihood([[1, 2], [0, 0]])
    with pytest.raises(ValueError, match="expected numbers from 0, got -1"):
        markov.maximum_likelihood([[1, -1], [1, 1]])
    with pytest.raises(ValueError, match="as many rows as columns"):
        markov.maximum_likelihood([[1, 1, 1], [1, 1, 1]])
    with pytest.raises(ValueError, match="all reach each other"):
        markov.maximum_likelihood([[1, 1], [0, 1]], reversible=True)
    with pytest.raises(ValueError, match="samples: expected 19 or more"):
        markov.posterior([[1]], lambda chain: 0, 1)
