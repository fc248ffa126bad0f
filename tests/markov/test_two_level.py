"""Solves on two levels, compared with dense solves."""

import numpy as np
import pytest
import scipy.sparse
from random_chains import dense_solution

from jaxcell.markov.solving.solve import Limits
from jaxcell.markov.solving.two_level import TwoLevel


STEPS = Limits().rough_steps


def eddies(count, size):
    """Return the matrix of a row of rings, each left for its neighbours once in 100 steps.

    One state leads out of the chain.
    """
    states = count * size
    ring, place = np.divmod(np.arange(states), size)
    step = np.zeros((states, states))
    step[np.arange(states), ring * size + (place + 1) % size] = 0.7
    step[np.arange(states), np.arange(states)] = 0.29
    for to in (-1, 1):
        other = np.clip(ring + to, 0, count - 1) * size + (place * 3) % size
        np.add.at(step, (np.arange(states), other), 0.005)
    step[states // 2] *= 0.9
    order = np.random.default_rng(3).permutation(states)
    return step[np.ix_(order, order)]


@pytest.mark.parametrize("adjoint", [False, True])
def test_rough_solve_is_near_the_dense_one(adjoint):
    step = eddies(20, 30)
    matrix, right = step.T if adjoint else step, np.random.default_rng(0).random(600)
    result, products = TwoLevel.of(scipy.sparse.csr_array(matrix), STEPS)(right)
    np.testing.assert_allclose(result, dense_solution(matrix, right), rtol=1e-4)
    # BiCGSTAB and the rough inverse take equally many products.
    assert 0 < products < 4 * STEPS


def test_aggregates_keep_products_few():
    matrix, right = scipy.sparse.csr_array(eddies(60, 30)), np.ones(1800)
    _, products = TwoLevel.of(matrix, STEPS)(right)
    # Without aggregates, BiCGSTAB would take more than 200.
    assert products < 100
