import numpy as np
import pytest
from hypothesis import given
from random_chains import matrices, reachable

from jaxcell.mapping.classes import persistent_groups
from jaxcell.mapping.domiciles import transient_groups
from jaxcell.mapping.generalized import Chain


@given(matrices())
def test_transient_groups_have_the_groups_that_their_cells_reach(matrix):
    chain = Chain.from_scipy(matrix)
    groups = persistent_groups(chain)
    group = np.asarray(groups.group)
    reach = reachable(matrix)
    leaves = reach[:, np.asarray(chain.leaving) > 0].any(axis=1)
    result = transient_groups(chain, groups)
    homes = [
        ((-1,) if leaves[cell] else ()) + tuple(np.unique(group[reach[cell] & (group >= 0)]))
        for cell in range(len(matrix))
    ]
    transient = np.flatnonzero(group < 0)
    sets = {homes[cell] for cell in transient}
    assert list(result.domiciles) == sorted(sets, key=lambda one: (len(one), one))
    assert result.count == len(sets)
    for cell in transient:
        assert result.domiciles[int(result.group[cell])] == homes[cell]
    assert (np.asarray(result.group)[group >= 0] == -1).all()
    counts = np.bincount(np.asarray(result.group)[transient], minlength=len(sets))
    assert result.size.tolist() == counts.tolist()
    assert result.single.tolist() == [len(one) == 1 for one in result.domiciles]


def test_every_cell_of_a_line_with_a_group_per_cell_has_other_domiciles():
    n = 60
    matrix = np.zeros((2 * n, 2 * n))
    matrix[n:, n:] = np.eye(n)
    for cell in range(n):
        matrix[cell, n + cell] = 0.5
        if cell + 1 < n:
            matrix[cell, cell + 1] = 0.5
        else:
            matrix[cell, n + cell] = 1
    chain = Chain.from_scipy(matrix)
    result = transient_groups(chain, persistent_groups(chain))
    assert result.group.tolist() == [n - 1 - cell for cell in range(n)] + [-1] * n
    assert result.domiciles == tuple(tuple(range(n - 1 - k, n)) for k in range(n))


def test_groups_of_another_chain_are_refused():
    chain = Chain(np.array([[1, 0]]), np.ones((1, 2)))
    other = persistent_groups(Chain(np.array([[0]]), np.ones((1, 1))))
    with pytest.raises(ValueError, match="chain of 2 cells, got the groups of a chain of 1"):
        transient_groups(chain, other)
