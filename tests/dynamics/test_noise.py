"""Chains with noise that depends on the state or is not normal, compared with exact kernels."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.scipy.special import betainc
from jax.scipy.stats import poisson
from scipy import stats

from jaxcell import dynamics, markov
from jaxcell.space import Box


def deviation(x, p):
    return p["noise"] * jnp.sqrt(jnp.abs(x) + 0.1)


def test_noise_that_depends_on_the_state_is_that_of_the_exact_kernel():
    nodes, weights = np.polynomial.legendre.leggauss(300)
    low, high = -0.8, 1.1
    nodes, weights = low + (nodes + 1) * (high - low) / 2, weights * (high - low) / 2
    spread = 0.4 * np.sqrt(np.abs(nodes) + 0.1)
    kernel = stats.norm.pdf(nodes, 0.6 * nodes[:, None], spread[:, None]) * weights
    times = np.linalg.solve(np.eye(300) - kernel, np.ones(300))
    found = dynamics.escape(
        lambda x, p: 0.6 * x,
        Box([low], [high], [120]),
        {"noise": 0.4},
        noise=deviation,
        start=[0.2],
    )
    known = np.interp(0.2, nodes, times)
    assert abs(found.mean_time - known) < found.mean_time_error < 0.02 * known


def test_traced_chain_with_a_function_of_the_state_equals_the_other_one():
    box = Box([-1, -1], [1, 1], [8, 6], ("clamp", "sink"))

    def noise(x, p):
        return p["noise"] * (1 + x**2)

    def rows(value):
        return dynamics.chain(lambda x, p: 0.5 * x, box, {"noise": value}, noise=noise)

    with jax.enable_x64(True):
        traced = jax.jit(lambda value: rows(value).probability)(jnp.asarray(0.3))
    # Beyond the cut of the noise there is less than 1e-15.
    np.testing.assert_allclose(traced.T, rows(0.3).to_scipy().toarray(), atol=1e-14)


def test_births_by_the_law_of_poisson_have_the_exact_matrix():
    heads = 30

    def growth(x, p):
        return jnp.round(x) * p["rate"]

    def law(z, y, p):
        return poisson.cdf(jnp.floor(z), y)

    box = Box([-0.5], [heads + 0.5], [heads + 1], "clamp")
    chain = dynamics.chain(growth, box, {"rate": 0.9}, noise=law)
    number = np.arange(heads + 1)
    exact = stats.poisson.pmf(number, 0.9 * number[:, None])
    exact[:, -1] = stats.poisson.sf(heads - 1, 0.9 * number)
    np.testing.assert_allclose(chain.to_scipy().toarray(), exact, atol=1e-13)
    times = np.linalg.solve(np.eye(heads) - exact[1:, 1:], np.ones(heads))
    found = dynamics.escape(growth, box, {"rate": 0.9}, noise=law, start=[5], into=[0])
    assert found.mean_time == pytest.approx(times[4], rel=1e-9)


def test_survival_by_the_binomial_law_has_the_exact_matrix():
    """Each of 12 animals lives on with probability 0.8 per month."""

    def law(z, y, p):
        count, at = y, jnp.floor(z)
        inside = betainc(jnp.maximum(count - at, 0.5), jnp.maximum(at + 1, 0.5), 1 - p["lives"])
        return jnp.where(at < 0, 0.0, jnp.where(at >= count, 1.0, inside))

    box = Box([-0.5], [12.5], [13], "clamp")
    chain = dynamics.chain(lambda x, p: jnp.round(x), box, {"lives": 0.8}, noise=law)
    number = np.arange(13)
    exact = stats.binom.pmf(number, number[:, None], 0.8)
    np.testing.assert_allclose(chain.to_scipy().toarray(), exact, atol=1e-13)
    times = markov.hitting_times(chain, 0).value
    # The mean of the largest of 12 lives: a sum over the months of the chance that one is left.
    longest = sum(1 - (1 - 0.8**month) ** 12 for month in range(400))
    assert times[12] == pytest.approx(longest, rel=1e-9)


@pytest.mark.parametrize(
    ("noise", "axes", "message"),
    [
        (lambda x, p: -x, "clamp", "noise: expected finite numbers from 0"),
        (lambda z, y, p: z, "periodic", "noise: a distribution function needs"),
    ],
)
def test_wrong_functions_are_refused(noise, axes, message):
    with pytest.raises(ValueError, match=message):
        dynamics.chain(lambda x, p: x, Box([0], [1], [10], axes), noise=noise)
