import dataclasses

import numpy as np
import pytest
import scipy.sparse
from hypothesis import given, strategies as st
from random_chains import dense_solution, open_line, steps_on_open_line, tide

from jaxcell.markov.solving import solve
from jaxcell.markov.solving.solve import Limits, solve_transient
from jaxcell.markov.solving.stationary import solve_stationary
from jaxcell.markov.transient import Transient


def random_chain(cells, branches, seed):
    draw = np.random.default_rng(seed)
    image = draw.integers(0, cells, (cells, branches))
    share = draw.dirichlet(np.ones(branches), cells)
    rows = np.repeat(np.arange(cells), branches)
    return scipy.sparse.csr_array((share.ravel(), (rows, image.ravel())), shape=(cells, cells))


def leaving(step):
    """Return the probability of leaving a matrix from each row."""
    return 1 - step @ np.ones(step.shape[0])


def wandering(n):
    """Return the matrix of a walk in circles in a square, which it leaves slowly at the border."""
    row, column = np.divmod(np.arange(n * n), n)
    step = scipy.sparse.lil_array((n * n, n * n))
    for cell, (r, c) in enumerate(zip(row, column, strict=True)):
        up, right = (1 if 2 * c >= n else -1), (-1 if 2 * r >= n else 1)
        for i, j, share in ((up, 0, 0.5), (0, right, 0.4), (0, 0, 0.1)):
            if 0 <= r + i < n and 0 <= c + j < n:
                step[cell, (r + i) * n + c + j] += share
    return step.tocsr()


def nearly_triangular():
    """Draw a matrix in which only two states lead back to each other."""
    draw = np.random.default_rng(7)
    step = np.triu(draw.random((80, 80)) < 0.05) * draw.random((80, 80))
    step[41, 40] = step[40, 41] = 0.5
    step /= 1.1 * np.maximum(1, step.sum(axis=1, keepdims=True))
    order = draw.permutation(80)
    return scipy.sparse.csr_array(step[order][:, order])


PRODUCTS, FACTOR = (Limits(small=0, trial=trial, worthwhile=0) for trial in (10**9, 1))
TWO_LEVELS = dataclasses.replace(FACTOR, two_level=0, complete=0, elimination=0.0)
ROUGH = dataclasses.replace(TWO_LEVELS, rough_steps=0)
COMPLETE = dataclasses.replace(ROUGH, complete=100)
# The limits that choose a method, a matrix, the least and most products, and the relative error.
METHODS = {
    "products": (PRODUCTS, 0.8 * random_chain(60, 4, 1), 101, 50_000, 1e-12),
    "factors": (FACTOR, 0.8 * random_chain(60, 4, 1), 1, 1, 1e-12),
    "components": (Limits(small=0), nearly_triangular(), 0, 0, 1e-12),
    "two levels": (TWO_LEVELS, wandering(20), 2, 99, 1e-10),
    "factors after two levels": (COMPLETE, wandering(10), 1, 1, 1e-12),
    # Without the cycle, a single product and a factorisation would solve it.
    "cycle": (dataclasses.replace(FACTOR, cycle=10), tide(2), 2, 120, 1e-10),
}


@pytest.mark.parametrize("adjoint", [False, True])
@pytest.mark.parametrize("method", METHODS)
def test_solution_by_each_method_equals_dense(method, adjoint, monkeypatch):
    limits, step, least, most, error = METHODS[method]
    monkeypatch.setattr(solve, "LIMITS", limits)
    right = np.random.default_rng(2).random((step.shape[0], 2))
    result, products, _ = solve_transient(step, leaving(step), right, adjoint=adjoint)
    np.testing.assert_allclose(result, dense_solution(step, right, adjoint), rtol=error)
    assert least <= products <= most


@pytest.mark.parametrize("method", ["products", "factors"])
def test_stationary_equals_the_null_space(method, monkeypatch):
    monkeypatch.setattr(solve, "LIMITS", METHODS[method][0])
    sizes = [1, 2, 40, 7]
    blocks = [random_chain(size, 3, seed).toarray() for seed, size in enumerate(sizes)]
    # A ring joins each block into one class.
    blocks = [(b + np.roll(np.eye(len(b)), 1, axis=1)) / 2 for b in blocks]
    group = np.repeat(np.arange(4), sizes)
    # Classes need not lie one after the other.
    order = np.random.default_rng(5).permutation(50)
    sparse = [scipy.sparse.csr_array(block) for block in blocks]
    matrix = scipy.sparse.block_diag(sparse, format="csr")[order][:, order]
    labels = group[order].astype(np.int32)
    result, *_ = solve_stationary(scipy.sparse.csr_array(matrix), labels)
    for number, block in enumerate(blocks):
        values, vectors = np.linalg.eig(block.T)
        expected = vectors[:, np.argmax(values.real)].real
        expected /= expected.sum()
        back = np.empty(50)
        back[order] = result
        np.testing.assert_allclose(back[group == number], expected, rtol=1e-9, atol=1e-13)


def test_slow_chain_is_factored_and_fast_chain_is_not():
    fast = random_chain(300, 10, 3)
    _, products, _ = solve_stationary(fast, np.zeros(300, np.int32))
    assert products % solve.LIMITS.trial != 0
    line = scipy.sparse.csr_array(open_line(400))
    result, products, _ = solve_transient(line, leaving(line), np.ones((400, 1)))
    assert products == solve.LIMITS.trial
    np.testing.assert_allclose(result[:, 0], steps_on_open_line(400), rtol=1e-9)


def test_products_go_on_for_chain_too_large_to_factor(monkeypatch):
    monkeypatch.setattr(solve, "LIMITS", Limits(small=0, factored=10))
    line = scipy.sparse.csr_array(open_line(20))
    result, products, _ = solve_transient(line, leaving(line), np.ones((20, 1)))
    np.testing.assert_allclose(result[:, 0], steps_on_open_line(20), rtol=1e-9)
    assert products > solve.LIMITS.worthwhile


def test_products_follow_if_two_levels_do_not_converge(monkeypatch):
    monkeypatch.setattr(solve, "LIMITS", ROUGH)
    step = wandering(10)
    result, products, _ = solve_transient(step, leaving(step), np.ones((100, 1)))
    np.testing.assert_allclose(result, dense_solution(step, np.ones((100, 1))), rtol=1e-10)
    assert products > 100
    monkeypatch.setattr(solve, "LIMITS", dataclasses.replace(ROUGH, products=50))
    short, products, _ = solve_transient(step, leaving(step), np.ones((100, 1)))
    assert products <= 51
    assert (short < result).any()


def test_two_levels_find_stationary_distribution(monkeypatch):
    monkeypatch.setattr(solve, "LIMITS", TWO_LEVELS)
    matrix = wandering(12).tolil()
    matrix.setdiag(matrix.diagonal() + 1 - np.asarray(matrix.sum(axis=1)).ravel())
    matrix = scipy.sparse.csr_array(matrix)
    count, label = scipy.sparse.csgraph.connected_components(matrix, connection="strong")
    assert count == 1
    result, *_ = solve_stationary(matrix, label.astype(np.int32))
    np.testing.assert_allclose(matrix.T @ result, result, atol=1e-14)
    assert result.sum() == pytest.approx(1)


def test_solution_without_right_hand_side_is_0():
    none = scipy.sparse.csr_array((3, 3))
    result, products, error = solve_transient(none, np.ones(3), np.zeros((3, 2)))
    assert (result.tolist(), products, error) == ([[0, 0]] * 3, 0, 0)


@st.composite
def parts(draw):
    """Draw a chain of few branchings that it leaves in the end."""
    cells = draw(st.integers(1, 12))
    matrix = np.zeros((cells, cells))
    for i, row in enumerate(matrix):
        # Most steps lead to a later cell, so that the chain usually leaves in the end.
        for image in draw(st.lists(st.integers(i + 1, cells + 1), min_size=1, max_size=2)):
            if image < cells:
                row[image] += 0.5
        row *= 1 / max(0.5, row.sum())
        if draw(st.booleans()) and i:
            row *= 0.75
            row[draw(st.integers(0, i - 1))] += 0.25
    matrix[-1] *= 0.5
    return matrix


@given(parts(), st.integers(0, 2**32 - 1))
def test_parts_with_runs_equal_dense(matrix, seed):
    draw = np.random.default_rng(seed)
    inside = draw.random(len(matrix)) < 0.8
    step = matrix[inside][:, inside]
    # The part must be left in the end.
    if np.linalg.matrix_power(step, 4000).sum() > 1e-9:
        return
    taken = Transient.of(scipy.sparse.csr_array(matrix), inside)
    gain = draw.random((inside.sum(), 2))
    result = taken.expect(gain).value
    right = np.column_stack([gain, np.ones(len(gain))])
    np.testing.assert_allclose(result, dense_solution(step, right), rtol=1e-10)
    start = draw.random(inside.sum())
    expected = dense_solution(step, start, adjoint=True)
    np.testing.assert_allclose(taken.visits(start).value, expected, rtol=1e-10, atol=1e-14)
    certain = (step == 1).any(axis=1)
    np.testing.assert_array_equal(taken.branching, np.flatnonzero(~certain))


def test_part_that_is_never_left_is_refused():
    around = scipy.sparse.csr_array(np.roll(np.eye(3), 1, axis=1))
    with pytest.raises(RuntimeError, match="never leaves"):
        Transient.of(around, np.ones(3, bool))


@pytest.mark.parametrize("adjoint", [False, True])
def test_nearly_full_matrices_have_dense_factors(adjoint):
    rng = np.random.default_rng(0)
    matrix = rng.random((300, 300))
    matrix /= 1.001 * matrix.sum(axis=1, keepdims=True)
    right = rng.random((300, 2))
    found = solve.factored(scipy.sparse.csr_array(matrix))(right, adjoint)
    known = np.linalg.solve(np.eye(300) - (matrix.T if adjoint else matrix), right)
    np.testing.assert_allclose(found, known, rtol=1e-11)


def test_singular_full_matrix_is_refused():
    matrix = np.full((30, 30), 1 / 30)
    matrix[0] = np.eye(30)[0]
    with pytest.raises(RuntimeError, match="singular"):
        solve.factored(scipy.sparse.csr_array(matrix))
