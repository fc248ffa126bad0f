import functools
import math

import numpy as np
import pytest
import scipy.optimize
import scipy.stats
from scipy.special import expit

from jaxcell.base.certificate import Outcome
from jaxcell.patrol.law.distribution import Gld
from jaxcell.patrol.law.fit import fit_gld


SAMPLES = 5000
# With 99 %, their distribution function is as near to that of their law.
NEAR = 1.63 / math.sqrt(SAMPLES)
SKEWED = Gld(0.5, 0.1, 0.1, 0.4)
LAWS = [
    SKEWED,
    Gld(0.0, 1.0, -0.3, 0.4),
    Gld(2.0, 1.0, 1.5, 1.2),
    Gld(0.0, 1.0, 3.0, 3.0),
    Gld(-4.0, 0.02, -0.5, -0.5),
    Gld(0.0, 0.05, 5.0, 0.0),
]


def draw(law, size=SAMPLES, seed=0):
    return law.quantile(np.random.default_rng(seed).random(size))


def power(u, shape):
    return (u**shape - 1) / shape if shape else np.log(u)


@np.errstate(divide="ignore", over="ignore")
def log_odds(numbers, x):
    """The log-odds of the distribution function at `x`, by halving an interval of log-odds."""
    l1, l2, l3, l4 = numbers
    low, high = np.full(x.size, -700.0), np.full(x.size, 700.0)
    for _ in range(70):
        y = (low + high) / 2
        below = l1 + (power(expit(y), l3) - power(expit(-y), l4)) / l2 < x
        low, high = np.where(below, y, low), np.where(below, high, y)
    return low


def likelihood(numbers, samples, censored):
    """The log-likelihood of a law of four parameters: from densities, or from probabilities."""
    _, l2, l3, l4 = numbers
    if censored:
        low, high = (log_odds(numbers, samples + end) for end in (-0.5, 0.5))
        # The difference of two distribution functions, without cancellation in the tails.
        chance = np.where(low > 0, expit(-low) - expit(-high), expit(high) - expit(low))
        return float(np.log(chance).sum())
    y = log_odds(numbers, samples)
    return float(-np.log((expit(y) ** (l3 - 1) + expit(-y) ** (l4 - 1)) / l2).sum())


def numbers_of(law):
    return law.l1, law.l2, law.l3, law.l4


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    "law",
    [
        scipy.stats.norm(3, 2),
        scipy.stats.expon(scale=5),
        scipy.stats.uniform(-1, 3),
        scipy.stats.logistic(1e6, 1),
        scipy.stats.gamma(2),
        scipy.stats.t(2),
        scipy.stats.geom(0.02),
        scipy.stats.geom(0.4),
        scipy.stats.nbinom(3, 0.1),
        scipy.stats.poisson(900),
    ],
    ids=lambda law: f"{law.dist.name} {law.args}",
)
def test_recovers_known_laws(law):
    samples = law.rvs(SAMPLES, random_state=0)
    fit = fit_gld(samples)
    whole = hasattr(law.dist, "pmf")
    assert fit.censored == whole
    x = np.union1d(np.linspace(samples.min(), samples.max(), 2000), samples)
    if whole:
        x = np.arange(samples.min() - 1, samples.max() + 1)
    assert np.abs(fit.cdf(x + 0.5 * whole) - law.cdf(x)).max() < NEAR


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("law", LAWS, ids=str)
@pytest.mark.parametrize("censored", [False, True])
def test_at_least_as_likely_as_the_law_of_the_samples(law, censored):
    samples = draw(law, 500 if censored else SAMPLES)
    if censored:
        samples = np.round(samples * 10 * law.l2)
        law = Gld(law.l1 * 10 * law.l2, 0.1, law.l3, law.l4)
    fit = fit_gld(samples)
    assert fit.censored == censored
    assert fit.certificate.outcome is Outcome.CONVERGED
    assert fit.log_likelihood == pytest.approx(
        likelihood(numbers_of(fit.law), samples, censored), rel=1e-9
    )
    assert fit.log_likelihood > likelihood(numbers_of(law), samples, censored) - 0.01


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("censored", [False, True])
def test_at_least_as_likely_as_by_nelder_and_mead(censored):
    samples = scipy.stats.lognorm(0.7, scale=20).rvs(200, random_state=0)
    samples = np.round(samples) if censored else samples
    fit = fit_gld(samples, censored=censored)

    def loss(parameters):
        if parameters[1] <= 0:
            return np.inf
        l1, l2, l3, l4 = parameters.tolist()
        low = l1 - 1 / (l2 * l3) if l3 > 0 else -np.inf
        high = l1 + 1 / (l2 * l4) if l4 > 0 else np.inf
        outside = samples.min() + 0.5 * censored <= low or samples.max() - 0.5 * censored >= high
        return np.inf if outside else -likelihood(parameters.tolist(), samples, censored)

    # The start of the package gld of R: location and scale by the quartiles, for a grid of shapes.
    starts = []
    quartiles = np.quantile(samples, [0.25, 0.5, 0.75])
    for l3 in (-0.5, -0.1, 0.0, 0.2, 0.8, 1.5):
        for l4 in (-0.5, -0.1, 0.0, 0.2, 0.8):
            standard = Gld(0.0, 1.0, l3, l4).quantile([0.25, 0.5, 0.75])
            l2 = (standard[2] - standard[0]) / (quartiles[2] - quartiles[0])
            starts.append(np.array([quartiles[1] - standard[1] / l2, l2, l3, l4]))
    start = min(starts, key=loss)
    # Nothing is better nearby either.
    for point in (start, np.array(numbers_of(fit.law))):
        peer = scipy.optimize.minimize(loss, point, method="Nelder-Mead", options={"maxiter": 300})
        assert fit.log_likelihood > -peer.fun - 0.02


@pytest.mark.parametrize(("size", "seed"), [(5000, 9), (20_000, 3)])
def test_fit_of_whole_uniform_numbers_is_as_likely_as_by_nelder_and_mead(size, seed):
    samples = scipy.stats.randint(3, 40).rvs(size, random_state=seed)
    count = np.bincount(samples)[3:]

    def loss(numbers):
        if min(numbers[1:]) <= 0:
            return np.inf
        chance = np.diff(expit(log_odds(numbers, np.arange(2.5, 40))))
        return -count @ np.log(np.maximum(chance, 1e-300))

    uniform = np.array([21.0, 2 / 37.5, 1.0, 1.0])
    peer = scipy.optimize.minimize(loss, uniform, method="Nelder-Mead", options={"maxfev": 2000})
    assert fit_gld(samples).log_likelihood > -peer.fun - 0.02


def test_fit_of_many_uniform_numbers_is_not_worse_than_another_law():
    samples = scipy.stats.uniform(-1, 3).rvs(20_000, random_state=0)
    # The law with these shapes whose support are the samples, widened a little.
    l3, l4 = 1.06119, 1.02221
    low, high = samples.min() - 1e-5, samples.max() + 1e-5
    l2 = (1 / l3 + 1 / l4) / (high - low)
    other = likelihood((low + 1 / (l2 * l3), l2, l3, l4), samples, False)
    assert fit_gld(samples).log_likelihood > other - 0.1


def test_distance_is_that_of_kolmogorov_and_smirnov():
    samples = draw(SKEWED, 400)
    fit = fit_gld(samples)
    peer = scipy.stats.kstest(samples, fit.law.cdf)
    assert fit.distance == pytest.approx(peer.statistic, abs=1e-12)
    samples = np.round(samples)
    fit = fit_gld(samples)
    t = np.arange(samples.min() - 3, samples.max() + 4)
    share = (samples[:, None] <= t).mean(axis=0)
    assert fit.distance == pytest.approx(np.abs(fit.law.cdf(t + 0.5) - share).max(), abs=1e-12)


def test_moved_scaled_and_turned_samples():
    samples = draw(SKEWED, 500)
    fit = fit_gld(samples)
    other = fit_gld(1000 - samples / 8)
    assert other.log_likelihood == pytest.approx(fit.log_likelihood + 500 * math.log(8), abs=1e-2)
    np.testing.assert_allclose(1 - other.cdf(1000 - samples / 8), fit.cdf(samples), atol=1e-3)


def test_few_samples_and_great_atoms():
    assert fit_gld(np.random.default_rng(0).normal(size=8)).distance < 0.5
    assert fit_gld([1, 2, 3, 4, 5, 5, 5, 5]).censored
    # Both quartiles are the same number, where R's start divides by 0.
    samples = np.concatenate([np.full(4000, 7), np.random.default_rng(0).geometric(0.1, 1000)])
    assert fit_gld(samples).distance < 0.05


def test_whole_samples_with_equal_ones_are_censored():
    fit = functools.partial(fit_gld, steps=1, throw=False)
    whole = np.arange(40) ** 2
    assert not fit(whole).censored
    assert fit(whole, censored=True).censored
    assert fit(np.repeat(whole, 2)).censored
    assert not fit(np.repeat(whole, 2) + 0.25).censored


@pytest.mark.parametrize(
    ("samples", "match"),
    [
        ([1.5, 2.5, math.nan, 3.5], r"samples\[2\] is nan; expected a finite number"),
        (np.ones((3, 3)), r"samples: expected a list of numbers, got an array \[3, 3\]"),
        (["a"], "samples: expected an array of numbers"),
        (np.ones(100), "with 5 different values, got 100 with 1"),
        ([1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0], "at least 8, .* got 7 with 7"),
        ([], "at least 8, .* got 0 with 0"),
    ],
)
def test_wrong_samples_are_refused(samples, match):
    with pytest.raises(ValueError, match=match):
        fit_gld(samples)


def test_censored_fractions_are_refused():
    with pytest.raises(ValueError, match=r"samples\[3\] is 0.5; expected a whole number"):
        fit_gld([1, 2, 3, 0.5, 4, 5, 6, 7, 8], censored=True)


def test_a_search_that_does_not_settle_raises():
    samples = draw(LAWS[1], 500)
    with pytest.raises(RuntimeError, match="fit_gld: the residual stayed above the tolerance"):
        fit_gld(samples, steps=1)
    assert fit_gld(samples, steps=1, throw=False).certificate.outcome is Outcome.STALLED
