import numpy as np
import pytest
import scipy.sparse

from jaxcell.markov.solving import solve
from jaxcell.markov.solving.cycle import Cycle


def tide(seed, phases=4, cells=30):
    """A chain over the cells at each phase, of which some leave, and some skip a phase."""
    random = np.random.default_rng(seed)
    matrix = np.zeros((phases * cells, phases * cells))
    for k in range(phases):
        later = (k + 1) % phases * cells
        for i in range(cells):
            near = (i + random.integers(-1, 2, 2)) % cells
            np.add.at(matrix[k * cells + i], later + near, random.dirichlet([1, 1]))
    matrix[0, : 3 * cells] = np.roll(matrix[0], cells)[: 3 * cells]
    matrix[::7] *= 0.9
    return scipy.sparse.csr_array(matrix)


@pytest.mark.parametrize("adjoint", [False, True])
def test_cycle_is_solved_by_whole_rounds(adjoint, monkeypatch):
    # As if products were always slow.
    monkeypatch.setattr(solve, "LIMITS", solve.Limits(trial=1, worthwhile=0, cycle=10))
    matrix = tide(2)
    right = np.random.default_rng(3).random((matrix.shape[0], 2))
    found, products = solve.solve_transient(matrix, right, adjoint=adjoint)
    dense = matrix.toarray().T if adjoint else matrix.toarray()
    np.testing.assert_allclose(found, np.linalg.solve(np.eye(len(dense)) - dense, right))
    # A factorisation would follow a single product.
    assert products > 1


def test_cycle_of_slow_walks_takes_no_more_products_than_it_has_cells():
    cells = 90
    walk = scipy.sparse.diags_array([np.full(cells - 1, 0.5)] * 2, offsets=[-1, 1], format="csr")
    none = scipy.sparse.csr_array((cells, cells))
    stay = scipy.sparse.eye_array(cells, format="csr")
    matrix = scipy.sparse.block_array([[none, walk, none], [none, none, stay], [stay, none, none]])
    cycle = Cycle.of(scipy.sparse.csr_array(matrix))
    found, products = cycle(np.ones(3 * cells))
    i = np.arange(cells)
    # A drifter that leaves does so in the first of three steps.
    np.testing.assert_allclose(found[:cells], 3 * (i + 1) * (cells - i) - 2, rtol=1e-7)
    assert products <= cells + 1


def in_two_phases(first):
    """A chain that takes a step of a matrix in one phase, and changes places in the other."""
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
    found, products = Cycle.of(matrix)(right)
    expected = np.linalg.solve(np.eye(right.size) - matrix.toarray(), right)
    np.testing.assert_allclose(found, expected, rtol=1e-5)
    # Without aggregates it takes 95.
    assert products < 75


@pytest.mark.parametrize("leak", [1e-2, 1e-6, 1e-9])
def test_time_in_two_nearly_closed_wells_has_its_digits(leak, monkeypatch):
    monkeypatch.setattr(solve, "LIMITS", solve.Limits(trial=1, worthwhile=0, cycle=10))
    size = 200
    random = np.random.default_rng(1)
    step = np.zeros((2 * size, 2 * size))
    for state in range(2 * size):
        well = state // size * size
        np.add.at(step[state], well + random.integers(0, size, 4), (1 - leak) / 4)
    # From the first well to the second one, and from there away.
    step[np.arange(size), size + random.permutation(size)] = leak
    found, _ = solve.solve_transient(in_two_phases(step), np.ones((4 * size, 1)))
    expected = np.repeat([4 / leak - 1, 2 / leak - 1], size)
    np.testing.assert_allclose(found[: 2 * size, 0], expected, rtol=1e-6)


def test_chain_whose_aggregates_are_singular_is_eliminated(monkeypatch):
    monkeypatch.setattr(solve, "LIMITS", solve.Limits(trial=1, worthwhile=0, cycle=10))
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
    found, _ = solve.solve_transient(matrix, np.ones((2 * size, 1)))
    np.testing.assert_allclose(found[: size - 2, 0], 2 / rare, rtol=1e-12)
    np.testing.assert_allclose(found[size - 2 : size, 0], 4 - 1, rtol=1e-12)


def test_chain_with_phases_is_a_cycle_and_walk_is_not():
    matrix = tide(2)
    for one in (matrix, matrix.T.tocsr()):
        found = Cycle.of(one)
        # Four phases, and those of a state that skips one.
        assert len(found.rows) in (4, 5)
        assert found.again.size <= 30 + 2
    walk = scipy.sparse.diags_array([np.full(99, 0.5)] * 2, offsets=[-1, 1], format="csr")
    assert Cycle.of(walk) is None
