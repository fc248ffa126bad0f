import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
import scipy.stats
from hypothesis import example, given, strategies as st

from jaxcell.patrol.law.distribution import Gld, log_probability


SHAPES = st.one_of(
    st.sampled_from([0.0, 1e-9, -1e-9, 1e-300, 1.0, 2.0]), st.floats(-3, 6), st.floats(-0.3, 0.3)
)
# Both tails, as far as 1 - u differs from 1, and the middle.
U = np.concatenate([np.geomspace(1e-12, 0.5, 40), 1 - np.geomspace(1e-12, 0.5, 40)])
X = np.linspace(-30, 30, 80)


def power(u, shape):
    """The transform (u**shape - 1) / shape, with as many terms near 0 as make it exact."""
    t = shape * np.log(u)
    near = sum(t**k / math.factorial(k + 1) for k in range(4))
    return np.log(u) * np.where(np.abs(t) < 1e-4, near, np.expm1(t) / np.where(t == 0, 1, t))


def laws():
    return st.builds(Gld, st.floats(-5, 5), st.floats(0.1, 10), SHAPES, SHAPES)


@given(law=laws())
def test_quantile_is_its_definition(law):
    u = U[U < 0.9]
    expected = law.l1 + (power(u, law.l3) - power(1 - u, law.l4)) / law.l2
    np.testing.assert_allclose(law.quantile(u), expected, rtol=1e-11, atol=1e-11)


@given(law=laws())
@example(law=Gld(0.0, 1.0, 1e-9, -1e-9))
@example(law=Gld(0.0, 1.0, 50.0, -2.0))
def test_cdf_inverts_the_quantile_function(law):
    x = law.quantile(U)
    # A rounding of x moves u by the density.
    rounding = 4e-16 * (np.abs(x) + abs(law.l1)) * law.pdf(x)
    u = law.cdf(x)
    assert np.all(np.abs(u - U) <= 1e-12 + 4 * rounding)
    np.testing.assert_allclose(law.quantile(u)[10:40], x[10:40], rtol=1e-9, atol=1e-9)


@given(shape=st.floats(-3, -0.01), other=SHAPES)
def test_both_tails_keep_their_digits(shape, other):
    u = np.geomspace(1e-90, 0.1, 80)
    odds = np.log(u) - np.log1p(-u)
    lower, upper = Gld(0.0, 1.0, shape, other), Gld(0.0, 1.0, other, shape)
    x = lower.quantile(u)
    np.testing.assert_allclose(lower.log_odds(x), odds, rtol=1e-12)
    np.testing.assert_allclose(upper.log_odds(-x), -odds, rtol=1e-12)


@given(law=laws())
def test_density_is_the_derivative_of_the_distribution_function(law):
    u = np.linspace(0.01, 0.99, 80)
    x = law.quantile(u)
    # Substituting u, the integral of the density is that of pdf(Q(u)) Q'(u), all of which are 1.
    slope = (u ** (law.l3 - 1) + (1 - u) ** (law.l4 - 1)) / law.l2
    np.testing.assert_allclose(law.pdf(x) * slope, 1, rtol=1e-9)


@given(law=laws(), ends=st.tuples(st.floats(-20, 20), st.floats(0, 10)))
def test_probability_of_an_interval(law, ends):
    low, high = ends[0], ends[0] + ends[1]
    expected = float(law.cdf(high) - law.cdf(low))
    probability = np.exp(log_probability(law.log_odds(low), law.log_odds(high)))
    assert probability == pytest.approx(expected, abs=1e-14)


def test_probability_far_out_does_not_cancel():
    law = Gld(0.0, 1.0, 0.0, 0.0)
    for low in (-600.0, 598.0):
        logarithm = log_probability(law.log_odds(low), law.log_odds(low + 2))
        assert logarithm == pytest.approx(-598 + math.log(-math.expm1(-2)), rel=1e-14)


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
    np.testing.assert_allclose(law.quantile(U[:60]), peer.ppf(U[:60]), rtol=1e-11, atol=1e-14)
    np.testing.assert_allclose(law.cdf(X), peer.cdf(X), rtol=1e-11, atol=2e-15)
    # Ours has no density at the ends of the support.
    low, high = law.support
    inside, density = (low < X) & (high > X), law.pdf(X)
    np.testing.assert_allclose(density[inside], peer.pdf(X[inside]), rtol=1e-10)
    assert not density[~inside].any()


def test_ends_of_the_support():
    law = Gld(1.0, 2.0, 0.5, -0.5)
    assert law.support == (0.0, math.inf)
    assert law.quantile(0.0) == 0.0
    assert law.quantile(1.0) == math.inf
    ends = np.array([-math.inf, -1.0, 0.0, math.inf])
    np.testing.assert_array_equal(law.cdf(ends), [0, 0, 0, 1])
    np.testing.assert_array_equal(law.pdf(ends), 0)
    odds = law.log_odds(ends)
    np.testing.assert_array_equal(odds, np.where(ends > 0, math.inf, -math.inf))
    assert log_probability(odds[0], odds[1]) == -math.inf
    assert log_probability(odds[1], odds[3]) == 0
    assert np.isnan(law.quantile([-0.1, 1.1, math.nan])).all()
    for function in (law.cdf, law.pdf, law.log_odds):
        assert np.isnan(function(math.nan))


def test_several_laws_are_as_each_of_them():
    shapes = np.array([-0.5, 0.0, 1.0, 4.0])
    rows = Gld(0.0, 1.0, shapes[:, None], shapes[::-1, None]).cdf(X)
    for k, row in enumerate(rows):
        law = Gld(0.0, 1.0, float(shapes[k]), float(shapes[3 - k]))
        np.testing.assert_allclose(row, law.cdf(X), rtol=1e-12)
        odds = law.log_odds(X)
        near = law.log_odds(X, np.nan_to_num(odds, posinf=1.0, neginf=1.0) + 0.1)
        np.testing.assert_allclose(near, odds, rtol=1e-12)


def test_parameters_are_checked():
    for parameters, match in (
        ((0.0, -1.0, 0.0, 0.0), "l2: expected a positive number, got -1.0"),
        ((0.0, 0, 0.0, 0.0), "l2: expected a positive number, got 0.0"),
        ((0.0, 1.0, math.nan, 0.0), "l3: expected a finite number, got nan"),
    ):
        with pytest.raises(ValueError, match=match):
            Gld(*parameters)


def cdf_by_bisection(x, numbers):
    l1, l2, l3, l4 = numbers
    return scipy.optimize.brentq(
        lambda u: l1 + (power(u, l3) - power(1 - u, l4)) / l2 - x, 1e-12, 1 - 1e-12, xtol=1e-15
    )


def slope(compute, at, step=1e-4):
    """The derivative by differences of the fourth order."""
    ends = [compute(at + k * step) for k in (-2, -1, 1, 2)]
    return np.dot([1, -8, 8, -1], ends) / (12 * step)


@pytest.mark.parametrize(
    "numbers",
    [(0.0, 1.0, 0.0, 0.0), (0.3, 1.7, 0.2, 0.4), (1.0, 0.5, -0.3, 0.1), (0, 0.5, 1e-7, 1)],
)
def test_derivatives_of_a_traced_law(numbers):
    numbers = np.array(numbers, float)
    values = jnp.array([0.2, 0.7, 1.1])

    def cdf(numbers, x):
        return Gld(*numbers).cdf(x)

    changes = jax.jit(jax.vmap(jax.grad(cdf), (None, 0)))(numbers, values)
    curves = jax.vmap(jax.hessian(cdf), (None, 0))(numbers, values)
    for x, change, curve in zip(values.tolist(), changes, curves, strict=True):
        expected = cdf_by_bisection(x, numbers)
        np.testing.assert_allclose(jax.jit(cdf)(numbers, x), expected, rtol=1e-9)
        np.testing.assert_allclose(jax.grad(cdf, 1)(numbers, x), Gld(*numbers).pdf(x), rtol=1e-9)
        for axis in np.eye(4):
            by_difference = slope(lambda t, a=axis, x=x: cdf_by_bisection(x, numbers + t * a), 0.0)
            np.testing.assert_allclose(change @ axis, by_difference, rtol=1e-6, atol=1e-8)
            again = slope(lambda t, a=axis, x=x: jax.grad(cdf)(numbers + t * a, x), 0.0)
            np.testing.assert_allclose(curve @ axis, again, rtol=1e-6, atol=1e-8)


def test_a_traced_law_ends_where_the_law_does():
    law, ends = Gld(1.0, 2.0, 0.5, 0.0), jnp.array([-9.0, 0.0, 1.0, 99.0])
    np.testing.assert_allclose(jax.jit(law.cdf)(ends), [0, 0, law.cdf(1.0), law.cdf(99.0)])
    np.testing.assert_array_equal(jax.vmap(jax.grad(law.pdf))(ends)[:1], [0])
    ends = jax.jit(lambda law: law.quantile(jnp.array([0.0, 1.0, 2.0])))(law)
    np.testing.assert_array_equal(ends, [0.0, np.inf, np.nan])


@pytest.mark.parametrize("shape", [0.0, 0.4, -0.7])
def test_derivative_of_a_traced_quantile_is_its_closed_form(shape):
    u = 0.3
    expected = math.log(u) ** 2 / 2
    if shape:
        expected = (u**shape * (shape * math.log(u) - 1) + 1) / shape**2
    found = jax.grad(lambda l3: Gld(0.0, 2.0, l3, 0.1).quantile(u))(shape)
    assert found == pytest.approx(expected / 2, rel=1e-12)
