"""Sets that a chain hardly leaves, compared with dense eigenvalues and planted partitions."""

import numpy as np
import pytest
import scipy.sparse
from hypothesis import given, strategies as st

from jaxcell import markov
from jaxcell.mapping import Chain, ChainSequence, persistent_groups


def random_blocks(random, sizes, between=0.0):
    """Draw irreducible blocks whose cells are left for another block with a probability."""
    cells = sum(sizes)
    block = np.repeat(np.arange(len(sizes)), sizes)
    matrix = np.zeros((cells, cells))
    for number in range(len(sizes)):
        (members,) = np.nonzero(block == number)
        for cell, beside in zip(members, np.roll(members, 1), strict=True):
            to = random.choice(members, 4)
            np.add.at(matrix[cell], [*to, beside], 0.2 * (1 - between))
            matrix[cell, random.choice(np.flatnonzero(block != number))] += between
    order = random.permutation(cells)
    return matrix[np.ix_(order, order)], block[order]


def same_partition(first, second):
    return len(set(zip(first.tolist(), second.tolist(), strict=True))) == len(set(second.tolist()))


# All eigenvalues of the first matrix are computed, and only the leading ones of the second.
@pytest.mark.parametrize("cells", [40, 240])
def test_modes_are_those_of_dense_matrices(cells):
    random = np.random.default_rng(cells)
    matrix = random.random((cells, cells)) * (random.random((cells, cells)) < 0.05)
    matrix += np.diag(5 * random.random(cells))
    matrix *= random.uniform(0.9, 1, (cells, 1)) / matrix.sum(axis=1, keepdims=True)
    modes = markov.leading_modes(Chain.from_scipy(matrix), 4)
    expected = np.sort_complex(np.linalg.eigvals(matrix))[::-1][: modes.value.size]
    np.testing.assert_allclose(np.sort_complex(modes.value)[::-1], expected, atol=1e-7)
    np.testing.assert_allclose(matrix @ modes.right.T, modes.right.T * modes.value, atol=1e-6)
    np.testing.assert_allclose(modes.left @ matrix, modes.value[:, None] * modes.left, atol=1e-6)
    np.testing.assert_allclose(modes.left @ modes.right.T, np.eye(modes.value.size), atol=1e-6)
    assert modes.certificate.residual < 1e-6


@pytest.mark.parametrize("size", [20, 60])
def test_closed_sets_with_equal_eigenvalues_are_found(size):
    matrix, block = random_blocks(np.random.default_rng(1), [size] * 5)
    chain = Chain.from_scipy(matrix)
    np.testing.assert_allclose(markov.leading_modes(chain, 5).value, 1, atol=1e-8)
    for find in (markov.almost_invariant_sets, markov.coherent_sets, markov.attracting_regions):
        sets = find(chain, 5)
        assert same_partition(sets.begin, block)
        np.testing.assert_allclose(sets.leakage, 0, atol=1e-12)
        np.testing.assert_allclose(sets.value, 1, atol=1e-8)
        assert (sets.time > 1e10).all()


def test_leakage_and_time_of_two_blocks():
    # A cell of the first block is left once in 20 steps, a cell of the second once in 80.
    random = np.random.default_rng(2)
    inside = np.mean([np.eye(6)[random.permutation(6)] for _ in range(5)], axis=0)
    first, second = 1 / 20, 1 / 80
    even = np.full((6, 6), 1 / 6)
    matrix = np.block(
        [[(1 - first) * inside, first * even], [second * even, (1 - second) * inside]]
    )
    chain = Chain.from_scipy(matrix)
    stationary = markov.limiting_distribution(chain, persistent_groups(chain)).value
    sets = markov.almost_invariant_sets(chain, 2, np.asarray(stationary))
    # The second block has four fifths of the mass.
    assert sets.begin.tolist() == [1] * 6 + [0] * 6
    np.testing.assert_allclose(sets.leakage, [second, first])
    np.testing.assert_allclose(sets.time, -1 / np.log([1 - second, 1 - first]))
    np.testing.assert_allclose(sets.value, [1, 1 - first - second], atol=1e-9)


@given(st.integers(0, 2**32 - 1))
def test_planted_partition_is_found(seed):
    random = np.random.default_rng(seed)
    matrix, block = random_blocks(random, [*random.integers(8, 17, 2), 12], 0.01)
    count = block.max() + 1
    steps = int(random.integers(1, 4))
    sets = markov.almost_invariant_sets(Chain.from_scipy(matrix), int(count), steps=steps)
    assert same_partition(sets.begin, block)
    window = np.linalg.matrix_power(matrix, steps)
    inside = sets.begin == np.arange(sets.count)[:, None]
    stays = [window[np.ix_(mask, mask)].sum() / mask.sum() for mask in inside]
    np.testing.assert_allclose(1 - sets.leakage, stays)
    assert (np.diff(inside.sum(axis=1)) <= 0).all()


@pytest.mark.parametrize("cells", [60, 240])
def test_values_are_those_of_the_weighted_window(cells):
    random = np.random.default_rng(cells)
    matrices = [random_blocks(random, [cells // 3] * 3, 0.1)[0] for _ in range(2)]
    matrices[1] = 0.98 * matrices[1]
    tide = ChainSequence.of([Chain.from_scipy(matrix) for matrix in matrices])
    mass = random.dirichlet(np.ones(cells))
    window = matrices[1] @ matrices[0] @ matrices[1]
    after = mass @ window
    flow = mass[:, None] * window
    singular = np.linalg.svd(flow / np.sqrt(np.outer(mass, after)), compute_uv=False)
    moving = markov.coherent_sets(tide, 3, mass, steps=3, start=1)
    np.testing.assert_allclose(moving.value, singular[:3], atol=1e-8)
    weight = (mass + after) / 2
    symmetric = (flow + flow.T) / 2 / np.sqrt(np.outer(weight, weight))
    sets = markov.almost_invariant_sets(tide, 3, mass, steps=3, start=1)
    np.testing.assert_allclose(sets.value, np.linalg.eigvalsh(symmetric)[:-4:-1], atol=1e-8)
    assert sets.steps == 3


def test_coherent_sets_move():
    random = np.random.default_rng(3)
    matrix, block = random_blocks(random, [70, 70, 70, 30], 0.02)
    turn = random.permutation(240)
    chain = Chain.from_scipy(matrix[:, turn])
    sets = markov.coherent_sets(chain, 4)
    assert same_partition(sets.begin, block)
    np.testing.assert_array_equal(sets.end, sets.begin[turn])
    assert sets.leakage.max() < 0.021
    # No set stays in its place.
    assert markov.almost_invariant_sets(chain, 4).leakage.min() > 0.1


def test_attracting_regions_lie_in_their_basins():
    # Twelve cells in a row; the left half leads to cells 0 and 1, and the right half to cell 11.
    matrix = np.zeros((12, 12))
    for cell in range(6):
        matrix[cell, max(0, cell - 2)] = 1
    matrix[0] = matrix[1] = np.eye(12)[[0, 1]].mean(axis=0)
    for cell in range(6, 12):
        matrix[cell, min(11, cell + 2)] = 1
    leak = np.array([0.01, 0.01, *[0] * 9, 0.02])
    matrix = (1 - leak)[:, None] * matrix
    matrix[:2, 8] += 0.01
    matrix[11, 4] += 0.02
    sets = markov.attracting_regions(Chain.from_scipy(matrix), 2)
    assert sets.begin.tolist() == [0] * 6 + [1] * 6
    assert sets.end.tolist() == [0, 0, *[-1] * 9, 1]
    np.testing.assert_allclose(sets.leakage, [0.02 / 6, 0.02 / 6])


def test_mass_that_goes_to_the_sink_leaks():
    matrix, block = random_blocks(np.random.default_rng(5), [20, 30])
    keeps = np.where(block == 0, 0.75, 0.96)
    sets = markov.almost_invariant_sets(Chain.from_scipy(keeps[:, None] * matrix), 2)
    assert same_partition(sets.begin, block)
    np.testing.assert_allclose(sets.leakage, [0.04, 0.25])
    assert sets.value.max() < 0.98


def test_eigenvalues_that_are_0_give_no_sets():
    # All mass is in the first block after a step, so that one eigenvalue is not 0.
    matrix = np.zeros((60, 60))
    matrix[:, :20] = 1 / 20
    for find in (markov.almost_invariant_sets, markov.coherent_sets, markov.attracting_regions):
        sets = find(Chain.from_scipy(matrix), 3)
        assert sets.begin.tolist() == [0] * 60
        np.testing.assert_allclose(sets.leakage, 0, atol=1e-12)
        np.testing.assert_allclose(sets.value[:2], [1, 0], atol=1e-7)


@pytest.mark.parametrize("seed", range(3))
def test_cells_without_mass_are_in_no_set_and_mass_in_them_leaks(seed):
    random = np.random.default_rng(seed)
    matrix, block = random_blocks(random, [20, 20], 0.05)
    # Some cells of each block have no mass, although there are steps to them.
    mass = random.uniform(1, 2, 40) * (random.random(40) < 0.8)
    sets = markov.almost_invariant_sets(Chain.from_scipy(matrix), 2, mass)
    assert ((mass @ matrix)[mass == 0] > 0).any()
    assert (sets.begin[mass == 0] == -1).all()
    assert same_partition(sets.begin[mass > 0], block[mass > 0])
    np.testing.assert_array_equal(sets.end, sets.begin)
    for number, leakage in enumerate(sets.leakage):
        inside = np.flatnonzero(sets.begin == number)
        stays = sum(mass[i] * matrix[i, j] for i in inside for j in inside)
        np.testing.assert_allclose(leakage, 1 - stays / mass[inside].sum())


def test_blur_excludes_sets_of_one_cell():
    # Mass moves round each half of a row by one cell per step, but cells 3 and 27 stay.
    cells = np.arange(40)
    half = cells // 20 * 20
    image = half + (cells - half + 1) % 20
    image[[2, 26]] = image[[3, 27]]
    image[[3, 27]] = [3, 27]
    chain = Chain.from_scipy(np.eye(40)[image])
    blur = Chain.from_scipy((np.eye(40) + np.eye(40)[cells - 1] + np.eye(40)[cells - 39]) / 3)
    alone = markov.almost_invariant_sets(chain, 2)
    assert 1 in np.bincount(alone.begin[alone.begin >= 0])
    sets = markov.almost_invariant_sets(chain, 2, blur=blur)
    assert np.bincount(sets.begin[sets.begin >= 0]).min() > 15


def test_bad_input_is_refused():
    chain = Chain.from_scipy(np.eye(3))
    with pytest.raises(ValueError, match="count: expected 1 to 3, the number of cells, got 4"):
        markov.almost_invariant_sets(chain, 4)
    with pytest.raises(ValueError, match="steps: expected 1 or more, got 0"):
        markov.leading_modes(chain, 1, steps=0)
    with pytest.raises(ValueError, match="mass: expected 3 numbers of at least 0, not all 0"):
        markov.coherent_sets(chain, 1, np.zeros(3))
    with pytest.raises(ValueError, match="blur: expected a chain of 3 cells, got 2"):
        markov.attracting_regions(chain, 1, blur=Chain.from_scipy(np.eye(2)))


def test_a_walk_on_a_long_line_takes_few_products():
    """A walk on a line with reflecting ends has the eigenvalues `cos(pi k / cells)`."""
    cells = 3000
    half = np.full(cells - 1, 0.5)
    ends = np.zeros(cells)
    ends[[0, -1]] = 0.5
    matrix = scipy.sparse.diags_array([half, ends, half], offsets=[-1, 0, 1])
    sets = markov.almost_invariant_sets(Chain.from_scipy(matrix), 3)
    np.testing.assert_allclose(sets.value, np.cos(np.pi * np.arange(3) / cells), atol=1e-12)
    assert sets.certificate.iterations < 200
