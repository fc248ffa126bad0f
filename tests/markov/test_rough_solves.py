"""Rough solves of large matrices, in rounds of a cycle or on two levels, beside dense solves."""

import numpy as np
import pytest
import scipy.sparse
from random_chains import dense_solution, open_line, steps_on_open_line, tide

from jaxcell.markov.solving import solve
from jaxcell.markov.solving.cycle import Cycle
from jaxcell.markov.solving.two_level import TwoLevel


# Products are always too slow.
BY_CYCLE = solve.Limits(trial=1, worthwhile=0, cycle=10)


def test_cycle_of_slow_walks_takes_no_more_products_than_it_has_cells():
    cells = 90
    walk, none, stay = open_line(cells), np.zeros((cells, cells)), np.eye(cells)
    matrix = np.block([[none, walk, none], [none, none, stay], [stay, none, none]])
    result, products = Cycle.of(scipy.sparse.csr_array(matrix))(np.ones(3 * cells))
    # A drifter that leaves does so in the first of three steps.
    np.testing.assert_allclose(result[:cells], 3 * steps_on_open_line(cells) - 2, rtol=1e-7)
    assert products <= cells + 1


def in_two_phases(first):
    """Return a chain that steps by a matrix in one phase, and permutes cells in the other phase."""
    size = len(first)
    turn = np.eye(size)[np.random.default_rng(7).permutation(size)]
    none = np.zeros((size, size))
    return scipy.sparse.csr_array(np.block([[none, first @ turn.T], [turn, none]]))


def test_slow_eddies_are_solved_in_few_products():
    count, size = 40, 25
    random = np.random.default_rng(5)
    wells = np.kron(np.eye(count), np.ones((size, size)) * (random.random((size, size)) < 0.2))
    step = 0.999 * wells / wells.sum(axis=1, keepdims=True)
    step[np.arange(count * size), random.permutation(count * size)] += 0.0009
    matrix = in_two_phases(step)
    right = random.random(2 * count * size)
    result, products = Cycle.of(matrix)(right)
    np.testing.assert_allclose(result, dense_solution(matrix, right), rtol=1e-5)
    # Without aggregates it would take 95.
    assert products < 75


@pytest.mark.parametrize("leak", [1e-2, 1e-6, 1e-9])
def test_time_in_two_nearly_closed_wells_has_its_digits(leak, monkeypatch):
    monkeypatch.setattr(solve, "LIMITS", BY_CYCLE)
    size = 200
    random = np.random.default_rng(1)
    step = np.zeros((2 * size, 2 * size))
    for state in range(2 * size):
        well = state // size * size
        np.add.at(step[state], well + random.integers(0, size, 4), (1 - leak) / 4)
    # The first well leaks into the second, which leaks out of the chain.
    step[np.arange(size), size + random.permutation(size)] = leak
    # Only cells of the second well leave.
    leaving = np.repeat([0, leak, 0], [size, size, 2 * size])
    result, *_ = solve.solve_transient(in_two_phases(step), leaving, np.ones((4 * size, 1)))
    expected = np.repeat([4 / leak - 1, 2 / leak - 1], size)
    np.testing.assert_allclose(result[: 2 * size, 0], expected, rtol=1e-6)


def test_chain_whose_aggregates_are_singular_is_eliminated(monkeypatch):
    monkeypatch.setattr(solve, "LIMITS", BY_CYCLE)
    # Pairs of states that change places, and leave so rarely that their rows sum to 1. One state
    # in eight begins an aggregate, so that some pair is an aggregate that nothing leaves.
    size, rare = 400, 1e-18
    step = np.eye(size)[np.arange(size) ^ 1]
    step[:-2, -2] = rare
    step[-2:] /= 2
    none = np.zeros((size, size))
    matrix = scipy.sparse.csr_array(np.block([[none, step], [np.eye(size), none]]))
    with pytest.raises(RuntimeError, match="singular"):
        Cycle.of(matrix)(np.ones(2 * size))
    leaving = np.zeros(2 * size)
    leaving[size - 2 : size] = 0.5
    result, *_ = solve.solve_transient(matrix, leaving, np.ones((2 * size, 1)))
    np.testing.assert_allclose(result[: size - 2, 0], 2 / rare, rtol=1e-12)
    np.testing.assert_allclose(result[size - 2 : size, 0], 3, rtol=1e-12)


def test_chain_with_phases_is_a_cycle_and_walk_is_not():
    for matrix in (tide(2), tide(2).T.tocsr()):
        cycle = Cycle.of(matrix)
        # Four phases, one of which may be divided by the cell that skips a phase.
        assert len(cycle.rows) in (4, 5)
        assert cycle.again.size <= 30 + 2
    assert Cycle.of(scipy.sparse.csr_array(open_line(100))) is None


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
    result, products = TwoLevel.of(scipy.sparse.csr_array(matrix), solve.LIMITS.rough_steps)(right)
    np.testing.assert_allclose(result, dense_solution(matrix, right), rtol=1e-4)
    # BiCGSTAB and the rough inverse take equally many products.
    assert 0 < products < 4 * solve.LIMITS.rough_steps


def test_aggregates_keep_products_few():
    matrix, right = scipy.sparse.csr_array(eddies(60, 30)), np.ones(1800)
    _, products = TwoLevel.of(matrix, solve.LIMITS.rough_steps)(right)
    # Without aggregates, BiCGSTAB would take more than 200.
    assert products < 100
