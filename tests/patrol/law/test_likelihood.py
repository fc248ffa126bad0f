import itertools
import math

import numpy as np
import pytest

from jaxcell.patrol.law.distribution import Gld
from jaxcell.patrol.law.likelihood import Likelihood, law_through


POINT = np.array([3.0, 9.0])
SHAPES = [*itertools.product([-0.9, -1e-9, 0.0, 0.3, 2.5], repeat=2), (50.0, -3.0)]
NUMBERS = np.array([[-1.1, 1.2, *shapes] for shapes in SHAPES])
U = np.linspace(0.003, 0.997, 40)
COUNT = np.arange(40) % 7 + 1


@pytest.mark.parametrize("numbers", NUMBERS, ids=lambda numbers: str(numbers[2:]))
def test_a_law_has_the_given_log_odds_at_its_points(numbers):
    law = law_through(numbers, POINT)
    np.testing.assert_allclose(law.quantile(1 / (1 + np.exp(-numbers[:2]))), POINT, rtol=1e-12)


@pytest.mark.parametrize("censored", [False, True])
@pytest.mark.parametrize("numbers", NUMBERS[:-1], ids=lambda numbers: str(numbers[2:]))
def test_expansion_is_that_of_the_loss_by_its_definition(numbers, censored):
    law = law_through(numbers, POINT)
    value = law.quantile(U)
    if censored:
        # The support ends within some intervals.
        value = np.round(value)

    def loss(numbers):
        law = Gld(*np.concatenate(list(vars(law_through(numbers, POINT)).values())).tolist())
        each = np.log(law.cdf(value + 0.5) - law.cdf(value - 0.5) if censored else law.pdf(value))
        return -each @ COUNT / COUNT.sum()

    data = Likelihood.of(value, COUNT, censored)
    at, slope, hessian = data.expansion(numbers, POINT)
    assert at == pytest.approx(loss(numbers), rel=1e-12)
    step = 1e-4
    for k, axis in enumerate(step * np.eye(4)):
        up, down = numbers + axis, numbers - axis
        assert slope[k] == pytest.approx((loss(up) - loss(down)) / (2 * step), rel=1e-4, abs=1e-6)
        by_slopes = (data.expansion(up, POINT)[1] - data.expansion(down, POINT)[1]) / (2 * step)
        np.testing.assert_allclose(hessian[k], by_slopes, rtol=1e-3, atol=1e-5)


def test_a_sample_beyond_the_support_has_no_chance():
    numbers = np.array([-2.0, 2.0, 1.0, 0.5])
    low, high = law_through(numbers, POINT).support
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
