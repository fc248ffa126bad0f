"""Chains with cells that are hardly ever visited, compared with exact rational numbers."""

import math
from fractions import Fraction

import numpy as np
import pytest
import scipy.sparse
from hypothesis import given, strategies as st
from oracles import exact_chains
from random_chains import birth_and_death

from jaxcell import mapping, markov
from jaxcell.markov.solving import solve
from jaxcell.markov.solving.elimination import eliminate
from jaxcell.markov.solving.stationary import Rooted, solve_stationary


def limiting(matrix, **options):
    chain = mapping.Chain.from_scipy(matrix)
    return markov.limiting_distribution(chain, mapping.persistent_groups(chain), **options)


def with_diagonal(steps):
    """Return the transition matrix with these steps between different cells."""
    return steps + np.diag(1 - steps.sum(axis=1))


def exact(matrix):
    """Compute the stationary distribution and Kemeny's constant in rational numbers."""
    share = exact_chains.stationary(matrix)
    return exact_chains.as_floats(share), *exact_chains.as_floats([exact_chains.kemeny(matrix)])


@st.composite
def uneven(draw):
    """Draw a circle of cells with some other steps, and probabilities down to 1e-20."""
    size = draw(st.integers(2, 9))
    steps = np.zeros((size, size))
    cell = st.integers(0, size - 1)
    more = draw(st.lists(st.tuples(cell, cell), max_size=2 * size))
    for i, j in [*((i, (i + 1) % size) for i in range(size)), *more]:
        if i != j:
            steps[i, j] = draw(st.floats(0.05, 0.95)) / size / 10 ** draw(st.integers(0, 20))
    return with_diagonal(steps)


@given(uneven())
def test_every_share_and_kemeny_constant_have_nearly_all_their_digits(matrix):
    share, constant = exact(matrix)
    result = limiting(matrix)
    np.testing.assert_allclose(result.value, np.array(share, float), rtol=1e-12)
    assert markov.kemeny_constant(mapping.Chain.from_scipy(matrix)) == pytest.approx(
        float(constant), rel=1e-11
    )


@given(uneven())
def test_factorisation_gives_way_where_rounding_spoils_it(matrix):
    share, constant = exact(matrix)
    step = scipy.sparse.csr_array(matrix)
    one_class = np.zeros(len(matrix), int)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(solve, "LIMITS", solve.Limits(small=0))
        value, *_ = solve_stationary(step, one_class)
    np.testing.assert_allclose(value, np.array(share, float), atol=1e-7)
    visits = Rooted.of(step, one_class, value).visits(small=0)
    assert kemeny_of(visits, np.delete(share, np.argmax(value))) == pytest.approx(
        float(constant), rel=1e-8
    )


def kemeny_of(visits, share):
    """Compute Kemeny's constant from the visits before a root, and the shares of other cells."""
    return np.trace(visits) - np.array(share, float) @ visits.sum(axis=1)


@pytest.mark.parametrize("back", [0.1, 1 - 0.9])
@pytest.mark.parametrize("small", [0, 200])
def test_shares_are_exact_if_the_first_or_the_last_cell_is_rare(back, small, monkeypatch):
    monkeypatch.setattr(solve, "LIMITS", solve.Limits(small=small))
    matrix = birth_and_death(np.full(19, 0.9), np.full(19, back))
    expected = np.array(exact(matrix)[0], float)
    for turned in (slice(None), slice(None, None, -1)):
        step = scipy.sparse.csr_array(matrix[turned, turned])
        value, *_ = solve_stationary(step, np.zeros(20, int))
        assert value.max() == pytest.approx(0.8888888888888888, rel=1e-14)
        np.testing.assert_allclose(value, expected[turned], atol=1e-14)


# The first matrix is factored completely, the second solved as a cycle.
@pytest.mark.parametrize("limits", [solve.Limits(), solve.Limits(cycle=100)])
def test_two_tubes_share_time_by_the_rare_steps_between_them(limits, monkeypatch):
    """All cells of a tube, rings of 21 cells that lead to the next ring, have equal shares."""

    def turn(n):
        return scipy.sparse.csr_array((np.ones(n), (np.arange(n), np.roll(np.arange(n), -1))))

    monkeypatch.setattr(solve, "LIMITS", limits)
    tube = scipy.sparse.kron(turn(16), (turn(21) + turn(21).T) / 2)
    cells = 21 * 16
    matrix = scipy.sparse.block_diag([tube, tube], format="lil")
    matrix[0, cells], matrix[cells, 0] = 3e-14, 1e-14
    value = limiting(matrix.tocsr()).value
    assert float(value[:cells].sum()) == pytest.approx(0.25, abs=1e-9)


def test_shares_near_the_range_of_floats():
    # The first root is the first cell. Relative to it the shares of the last cells overflow.
    matrix = birth_and_death(np.full(150, 0.999), np.full(150, 0.001))
    result = limiting(matrix)
    np.testing.assert_allclose(result.value[-3:], 998 / 999 / 999.0 ** np.array([2, 1, 0]))
    assert math.isfinite(markov.kemeny_constant(mapping.Chain.from_scipy(matrix)))


def test_wells_that_products_cannot_join_get_exact_shares():
    # From a uniform start each well keeps its share of the cells, because hardly anything leaks.
    up = np.where(np.arange(300) < 120, 0.4, 0.6)
    matrix = birth_and_death(up[:-1], 1 - up[1:])
    log = np.append(0, np.cumsum(np.log(up[:-1] / (1 - up[1:]))))
    weight = np.exp(log - log.max())
    np.testing.assert_allclose(limiting(matrix).value, weight / weight.sum(), atol=1e-9)


def test_kemeny_constant_of_a_double_well_of_100_cells():
    """The constant is a sum over the edges of a line: the shares of both sides, over the flow."""
    x = np.linspace(-1, 1, 100)
    force = 20 * (x - x**3) / 100
    up, down = 0.5 + force[:-1] / 2, 0.5 - force[1:] / 2
    matrix = birth_and_death(up / 2, down / 2)
    weight = [Fraction(1)]
    for i in range(99):
        weight.append(weight[-1] * Fraction(matrix[i, i + 1]) / Fraction(matrix[i + 1, i]))
    total, below, constant = sum(weight), Fraction(0), Fraction(0)
    for i in range(99):
        below += weight[i]
        constant += below * (total - below) / (total * weight[i] * Fraction(matrix[i, i + 1]))
    result = markov.kemeny_constant(mapping.Chain.from_scipy(matrix))
    assert result == pytest.approx(float(constant), rel=1e-12)


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
def test_trap_left_once_in_1e24_steps_equals_fractions(adjoint, monkeypatch):
    matrix = trap()
    n = len(matrix)
    right = [[Fraction(1), Fraction(int(i == n - 1), 128)] for i in range(n)]
    turned = [list(column) for column in zip(*matrix, strict=True)] if adjoint else matrix
    gap = [[int(i == j) - x for j, x in enumerate(row)] for i, row in enumerate(turned)]
    gap, sides = (
        [[exact_chains.rational(x) for x in row] for row in part] for part in (gap, right)
    )
    expected = np.array([exact_chains.as_floats(row) for row in exact_chains.solve(gap, sides)])
    step = np.array([[float(v) for v in row] for row in matrix])
    leaving = np.append(np.zeros(n - 1), 1 / 128)
    gain = np.array([[float(v) for v in row] for row in right])
    result, error = eliminate(scipy.sparse.csr_array(step), leaving, gain, adjoint=adjoint)
    np.testing.assert_allclose(result, expected, rtol=1e-13)
    assert np.abs(result / expected - 1).max() <= error < 2e-12
    # The general solver eliminates this chain too, even if it tries other methods first.
    monkeypatch.setattr(solve, "LIMITS", solve.Limits(small=0))
    result, *_ = solve.solve_transient(scipy.sparse.csr_array(step), leaving, gain, adjoint=adjoint)
    np.testing.assert_allclose(result, expected, rtol=1e-12)
    if not adjoint:
        assert expected[:, 0].min() > 1e18
        np.testing.assert_allclose(result[:, 1], 1, rtol=1e-12)
