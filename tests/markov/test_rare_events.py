"""Chains with sets that are left once in 1e6 to 1e60 steps, compared with exact rationals."""

import itertools
import math
from fractions import Fraction

import numpy as np
import pytest
import scipy.sparse
from oracles import exact_chains as exact
from random_chains import birth_and_death, open_line, steps_on_open_line

from jaxcell.base.certificate import Outcome
from jaxcell.mapping import Chain, persistent_groups
from jaxcell.markov import (
    DecisionModel,
    Distinct,
    absorption_probabilities,
    absorption_times,
    arrival_probabilities,
    commute_times,
    conditional_hitting_times,
    hitting_matrix,
    hitting_times,
    kemeny_constant,
    limiting_distribution,
    mean_arrival,
    mean_first_arrival,
    stochastic_shortest_path,
)
from jaxcell.markov.solving import solve


def clusters(draw, sizes, coupling):
    """Draw clusters in a circle, of which a cell leads to the next cluster by a rare coupling."""
    label = np.repeat(np.arange(len(sizes)), sizes)
    same = label[:, None] == label
    steps = draw.random(same.shape) * (draw.random(same.shape) < 0.5) * same
    for k in range(len(sizes)):
        members = np.flatnonzero(label == k)
        steps[members, np.roll(members, 1)] += 0.1
        steps[members, members] = 0
    steps /= 1.5 * np.maximum(steps.sum(axis=1, keepdims=True), 0.1)
    for k in range(len(sizes)):
        here = draw.choice(np.flatnonzero(label == k))
        there = draw.choice(np.flatnonzero(label == (k + 1) % len(sizes)))
        steps[here, there] += coupling * draw.uniform(0.5, 2)
    return steps + np.diag(1 - steps.sum(axis=1))


def stopped(matrix, cells):
    """Return the matrix of the chain that stops in some cells."""
    matrix = matrix.copy()
    matrix[cells] = np.eye(len(matrix))[cells]
    return matrix


@pytest.mark.parametrize("seed", range(50))
def test_errors_of_nearly_decomposable_chains_are_as_stated(seed):
    """50 chains, each with times to one cell and to all cells, and two ends with conditions."""
    draw = np.random.default_rng(seed)
    sizes = draw.integers(1, 9, draw.integers(2, 4)) + 1
    matrix = clusters(draw, sizes, 10.0 ** -draw.uniform(6, 60))
    chain = Chain.from_scipy(matrix)
    target, other = (int(cell) for cell in draw.choice(len(matrix), 2, replace=False))
    expected = exact.times(matrix, target)
    among = hitting_matrix(chain)
    for value, certificate in (
        ((result := hitting_times(chain, target)).value, result.certificate),
        (among.value[:, target], among.certificate),
    ):
        assert exact.relative(value, expected) <= certificate.residual < 1e-9
    ended = Chain.from_scipy(stopped(matrix, [target, other]))
    table = exact.ends(matrix, [{target}, {other}])
    chance, time = [row[0] for row in table], [row[-1] for row in table]
    groups = persistent_groups(ended)
    absorbed = absorption_probabilities(ended, groups)
    first = absorbed.value[int(groups.group[target])]
    arrives = arrival_probabilities(ended, target)
    for value, certificate in ((first, absorbed.certificate), (arrives.value, arrives.certificate)):
        # Small chains are eliminated, so that even tiny probabilities have all their digits.
        assert exact.relative(value, chance) <= certificate.residual + 1e-12 < 1e-9
    result = absorption_times(ended, groups)
    assert exact.relative(result.value, time) <= result.certificate.residual < 1e-9
    result = conditional_hitting_times(ended, target)
    condition = exact.conditional_times(matrix, {target}, {other})
    found = np.asarray(result.value)[list(condition)]
    assert exact.relative(found, condition.values()) <= result.certificate.residual < 1e-6


@pytest.mark.parametrize("rare", [1e-3, 1e-6, 1e-9, 1e-11, 1e-13])
@pytest.mark.parametrize("seed", range(6))
def test_errors_of_a_factorisation_are_as_stated_or_refused(rare, seed, monkeypatch):
    monkeypatch.setattr(solve, "LIMITS", solve.Limits(small=0, elimination=0.0))
    draw = np.random.default_rng(seed)
    matrix = clusters(draw, (12, 9, 15), rare)
    chain = Chain.from_scipy(matrix)
    result = hitting_times(chain, 0, throw=False)
    assert exact.relative(result.value, exact.times(matrix, 0)) <= result.certificate.residual
    assert (result.certificate.outcome is Outcome.CONVERGED) == (rare > 1e-9)
    ended = Chain.from_scipy(stopped(matrix, [0, 30]))
    result = arrival_probabilities(ended, 0, throw=False)
    chance = [row[0] for row in exact.ends(matrix, [{0}, {30}])]
    error = max(map(exact.distance, result.value, chance))
    assert error <= result.certificate.residual
    groups = persistent_groups(ended)
    limit = limiting_distribution(ended, groups, throw=False)
    share = [float(weight) for weight in limit.weights]
    first = sum(chance, exact.rational(0)) / len(chance)
    both = exact.distance(share[0], first) + exact.distance(share[1], 1 - first)
    assert both <= limit.certificate.residual + 1e-15


def test_error_of_a_long_line_is_as_stated():
    cells = 3000
    result = absorption_times(chain := Chain.from_scipy(open_line(cells)), persistent_groups(chain))
    expected = steps_on_open_line(cells)
    error = np.abs(np.asarray(result.value) / expected - 1).max()
    assert error <= result.certificate.residual < 1e-6


@pytest.mark.parametrize("up", [0.1, 0.02])
def test_times_up_a_line_of_30_cells_have_all_their_digits(up):
    matrix = birth_and_death(np.full(29, up), np.full(29, 1 - up - 0.05))
    result = hitting_times(Chain.from_scipy(matrix), 29)
    assert float(result.value[0]) > 1e24
    assert exact.relative(result.value, exact.times(matrix, 29)) < 1e-13
    assert result.certificate.residual < 1e-10


def test_times_up_a_line_of_300_cells_equal_their_recurrence_in_rational_numbers():
    matrix = birth_and_death(np.full(299, 0.1), np.full(299, 0.8))
    steps, expected = Fraction(0), [Fraction(0)]
    # The mean time from a cell to the next one follows from that of the cell before.
    for cell in range(299):
        down = Fraction(matrix[cell, cell - 1]) if cell else Fraction(0)
        steps = (1 + down * steps) / Fraction(matrix[cell, cell + 1])
        expected = [time + steps for time in expected] + [Fraction(0)]
    result = hitting_times(Chain.from_scipy(matrix), 299)
    assert float(result.value[0]) > 1e270
    errors = [
        abs(float(Fraction(float(x)) / y - 1))
        for x, y in zip(result.value[:-1], expected, strict=False)
    ]
    assert max(errors) < 1e-12
    assert result.certificate.residual < 1e-6


def test_kmr_chain_of_28_states_has_its_times():
    """In each period, 27 players choose the best reply to the last one, and err once in 100."""
    players, err = 27, 0.01
    number = np.arange(players + 1)
    by_chance = np.array([math.comb(players, k) * err**k * (1 - err) ** (27 - k) for k in number])
    matrix = np.where((number >= 10)[:, None], by_chance[::-1], by_chance)
    chain = Chain.from_scipy(matrix / matrix.sum(axis=1, keepdims=True))
    matrix = chain.to_scipy().toarray()
    among = np.asarray(hitting_matrix(chain).value)
    for target in (0, players):
        expected = exact.times(matrix, target)
        result = hitting_times(chain, target)
        assert exact.relative(result.value, expected) <= result.certificate.residual < 1e-10
        assert exact.relative(among[:, target], expected) < 1e-12
    assert among[0, players] > 1e13


@pytest.mark.parametrize("seed", range(20))
def test_mean_first_arrivals_at_nearly_decomposable_chains_are_as_stated(seed):
    draw = np.random.default_rng(seed)
    matrix = clusters(draw, (2, 2) if seed % 2 else (3, 2), 10.0 ** -draw.uniform(3, 60))
    chain, robots = Chain.from_scipy(matrix), 3 if len(matrix) == 4 else 2
    cells = range(1, len(matrix))
    expected = exact.first_arrivals(matrix, robots, 0)
    for start in (tuple(draw.choice(cells, robots)) for _ in range(3)):
        result = mean_first_arrival([chain] * robots, list(start), 0)
        error = exact.relative(result.value, [expected[start]])
        assert error <= result.certificate.residual < 1e-9
        assert error < 1e-13
    different = list(itertools.permutations(cells, robots))
    mean = sum((expected[start] for start in different), exact.rational(0)) / len(different)
    result = mean_first_arrival([chain] * robots, Distinct(list(cells)), 0)
    assert exact.relative(result.value, [mean]) <= result.certificate.residual < 1e-9


@pytest.mark.parametrize("seed", range(20))
def test_conditional_times_have_their_digits_if_arriving_is_hardly_possible(seed):
    """Probabilities of arriving are down to 1e-600, and products with them even less."""
    draw = np.random.default_rng(seed)
    sizes = draw.integers(2, 5, draw.integers(2, 5))
    matrix = sum(clusters(draw, sizes, 10.0 ** -draw.uniform(50, 200)) for _ in range(3)) / 3
    target, other = (int(cell) for cell in draw.choice(len(matrix), 2, replace=False))
    chain = Chain.from_scipy(stopped(matrix, [target, other]))
    expected = exact.conditional_times(matrix, {target}, {other})
    result = conditional_hitting_times(chain, target)
    found = np.asarray(result.value)[list(expected)]
    assert exact.relative(found, expected.values()) <= result.certificate.residual < 1e-6
    assert exact.relative(found, expected.values()) < 1e-12
    model = DecisionModel.of([chain, chain], np.zeros((2, len(matrix))))
    path = stochastic_shortest_path(model, target, throw=False)
    found = np.asarray(path.conditional_time)[list(expected)]
    assert exact.relative(found, expected.values()) <= path.certificate.residual


@pytest.mark.parametrize("up", [0.1, 0.01, 0.4])
@pytest.mark.parametrize("cells", [12, 331, 401, 1201])
def test_gamblers_who_win_are_as_quick_as_the_bank(cells, up):
    """The walk that wins has exchanged odds, so its time has a closed form (h-transform)."""
    matrix = scipy.sparse.diags_array(
        [np.full(cells - 1, 1 - up), np.full(cells - 1, up)], offsets=[-1, 1], format="lil"
    )
    matrix[[0, -1]] = 0
    matrix[0, 0] = matrix[-1, -1] = 1
    result = conditional_hitting_times(Chain.from_scipy(matrix), cells - 1)
    fortune = np.arange(1, cells)
    odds = (up / (1 - up)) ** fortune
    mean = fortune * (1 + odds) / (1 - odds) / (1 - 2 * up)
    np.testing.assert_allclose(result.value[1:], mean[-1] - mean, rtol=1e-12)
    assert result.value[0] == np.inf
    assert result.certificate.residual < 1e-7


def test_times_near_the_range_of_floats_are_exact():
    matrix = np.array([[1, 1e-300, 0], [0.5, 0.25, 0.25], [0, 0, 1]])
    result = hitting_times(Chain.from_scipy(matrix), 2)
    assert exact.relative(result.value, exact.times(matrix, 2)) < 1e-15
    assert result.certificate.outcome is Outcome.CONVERGED


@pytest.mark.parametrize("rare", [1e-4, 1e-7, 1e-10, 1e-13])
def test_mean_first_arrivals_by_steps_state_their_rounding(rare, monkeypatch):
    monkeypatch.setattr(mean_arrival, "_JOINT", 0)
    e = rare
    matrix = np.array(
        [[0.5 - e, 0.5, e, 0], [0.5, 0.5, 0, 0], [0, e, 0.5 - e, 0.5], [0, 0, 0.5, 0.5]]
    )
    # A row that lacks 1e-13 is rounded, and does not lead out of the space.
    matrix[1, 0] -= 1e-13
    chain = Chain.from_scipy(matrix)
    result = mean_first_arrival([chain, chain], [0, 1], 3, throw=False)
    error = exact.relative(result.value, [exact.first_arrivals(matrix, 2, 3)[0, 1]])
    assert error <= result.certificate.residual
    assert (result.certificate.outcome is Outcome.CONVERGED) == (rare > 1e-6)


def test_robots_that_are_lost_do_not_end_the_race():
    """The first robot stays in a trap forever with probability 2/3; the second one arrives."""
    e = 2.0**-43
    matrix = np.array([[1 - 3 * e, e, 2 * e, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, e, 0, 1 - e]])
    chain = Chain.from_scipy(matrix)
    # Until one robot steps, each steps with the rates 3 e and e; then the other one goes on.
    both = 4 * e - 3 * e * e
    trapped = 2 * e * (1 - e) / both
    for result in (
        mean_first_arrival([chain, chain], [0, 3], 1),
        mean_first_arrival([chain, chain], Distinct([0, 3]), 1),
    ):
        assert result.value == pytest.approx(1 / both + trapped / e, rel=1e-13)
        assert result.certificate.residual < 1e-10


@pytest.mark.parametrize("rare", [1e-12, 1e-16, 1e-60, 1e-200])
def test_exits_of_3_to_1_have_their_odds_however_rare_they_are(rare):
    draw = np.random.default_rng(1)
    cells = 7
    matrix = np.eye(cells + 2)
    matrix[:cells, :cells] = draw.dirichlet(np.ones(cells), cells)
    matrix[cells - 1, cells - 1] -= rare
    matrix[cells - 1, cells:] = 0.75 * rare, 0.25 * rare
    chain = Chain.from_scipy(matrix)
    groups = persistent_groups(chain)
    model = DecisionModel.of([chain, chain], np.zeros((2, cells + 2)))
    path = stochastic_shortest_path(model, cells)
    certain = stochastic_shortest_path(model, [cells, cells + 1])
    odds = (
        arrival_probabilities(chain, cells),
        absorption_probabilities(chain, groups),
    )
    for value in (odds[0].value, odds[1].value[0], path.probability):
        np.testing.assert_allclose(value[:cells], 0.75, rtol=4e-16)
    weights = limiting_distribution(chain, groups).weights
    np.testing.assert_allclose(weights, [(7 * 0.75 + 1) / 9, (7 * 0.25 + 1) / 9], rtol=1e-15)
    expected = [row[-1] for row in exact.ends(matrix, [{cells}, {cells + 1}])]
    for time in (
        absorption_times(chain, groups).value,
        certain.time,
        hitting_times(chain, [cells, cells + 1]).value,
    ):
        assert exact.relative(time, expected) < 1e-14
    # Both exits are taken from one cell, so the condition does not change the time.
    for time in (conditional_hitting_times(chain, cells).value, path.conditional_time):
        assert exact.relative(time[:cells], expected[:cells]) < 1e-14
    assert certain.probability[:cells].tolist() == [1] * cells


@pytest.mark.parametrize("rare", [2.0**-20, 2.0**-30, 2.0**-38])
def test_rare_steps_off_the_space_have_all_their_digits(rare):
    matrix = np.array([[0.3, 0.7], [0.45, 0.55 - rare]])
    chain = Chain.from_scipy(matrix)
    whole = np.eye(3)
    whole[:2, :2] = matrix
    # 1 minus the stored probabilities, in exact numbers.
    left = exact.rational(1) - exact.rational(matrix[1, 0]) - exact.rational(matrix[1, 1])
    whole[1, 2] = float(left.p) / float(left.q)
    assert exact.relative(chain.leaving[1], [left]) < 1e-15
    result = absorption_times(chain, persistent_groups(chain))
    expected = [row[-1] for row in exact.ends(whole, [{2}])]
    assert exact.relative(result.value, expected[:2]) < 1e-15


def test_times_beyond_the_range_of_floats_are_infinite_and_refused():
    for matrix in (
        np.array([[1, 1e-320], [0.5, 0.5]]),
        np.array([[1, 1e-200, 0], [1, 0, 1e-200], [0, 1, 0]]),
    ):
        chain = Chain.from_scipy(matrix)
        target = len(matrix) - 1
        result = hitting_times(chain, target, throw=False)
        assert result.value[0] == np.inf
        assert result.certificate.residual == np.inf
        with pytest.raises(RuntimeError, match="hitting_times: the residual stayed above"):
            hitting_times(chain, target)


def test_matrices_of_rare_chains_are_certified():
    matrix = clusters(np.random.default_rng(5), (4, 5), 1e-12)
    chain = Chain.from_scipy(matrix)
    there = [exact.times(matrix, target) for target in range(9)]
    both = [there[j][i] + there[i][j] for i in range(9) for j in range(9)]
    assert exact.relative(commute_times(chain).value, both) < 1e-14
    share = np.asarray(limiting_distribution(chain, persistent_groups(chain)).value)
    by_cell = [float(there[j][0].p) / float(there[j][0].q) for j in range(9)]
    assert kemeny_constant(chain) == pytest.approx(share @ by_cell, rel=1e-10)
