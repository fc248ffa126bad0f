import math

import numpy as np
import pytest
from hypothesis import given
from random_chains import birth_and_death, matrices, open_line, with_sink

from jaxcell.base.certificate import Outcome
from jaxcell.mapping.classes import persistent_groups
from jaxcell.mapping.generalized import Chain
from jaxcell.markov import limiting_distribution
from jaxcell.markov.solving import solve


def time_average(matrix):
    """Compute the limit of the powers of the chain that rests in half of its steps."""
    full = (with_sink(matrix) + np.eye(len(matrix) + 1)) / 2
    for _ in range(80):
        full = full @ full
        full /= full.sum(axis=1, keepdims=True)
    return full


@given(matrices())
def test_distribution_is_the_time_average_of_a_uniform_start(matrix):
    chain = Chain.from_scipy(matrix)
    groups = persistent_groups(chain)
    result = limiting_distribution(chain, groups)
    expected = time_average(matrix)[:-1].mean(axis=0)
    np.testing.assert_allclose(result.value, expected[:-1], rtol=1e-8, atol=1e-11)
    assert result.leaving == pytest.approx(expected[-1], rel=1e-8, abs=1e-11)
    group = np.asarray(groups.group)
    weights = [expected[:-1][group == g].sum() for g in range(groups.count)]
    np.testing.assert_allclose(result.weights, weights, rtol=1e-8, atol=1e-11)
    assert result.certificate.outcome is Outcome.CONVERGED
    assert result.certificate.residual < 1e-12


def test_birth_and_death_chain_has_known_values():
    # Ehrenfest's urns: binomial, of period 2.
    n = 40
    i = np.arange(n)
    chain = Chain.from_scipy(birth_and_death(1 - i / n, (i + 1) / n))
    groups = persistent_groups(chain)
    assert groups.period.tolist() == [2]
    expected = [math.comb(n, i) / 2**n for i in range(n + 1)]
    result = limiting_distribution(chain, groups)
    np.testing.assert_allclose(result.value, expected, rtol=1e-9, atol=1e-14)


TWO_ENDS = np.array(
    [[1, 0, 0, 0, 0], [0.5, 0, 0.5, 0, 0], [0, 0.5, 0, 0.5, 0], [0, 0, 0, 0, 1], [0, 0, 0, 1, 0]]
)


@pytest.mark.parametrize(
    ("weights", "expected"),
    [
        (None, [1 / 5 * (1 + 2 / 3 + 1 / 3), 1 / 5 * (2 + 1 / 3 + 2 / 3)]),
        ("basin", [2 / 5, 3 / 5]),
        ("size", [1 / 3, 2 / 3]),
        (np.array([0.25, 0.75]), [0.25, 0.75]),
    ],
)
def test_weights_of_groups(weights, expected):
    chain = Chain.from_scipy(TWO_ENDS)
    result = limiting_distribution(chain, persistent_groups(chain), weights)
    np.testing.assert_allclose(result.weights, expected, rtol=1e-14)
    left, right = expected
    np.testing.assert_allclose(result.value, [left, 0, 0, right / 2, right / 2], rtol=1e-14)


@pytest.mark.parametrize(
    ("weights", "message"),
    [
        ("mass", "expected 'basin', 'size' or an array, got 'mass'"),
        (np.array([0.5, 0.25, 0.25]), r"expected 2, one per group, got shape \(3,\)"),
        (np.array([0.5, 0.6]), r"sum to 1, got \[0.5, 0.6\]"),
        (np.array([1.5, -0.5]), r"from 0 that sum to 1, got \[1.5, -0.5\]"),
        (np.array([np.nan, 1.0]), r"got \[nan, 1.0\]"),
    ],
)
def test_bad_weights_are_refused(weights, message):
    chain = Chain.from_scipy(TWO_ENDS)
    with pytest.raises(ValueError, match=message):
        limiting_distribution(chain, persistent_groups(chain), weights)


def test_chain_without_groups_leaves_with_probability_1():
    chain = Chain.from_scipy(np.array([[0.5, 0.25], [0, 0]]))
    groups = persistent_groups(chain)
    result = limiting_distribution(chain, groups)
    assert result.value.tolist() == [0, 0]
    assert result.leaving == pytest.approx(1)
    with pytest.raises(ValueError, match="no persistent groups"):
        limiting_distribution(chain, groups, "size")


def test_stalled_solve_is_reported(monkeypatch):
    n = 400
    matrix = open_line(n)
    matrix[0, 0], matrix[-1, -1] = 0.25, 0.5
    matrix[0, 1] = 0.75
    chain = Chain.from_scipy(matrix)
    groups = persistent_groups(chain)
    result = limiting_distribution(chain, groups)
    np.testing.assert_allclose(result.value @ matrix, result.value, atol=1e-15)
    monkeypatch.setattr(solve, "LIMITS", solve.Limits(factored=10, products=50))
    stalled = limiting_distribution(chain, groups, throw=False)
    assert stalled.certificate.outcome is Outcome.STALLED
    assert stalled.certificate.residual == pytest.approx(
        np.abs(stalled.value @ matrix - stalled.value).sum()
    )
    with pytest.raises(RuntimeError, match="limiting_distribution: the residual stayed"):
        limiting_distribution(chain, groups)
