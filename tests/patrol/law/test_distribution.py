import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats
from hypothesis import example, given, strategies as st

from jaxcell.patrol.law.distribution import Gld


SHAPES = st.one_of(
    st.sampled_from([0.0, 1e-9, -1e-9, 1e-300, 1.0, 2.0]), st.floats(-3, 6), st.floats(-0.3, 0.3)
)
# Both tails, down to where 1 - u is not told from 1, and the middle.
U = np.concatenate([np.geomspace(1e-12, 0.5, 40), 1 - np.geomspace(1e-12, 0.5, 40)])
# All functions are compiled for as many values as U has.
X = np.linspace(-30, 30, 80)


def power(u, shape):
    """The transform (u**shape - 1) / shape, with as many terms near 0 as make it exact."""
    t = shape * np.log(u)
    near = sum(t**k / math.factorial(k + 1) for k in range(4))
    return np.log(u) * np.where(np.abs(t) < 1e-4, near, np.expm1(t) / np.where(t == 0, 1, t))


cdf_slope = jax.jit(jax.vmap(jax.grad(lambda law, x: law.cdf(x), argnums=1), (None, 0)))
quantile_slope = jax.jit(jax.vmap(jax.grad(lambda law, u: law.quantile(u), argnums=1), (None, 0)))


@jax.jit
def values(parameters, x):
    law = Gld(*parameters)
    return jnp.concatenate([law.cdf(x), law.log_pdf(x), law.log_probability(x[:-1], x[1:])])


values_slope = jax.jit(jax.jacfwd(values))


def laws():
    return st.builds(Gld, st.floats(-5, 5), st.floats(0.1, 10), SHAPES, SHAPES)


@given(law=laws())
def test_quantile_is_its_definition(law):
    u = U[U < 0.9]
    expected = law.l1 + (power(u, law.l3) - power(1 - u, law.l4)) / law.l2
    found = np.asarray(law.quantile(U))[U < 0.9]
    np.testing.assert_allclose(found, expected, rtol=1e-11, atol=1e-11)


@given(law=laws())
@example(law=Gld(0.0, 1.0, 1e-9, -1e-9))
@example(law=Gld(0.0, 1.0, 50.0, -2.0))
def test_cdf_inverts_the_quantile_function(law):
    x = np.asarray(law.quantile(U))
    # A rounding of x moves u by the density.
    rounding = 4e-16 * (np.abs(x) + abs(law.l1)) * np.asarray(law.pdf(x))
    u = np.asarray(law.cdf(x))
    assert np.all(np.abs(u - U) <= 1e-12 + 4 * rounding)
    again = np.asarray(law.quantile(u))
    np.testing.assert_allclose(again[10:40], x[10:40], rtol=1e-9, atol=1e-9)


@given(shape=st.floats(-3, -0.01), other=SHAPES)
def test_both_tails_keep_their_digits(shape, other):
    u = np.geomspace(1e-90, 0.1, 80)
    odds = np.log(u) - np.log1p(-u)
    lower, upper = Gld(0.0, 1.0, shape, other), Gld(0.0, 1.0, other, shape)
    x = np.asarray(lower.quantile(u))
    np.testing.assert_allclose(lower.log_odds(x), odds, rtol=1e-12)
    np.testing.assert_allclose(upper.log_odds(-x), -odds, rtol=1e-12)


@given(law=laws())
def test_density_is_the_derivative_and_sums_up(law):
    u = np.linspace(0.01, 0.99, 80)
    x = law.quantile(u)
    density = np.asarray(law.pdf(x))
    np.testing.assert_allclose(density, cdf_slope(law, x), rtol=1e-9)
    # Substituting u, the integral of the density is that of pdf(Q(u)) Q'(u), all of which are 1.
    np.testing.assert_allclose(density * np.asarray(quantile_slope(law, u)), 1, rtol=1e-9)


@pytest.mark.parametrize("shapes", [(1.5, 0.3), (0.5, 0.5), (3.0, 0.2), (2.5, 1.5)])
def test_density_integrates_to_1(shapes):
    law = Gld(1.0, 0.5, *shapes)
    low, high = map(float, law.support)
    # The midpoint rule in an angle, as the density may end steeply.
    angle = (np.arange(20000) + 0.5) * np.pi / 20000
    x = (low + high) / 2 - (high - low) / 2 * np.cos(angle)
    total = np.sum(np.asarray(law.pdf(x)) * (high - low) / 2 * np.sin(angle)) * np.pi / 20000
    assert total == pytest.approx(1, abs=1e-5)


@given(law=laws(), ends=st.tuples(st.floats(-20, 20), st.floats(0, 10)))
def test_probability_of_an_interval(law, ends):
    low, high = ends[0], ends[0] + ends[1]
    expected = float(law.cdf(high)) - float(law.cdf(low))
    found = math.exp(float(law.log_probability(low, high)))
    assert found == pytest.approx(expected, abs=1e-14)


def test_probability_far_out_does_not_cancel():
    law = Gld(0.0, 1.0, 0.0, 0.0)
    for low in (-600.0, 598.0):
        found = float(law.log_probability(low, low + 2))
        expected = -598 + math.log(-math.expm1(-2))
        assert found == pytest.approx(expected, rel=1e-14)


@pytest.mark.parametrize(
    ("law", "peer"),
    [
        (Gld(2, 0.5, 1, 1), scipy.stats.uniform(0, 4)),
        (Gld(2.0, 0.5, 2.0, 2.0), scipy.stats.uniform(1, 2)),
        (Gld(2.0, 0.5, 0.0, 0.0), scipy.stats.logistic(2, 2)),
        (Gld(2.0, 0.5, 1e-15, -1e-15), scipy.stats.logistic(2, 2)),
        # With l3 to infinity one tail is left, that of a generalized Pareto distribution.
        (Gld(2.0, 0.5, 1e15, 0.0), scipy.stats.expon(2, 2)),
        (Gld(2.0, 0.5, 1e15, -0.5), scipy.stats.genpareto(0.5, 2, 2)),
    ],
)
def test_special_cases(law, peer):
    found = np.asarray(law.quantile(U))[:60]
    np.testing.assert_allclose(found, peer.ppf(U[:60]), rtol=1e-11, atol=1e-14)
    np.testing.assert_allclose(law.cdf(X), peer.cdf(X), rtol=1e-11, atol=2e-15)
    # Ours has no density at the ends of the support.
    low, high = map(float, law.support)
    inside, density = (low < X) & (high > X), np.asarray(law.pdf(X))
    np.testing.assert_allclose(density[inside], peer.pdf(X[inside]), rtol=1e-10)
    assert not density[~inside].any()


def test_ends_of_the_support():
    law = Gld(1.0, 2.0, 0.5, -0.5)
    assert law.support == (0.0, math.inf)
    assert law.quantile(0.0) == 0.0
    assert law.quantile(1.0) == math.inf
    ends = np.repeat([-math.inf, -1.0, 0.0, math.inf], 20)
    np.testing.assert_array_equal(law.cdf(ends), np.repeat([0, 0, 0, 1], 20))
    np.testing.assert_array_equal(law.pdf(ends), 0)
    np.testing.assert_array_equal(law.log_odds(ends), np.where(ends > 0, math.inf, -math.inf))
    assert float(law.log_probability(-2.0, -1.0)) == -math.inf
    assert float(law.log_probability(-1.0, math.inf)) == pytest.approx(0, abs=1e-290)
    assert np.isnan(law.quantile(np.resize([-0.1, 1.1, np.nan], 80))).all()
    for function in (law.cdf, law.pdf, law.log_odds):
        assert np.isnan(function(np.full(80, math.nan))).all()


@given(l3=SHAPES, l4=SHAPES)
def test_derivatives_in_the_parameters(l3, l4):
    law = Gld(0.3, 1.7, l3, l4)
    x = law.quantile(np.array([0.02, 0.3, 0.8]))

    parameters = np.array([0.3, 1.7, l3, l4])
    exact = np.asarray(values_slope(parameters, x))
    step = 1e-5
    for k, change in enumerate(step * np.eye(4)):
        before, after = (np.asarray(values(parameters + sign * change, x)) for sign in (-1, 1))
        np.testing.assert_allclose(exact[:, k], (after - before) / (2 * step), rtol=1e-5, atol=1e-6)


def test_derivatives_outside_of_the_support_are_0():
    x = np.array([-6.0, -5.0, 1.0])
    slope = np.asarray(values_slope(np.array([0.0, 1.0, 1.5, -0.5]), x))
    cdf, log_density, probability = np.split(slope, [3, 6])
    assert (cdf[:2] == 0).all()
    assert (log_density[:2] == 0).all()
    assert (cdf[2] != 0).all()
    # Of an interval that the support begins within.
    assert np.isfinite(probability[1]).all()


def test_vmap_over_laws():
    shapes = np.array([-0.5, 0.0, 1.0, 4.0])
    found = jax.jit(jax.vmap(lambda l3, l4: Gld(0.0, 1.0, l3, l4).cdf(X)))(shapes, shapes[::-1])
    for k, row in enumerate(np.asarray(found)):
        one = Gld(0.0, 1.0, float(shapes[k]), float(shapes[3 - k]))
        np.testing.assert_allclose(row, one.cdf(X), rtol=1e-12)


def test_parameters_are_checked():
    for parameters, match in (
        ((0.0, -1.0, 0.0, 0.0), "l2: expected a positive number, got -1.0"),
        ((0.0, 0, 0.0, 0.0), "l2: expected a positive number, got 0.0"),
        ((0.0, 1.0, math.nan, 0.0), "l3: expected a finite number, got nan"),
    ):
        with pytest.raises(ValueError, match=match):
            Gld(*parameters)
    with jax.enable_x64(False), pytest.raises(RuntimeError, match="32 bits"):
        Gld(0.0, 1.0, 0.0, 0.0).cdf(1.0)
