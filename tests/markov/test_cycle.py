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


def test_chain_with_phases_is_a_cycle_and_walk_is_not():
    matrix = tide(2)
    for one in (matrix, matrix.T.tocsr()):
        found = Cycle.of(one)
        # Four phases, and those of a state that skips one.
        assert len(found.rows) in (4, 5)
        assert found.again.size <= 30 + 2
    walk = scipy.sparse.diags_array([np.full(99, 0.5)] * 2, offsets=[-1, 1], format="csr")
    assert Cycle.of(walk) is None
