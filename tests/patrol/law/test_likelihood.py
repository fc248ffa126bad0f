import itertools
import math

import numpy as np
import pytest

from jaxcell.patrol.law.distribution import Gld
from jaxcell.patrol.law.likelihood import (
    Likelihood,
    distribution_function,
    law_through,
    log_odds,
)


POINT = np.array([3.0, 9.0])
SHAPES = [*itertools.product([-0.9, -1e-9, 0.0, 0.3, 2.5], repeat=2), (50.0, -3.0)]
NUMBERS = np.array([[-1.1, 1.2, *shapes] for shapes in SHAPES])
STEP = 1e-5 * np.eye(4)
U = np.linspace(0.003, 0.997, 40)
COUNT = np.arange(40) % 7 + 1


def logit(u):
    return np.log(u) - np.log1p(-u)


@pytest.mark.parametrize("numbers", NUMBERS, ids=lambda numbers: str(numbers[2:]))
def test_log_odds_invert_the_quantile_function(numbers):
    law = law_through(numbers, POINT)
    np.testing.assert_allclose(law.quantile(1 / (1 + np.exp(-numbers[:2]))), POINT, rtol=1e-12)
    found = log_odds(numbers, POINT, np.asarray(law.quantile(U)))
    np.testing.assert_allclose(found, logit(U), rtol=1e-9, atol=1e-12)
    x = np.append(np.linspace(-50, 60, 98), [-math.inf, math.inf])
    np.testing.assert_allclose(distribution_function(law, x), law.cdf(x), rtol=1e-9, atol=1e-290)
    for end, limit in zip(law.support, (-690, 690), strict=True):
        if np.isfinite(end):
            (beyond,) = log_odds(
                numbers, POINT, np.array([float(end) + math.copysign(1e-6, limit)])
            )
            assert beyond == limit


@pytest.mark.parametrize(("shape", "other"), [(-0.01, 0.3), (-0.9, 2.5), (-3.0, 50.0), (0.0, -0.5)])
def test_both_tails_keep_their_digits(shape, other):
    u = np.geomspace(1e-90, 0.1, 50)
    numbers = np.array([-1.1, 1.2, shape, other])
    x = np.asarray(law_through(numbers, POINT).quantile(u))
    np.testing.assert_allclose(log_odds(numbers, POINT, x), logit(u), rtol=1e-12)
    turned = np.array([-1.2, 1.1, other, shape])
    np.testing.assert_allclose(log_odds(turned, -POINT[::-1], -x), -logit(u), rtol=1e-12)


def test_many_laws_at_once_are_as_one_by_one():
    x = np.linspace(-20, 30, 50)
    data = Likelihood.of(x, np.ones(50, int), True)
    points = POINT + np.arange(len(NUMBERS))[:, None] / 10
    odds, losses = log_odds(NUMBERS, points, x), data.loss(NUMBERS, points)
    for numbers, point, row, loss in zip(NUMBERS, points, odds, losses, strict=True):
        np.testing.assert_array_equal(row, log_odds(numbers, point, x))
        assert loss == pytest.approx(float(data.loss(numbers, point)), rel=1e-12)


@pytest.mark.parametrize("censored", [False, True])
@pytest.mark.parametrize("numbers", NUMBERS[:-1], ids=lambda numbers: str(numbers[2:]))
def test_expansion_is_that_of_the_loss(numbers, censored):
    law = law_through(numbers, POINT)
    value = np.asarray(law.quantile(U))
    if censored:
        # The support ends within some intervals.
        value = np.round(value)
    data = Likelihood.of(value, COUNT, censored)
    loss, slope, hessian = data.expansion(numbers, POINT)
    if censored:
        each = np.log(np.asarray(law.cdf(value + 0.5)) - np.asarray(law.cdf(value - 0.5)))
    else:
        each = np.log(np.asarray(law.pdf(value)))
    assert loss == data.loss(numbers, POINT) == pytest.approx(-each @ COUNT / COUNT.sum())
    around = [data.expansion(numbers + sign * change, POINT) for change in STEP for sign in (1, -1)]
    losses, slopes = (np.array([one[k] for one in around]) for k in (0, 1))
    np.testing.assert_allclose(slope, (losses[::2] - losses[1::2]) / 2e-5, rtol=1e-6, atol=1e-8)
    by_slopes = (slopes[::2] - slopes[1::2]) / 2e-5
    np.testing.assert_allclose(hessian, by_slopes, rtol=1e-5, atol=1e-6)
    assert np.abs(hessian).min() > 0


def test_samples_that_have_no_chance():
    numbers = np.array([-2.0, 2.0, 1.0, 0.5])
    low, high = (float(end) for end in law_through(numbers, POINT).support)
    inside = np.linspace(low + 0.6, high - 0.6, 5)
    for value, censored, possible in (
        (np.append(inside, high + 0.01), False, False),
        (np.append(inside, high + 0.01), True, True),
        (np.append(inside, high + 0.51), True, False),
        (np.append(low - 0.51, inside), True, False),
    ):
        data = Likelihood.of(value, np.ones(6, int), censored)
        assert math.isfinite(data.loss(numbers, POINT)) == possible
        _, slope, hessian = data.expansion(numbers, POINT)
        assert np.isfinite(slope).all() == np.isfinite(hessian).all() == possible
        if possible:
            around = [
                data.loss(numbers + sign * change, POINT) for change in STEP for sign in (1, -1)
            ]
            by_loss = (np.array(around[::2]) - around[1::2]) / 2e-5
            np.testing.assert_allclose(slope, by_loss, rtol=1e-6, atol=1e-8)


def test_a_law_that_is_not_better_is_not_differentiated():
    data = Likelihood.of(np.arange(10.0), np.ones(10, int), True)
    loss, slope, _ = data.expansion(NUMBERS[0], POINT)
    again, none, _ = data.expansion(NUMBERS[0], POINT, loss)
    assert again == loss
    assert np.isfinite(slope).all()
    assert np.isnan(none).all()


def test_a_law_goes_through_its_points():
    law = law_through(np.array([-math.log(3), math.log(3), 0.0, 0.0]), np.array([-1.0, 3.0]))
    assert (law.l3, law.l4) == (0, 0)
    # The logistic distribution with these quartiles.
    assert law.l1 == pytest.approx(1)
    assert law.l2 == pytest.approx(math.log(3) / 2)
    assert isinstance(law, Gld)
