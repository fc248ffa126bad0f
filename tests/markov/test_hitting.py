import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, strategies as st
from random_chains import (
    dense_solution,
    matrices,
    open_line,
    reachable,
    steps_on_open_line,
)

from jaxcell.base.certificate import Outcome
from jaxcell.mapping.classes import persistent_groups
from jaxcell.mapping.generalized import Chain
from jaxcell.markov import absorption_probabilities, absorption_times, hitting_times
from jaxcell.markov.solving import solve


@given(matrices())
def test_absorption_equals_dense_solves(matrix):
    chain = Chain.from_scipy(matrix)
    groups = persistent_groups(chain)
    group = np.asarray(groups.group)
    transient = group < 0
    q = matrix[transient][:, transient]
    into = np.stack(
        [matrix[transient][:, group == g].sum(axis=1) for g in range(groups.count)]
        + [1 - matrix[transient].sum(axis=1)],
        axis=1,
    )
    result = absorption_probabilities(chain, groups)
    times = absorption_times(chain, groups)
    expected = dense_solution(q, into)
    value = np.concatenate([result.value, result.leaving[None]])
    np.testing.assert_allclose(value[:, transient], expected.T, rtol=1e-9, atol=1e-12)
    for g in range(groups.count):
        np.testing.assert_array_equal(value[:, group == g].argmax(axis=0), g)
        assert (value[g, group == g] == 1).all()
    np.testing.assert_allclose(value.sum(axis=0), 1, rtol=1e-12)
    steps = dense_solution(q, np.ones(len(q)))
    np.testing.assert_allclose(np.asarray(times.value)[transient], steps, rtol=1e-9)
    assert (np.asarray(times.value)[~transient] == 0).all()
    for certificate in (result.certificate, times.certificate):
        assert certificate.outcome is Outcome.CONVERGED


@given(matrices(), st.data())
def test_hitting_equals_the_definition(matrix, data):
    cells = len(matrix)
    target = sorted(data.draw(st.sets(st.integers(0, cells - 1), min_size=1)))
    there = np.zeros(cells, bool)
    there[target] = True
    result = hitting_times(Chain.from_scipy(matrix), target)
    assert result.certificate.outcome is Outcome.CONVERGED
    # A chain that stops in the target is certain to arrive if nothing else can absorb it.
    stopped = matrix.copy()
    stopped[there] = np.eye(cells)[there]
    reach = reachable(stopped)
    trapped = ~reach[:, there].any(axis=1) | (stopped.sum(axis=1) < 1 - 1e-9)
    finite = ~reach[:, trapped].any(axis=1)
    expected = np.where(finite, 0.0, np.inf)
    inner = finite & ~there
    expected[inner] = dense_solution(matrix[inner][:, inner], np.ones(inner.sum()))
    np.testing.assert_allclose(result.value, expected, rtol=1e-9)


def test_times_around_a_cycle_are_distances():
    n = 500
    result = hitting_times(Chain((np.arange(n)[None] + 1) % n, np.ones((1, n))), 0)
    np.testing.assert_array_equal(result.value, (n - np.arange(n)) % n)


@pytest.mark.parametrize("target", [2, [2], np.int32(2), np.arange(4) == 2, jnp.arange(4) == 2])
def test_target_is_a_cell_a_list_or_a_mask(target):
    chain = Chain(np.array([[1, 2, 3, 0]]), np.ones((1, 4)))
    assert hitting_times(chain, target).value.tolist() == [2, 1, 0, 3]


@pytest.mark.parametrize(
    ("target", "message"),
    [
        (4, "cell 4 does not exist; cells are 0 to 3"),
        ([0, -1], "cell -1 does not exist"),
        ([], "at least one cell, got none"),
        (np.zeros(4, bool), "at least one cell, got none"),
        (np.ones(3, bool), r"a mask of 4 cells, got \(3,\)"),
        ([0.5], "whole numbers of cells, got float64"),
    ],
)
def test_bad_targets_are_refused(target, message):
    chain = Chain(np.array([[1, 2, 3, 0]]), np.ones((1, 4)))
    with pytest.raises(ValueError, match=message):
        hitting_times(chain, target)


def test_stalled_solve_is_reported(monkeypatch):
    chain = Chain.from_scipy(open_line(60))
    groups = persistent_groups(chain)
    monkeypatch.setattr(solve, "LIMITS", solve.Limits(small=0, factored=10, products=50))
    result = absorption_times(chain, groups, throw=False)
    assert result.certificate.outcome is Outcome.STALLED
    assert result.certificate.iterations == 50
    assert result.certificate.residual > 0.01
    with pytest.raises(RuntimeError, match=r"absorption_times: the residual stayed .* 50 iter"):
        absorption_times(chain, groups)


def test_residual_bounds_the_relative_error(monkeypatch):
    chain = Chain.from_scipy(open_line(60))
    groups = persistent_groups(chain)
    truth = steps_on_open_line(60).astype(float)
    for products in (500, 2000, 5000):
        monkeypatch.setattr(solve, "LIMITS", solve.Limits(small=0, factored=10, products=products))
        result = absorption_times(chain, groups, throw=False)
        error = np.abs(result.value - truth) / truth
        assert 0 < error.max() <= result.certificate.residual


def slow_eddy(cells, leak, share):
    """Draw a chain that one cell leaves, almost never, for one of two ends."""
    draw = np.random.default_rng(1)
    P = np.zeros((cells + 2, cells + 2))
    P[-1, -1] = P[-2, -2] = 1
    for row in P[:cells]:
        weight = draw.random(4)
        row[draw.choice(cells, 4, replace=False)] = weight / weight.sum()
    P[0] *= 1 - leak
    P[0, -2:] = leak * share, leak * (1 - share)
    return Chain.from_scipy(P)


def test_single_end_is_reached_with_probability_1(monkeypatch):
    monkeypatch.setattr("jaxcell.markov.transient.Transient.expect", None)  # nothing is solved
    chain = slow_eddy(30, 1e-11, 1.0)
    result = absorption_probabilities(chain, persistent_groups(chain))
    assert result.value[0].tolist() == [1] * 31 + [0]
    matrix = chain.to_scipy().toarray()[:30, :30]
    away = Chain.from_scipy(matrix)
    assert absorption_probabilities(away, persistent_groups(away)).leaving.tolist() == [1] * 30
