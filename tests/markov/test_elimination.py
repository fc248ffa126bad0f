from fractions import Fraction

import numpy as np
import pytest
import scipy.sparse
from random_chains import dense_solution, solve_exactly

from jaxcell.markov.solving.elimination import eliminate
from jaxcell.markov.solving.solve import solve_transient


def exact(matrix, right):
    """Solve `x = right + matrix x` in rational numbers."""
    gap = [[int(i == j) - x for j, x in enumerate(row)] for i, row in enumerate(matrix)]
    return np.array(solve_exactly(gap, right), float)


def trap(cells=12, seed=0):
    """Draw a chain that is left once in some 10^24 steps, because each cell is rarer."""
    draw = np.random.default_rng(seed)
    matrix = [[Fraction(0)] * cells for _ in range(cells)]
    for i in range(cells):
        back = [Fraction(int(v)) for v in draw.integers(0, 4, i + 1)]
        back[-1] += 1
        rare = Fraction(1, 128)
        for j, v in enumerate(back):
            matrix[i][j] = v / sum(back) * (1 - rare)
        if i + 1 < cells:
            matrix[i][i + 1] = rare
    return matrix


@pytest.mark.parametrize("adjoint", [False, True])
def test_trap_left_once_in_1e24_steps_equals_fractions(adjoint):
    matrix = trap()
    n = len(matrix)
    right = [[Fraction(1), Fraction(int(i == n - 1), 128)] for i in range(n)]
    turned = [list(column) for column in zip(*matrix, strict=True)] if adjoint else matrix
    expected = exact(turned, right)
    step = np.array([[float(v) for v in row] for row in matrix])
    leaving = np.append(np.zeros(n - 1), 1 / 128)
    gain = np.array([[float(v) for v in row] for row in right])
    result = eliminate(scipy.sparse.csr_array(step), leaving, gain, adjoint=adjoint)
    np.testing.assert_allclose(result, expected, rtol=1e-13)
    # The general solver eliminates this chain too.
    result, _ = solve_transient(scipy.sparse.csr_array(step), gain, adjoint=adjoint)
    np.testing.assert_allclose(result, expected, rtol=1e-12)
    if not adjoint:
        assert expected[:, 0].min() > 1e18
        np.testing.assert_allclose(result[:, 1], 1, rtol=1e-12)


@pytest.mark.parametrize("adjoint", [False, True])
def test_elimination_equals_a_dense_solve(adjoint):
    draw = np.random.default_rng(1)
    step = draw.random((30, 30)) * (draw.random((30, 30)) < 0.2)
    step *= 0.9 / max(1, step.sum(axis=1).max())
    right = draw.random((30, 3))
    result = eliminate(scipy.sparse.csr_array(step), 1 - step.sum(axis=1), right, adjoint=adjoint)
    np.testing.assert_allclose(result, dense_solution(step, right, adjoint), rtol=1e-12)
