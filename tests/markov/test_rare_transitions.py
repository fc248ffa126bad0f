"""Visits, exits, committors, fluxes, quasi-stationary distributions and passage times.

The truth is in exact rationals, in closed forms, in dense formulas of transition path theory, or
simulated.
"""

import itertools
import math
import time
from fractions import Fraction

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.sparse
from oracles import exact_chains as exact
from random_chains import birth_and_death

from jaxcell import examples, markov
from jaxcell.mapping import Chain
from jaxcell.markov.solving import solve


def walk_with_odds(cells, up):
    """A walk up or down a line of cells, which stays with the rest of the probability."""
    return birth_and_death(np.full(cells - 1, up), np.full(cells - 1, 0.9 - up))


def random_matrix(seed, cells=14, sink=0.0):
    draw = np.random.default_rng(seed)
    matrix = draw.dirichlet(np.full(cells, 0.3), cells)
    matrix[np.arange(cells), (np.arange(cells) + 1) % cells] += 0.2
    matrix /= matrix.sum(axis=1, keepdims=True)
    return matrix * (1 - sink * draw.random((cells, 1)))


def dense_paths(matrix, source, target):
    """Transition path theory with dense matrices: `pi`, both committors and the flux."""
    cells = len(matrix)
    pi = np.linalg.solve(np.eye(cells) - matrix.T + 1, np.ones(cells))
    back = matrix.T * pi / pi[:, None]

    def to(chance, end, other):
        among = [i for i in range(cells) if i not in end and i not in other]
        value = np.isin(np.arange(cells), end).astype(float)
        system = np.eye(len(among)) - chance[np.ix_(among, among)]
        value[among] = np.linalg.solve(system, chance[np.ix_(among, end)].sum(axis=1))
        return value

    forward, backward = to(matrix, target, source), to(back, source, target)
    flux = (pi * backward)[:, None] * matrix * forward
    np.fill_diagonal(flux, 0)
    return pi, forward, backward, flux


def by_pairs(chain, values):
    table = np.zeros((chain.cells, chain.cells))
    cells = np.broadcast_to(np.arange(chain.cells), chain.image.shape)
    np.add.at(table, (cells, np.asarray(chain.image)), np.asarray(values))
    return table


@pytest.mark.parametrize("seed", range(5))
def test_committors_and_fluxes_equal_dense_transition_path_theory(seed):
    matrix = random_matrix(seed)
    chain, source, target = Chain.from_scipy(matrix), [0, 3], [5, 9]
    pi, forward, backward, flux = dense_paths(matrix, source, target)
    np.testing.assert_allclose(markov.committor(chain, source, target).value, forward, rtol=1e-11)
    found = markov.committor(chain, source, target, backward=True)
    np.testing.assert_allclose(found.value, backward, rtol=1e-11)
    assert found.certificate.residual < 1e-10
    result = markov.reactive_flux(chain, source, target)
    np.testing.assert_allclose(by_pairs(chain, result.gross), flux, rtol=1e-10, atol=1e-18)
    net = np.maximum(flux - flux.T, 0)
    np.testing.assert_allclose(by_pairs(chain, result.net), net, rtol=1e-9, atol=1e-16)
    assert result.rate == pytest.approx(flux[source].sum(), rel=1e-11)
    assert result.time == pytest.approx(pi @ backward / flux[source].sum(), rel=1e-11)
    between = np.isin(range(14), source + target, invert=True)
    density = pi * backward * forward * between
    np.testing.assert_allclose(result.density, density, rtol=1e-10, atol=1e-18)
    assert result.duration == pytest.approx(1 + density.sum() / flux[source].sum(), rel=1e-10)


def test_branches_with_the_same_image_share_the_net_flux():
    image = np.array([[1, 2, 1], [1, 0, 2], [0, 2, 2]])
    probability = np.array([[0.2, 0.3, 0.5], [0.3, 0.4, 0.25], [0.5, 0.3, 0.25]])
    chain = Chain(image, probability)
    result = markov.reactive_flux(chain, 0, 2)
    flux = dense_paths(chain.to_scipy().toarray(), [0], [2])[3]
    np.testing.assert_allclose(by_pairs(chain, result.gross), flux, atol=1e-16)
    np.testing.assert_allclose(
        by_pairs(chain, result.net), np.maximum(flux - flux.T, 0), atol=1e-16
    )


@pytest.mark.parametrize("rare", [1e-6, 1e-20, 1e-100])
def test_rate_of_clusters_with_a_rare_coupling_keeps_its_digits(rare):
    """Two pairs of cells; the first pair is left with the coupling, the second with its half."""
    matrix = np.array(
        [[0.5, 0.5, 0, 0], [0.5, 0.5, rare, 0], [0, rare / 2, 0.5, 0.5], [0, 0, 0.5, 0.5]]
    )
    chain = Chain.from_scipy(matrix / np.maximum(matrix.sum(axis=1, keepdims=True), 1))
    dense = chain.to_scipy().toarray()
    result = markov.reactive_flux(chain, 0, 3)
    # From cell 0 to cell 3 and back, in exact numbers.
    there, back = exact.times(dense, 3)[0], exact.times(dense, 0)[3]
    per_cycle = Fraction(int((there + back).p), int((there + back).q))
    assert result.rate * float(per_cycle) == pytest.approx(1, rel=1e-13)
    assert result.time == pytest.approx(float(Fraction(int(there.p), int(there.q))), rel=1e-13)
    assert result.certificate.residual < 1e-10


def test_periodic_chains_have_fluxes_and_no_time_reversal_is_needed():
    ring = np.roll(np.eye(6), 1, axis=1)
    result = markov.reactive_flux(ring, 0, 3)
    assert (result.rate, result.duration, result.time) == pytest.approx((1 / 6, 3, 3))
    np.testing.assert_allclose(result.net[0], [1 / 6, 1 / 6, 1 / 6, 0, 0, 0])
    back = markov.committor(ring, 0, 3, backward=True)
    np.testing.assert_allclose(back.value, [1, 1, 1, 0, 0, 0])


def test_sets_of_different_groups_have_no_flux_and_transient_cells_no_past():
    chain = examples.ruin()
    result = markov.reactive_flux(chain, 0, 3)
    assert result.rate == 0
    assert math.isnan(result.duration)
    back = markov.committor(chain, 0, 3, backward=True).value
    np.testing.assert_array_equal(back, [1, np.nan, np.nan, 0])
    with pytest.raises(ValueError, match="no persistent group"):
        markov.reactive_flux(0.5 * chain.to_scipy().toarray(), 0, 3)
    with pytest.raises(ValueError, match="both have cell 1"):
        markov.committor(chain, [0, 1], [1, 2])


@pytest.mark.parametrize("up", [0.1, 0.4])
def test_committor_of_a_birth_death_walk_is_that_of_the_gambler(up):
    matrix = walk_with_odds(60, up)
    odds = Fraction(0.9 - up) / Fraction(matrix[0, 1])
    chance = [(1 - odds**k) / (1 - odds**59) for k in range(60)]
    found = np.asarray(markov.committor(matrix, 0, 59).value)
    np.testing.assert_allclose(found, [float(p) for p in chance], rtol=1e-12)
    # The walk is reversible, so that it looks back as it looks ahead.
    back = np.asarray(markov.committor(matrix, 0, 59, backward=True).value)
    np.testing.assert_allclose(back, [float(1 - p) for p in chance], rtol=1e-11, atol=1e-30)


@pytest.mark.parametrize(("cells", "up"), [(201, 0.3), (301, 0.3), (301, 0.125), (1201, 0.4)])
def test_paths_up_a_long_line_have_their_digits(cells, up):
    """The long-run share of the highest cells is down to 1e-233."""
    odds = 0.75 / 0.125 if up == 0.125 else (0.9 - up) / up
    number, steps = np.arange(cells), cells - 1
    matrix = birth_and_death(np.full(steps, up), np.full(steps, odds * up))
    forward = (odds ** (number - steps) - odds**-steps) / (1 - odds**-steps)
    back = markov.committor(matrix, 0, steps, backward=True)
    np.testing.assert_allclose(back.value, 1 - forward, atol=1e-13)
    assert 0 <= np.min(back.value) <= np.max(back.value) <= 1
    share = odds**-number / (odds**-number).sum()
    rate, density = share[0] * up * forward[1], share * forward * (1 - forward)
    result = markov.reactive_flux(matrix, 0, steps)
    np.testing.assert_allclose(result.density, density, rtol=1e-12, atol=1e-300)
    assert result.rate == pytest.approx(rate, rel=1e-12)
    assert result.duration == pytest.approx(1 + density.sum() / rate, rel=1e-12)


def test_paths_between_two_wells_are_refused_or_right():
    """The ends of the walk have shares below 1e-308."""
    x = np.linspace(-2, 2, 250)
    ratio = np.exp(-np.diff((x**2 - 1) ** 2 / 4) / 0.07**2)
    matrix = birth_and_death(0.4 * ratio / (ratio + 1 / ratio), 0.4 / ratio / (ratio + 1 / ratio))
    source, target = 62, 187
    back = np.asarray(markov.committor(matrix, source, target, backward=True).value)
    known = ~np.isnan(back)
    assert known[10:240].all()
    assert not known[0]
    ahead = np.asarray(markov.committor(matrix, source, target).value)
    np.testing.assert_allclose(back[known], 1 - ahead[known], atol=1e-12)


def test_chains_that_are_not_eliminated_say_that_rare_cells_have_no_digits(monkeypatch):
    monkeypatch.setattr(solve, "LIMITS", solve.Limits(small=0, elimination=0.0))
    matrix = birth_and_death(np.full(300, 0.3), np.full(300, 0.6))
    back = markov.committor(matrix, 0, 300, backward=True, throw=False)
    assert back.certificate.residual > 1
    with pytest.raises(RuntimeError, match="reactive_flux: the residual stayed above"):
        markov.reactive_flux(matrix, 0, 300)
    fair = birth_and_death(np.full(300, 0.4), np.full(300, 0.4))
    back = markov.committor(fair, 0, 300, backward=True)
    np.testing.assert_allclose(back.value, 1 - np.arange(301) / 300, atol=1e-10)
    result = markov.reactive_flux(fair, 0, 300)
    assert result.rate == pytest.approx(0.4 / 301 / 300, rel=1e-9)


def test_flux_across_a_hub_takes_as_long_as_its_steps():
    leaves = 1500
    matrix = scipy.sparse.lil_array((leaves + 1, leaves + 1))
    matrix[0, 1:] = 1 / leaves
    matrix[1:, 0] = 0.5
    matrix.setdiag(np.append(0, np.full(leaves, 0.5)))
    begin = time.process_time()
    result = markov.reactive_flux(matrix.tocsr(), 1, 2)
    assert time.process_time() - begin < 15
    assert result.rate == pytest.approx(1 / 3 / leaves / 4 * 2, rel=1e-12)


@pytest.mark.parametrize("sink", [0.0, 0.3])
@pytest.mark.parametrize("seed", range(3))
def test_visits_and_exits_are_rows_of_the_fundamental_matrix(seed, sink):
    matrix = random_matrix(seed, sink=sink)
    within = np.arange(14) < 9
    fundamental = np.linalg.inv(np.eye(9) - matrix[:9, :9])
    start = np.random.default_rng(seed).dirichlet(np.ones(14))
    found = markov.visits(matrix, start, within)
    expected = np.append(start[:9] @ fundamental, np.zeros(5))
    np.testing.assert_allclose(found.value, expected, rtol=1e-12)
    error = np.abs(np.asarray(found.value) - expected).sum() / expected.sum()
    assert error <= found.certificate.residual + 1e-15 < 1e-10
    exits = markov.exit_distribution(matrix, start, within)
    last = expected[:9] * (1 - matrix[:9, :9].sum(axis=1))
    np.testing.assert_allclose(exits.last[:9], last, rtol=1e-11)
    np.testing.assert_allclose(exits.first[9:], start[9:] + expected[:9] @ matrix[:9, 9:])
    assert exits.last.sum() == pytest.approx(start[:9].sum(), rel=1e-12)


def test_visits_without_end_are_infinite_and_unreached_cells_have_none():
    # Cell 0 leads to 1 and 2; 1 stays forever; 2 leaves the space; 3 is not reached, and closed.
    matrix = np.diag([0.0, 1.0, 0.5, 1.0])
    matrix[0, 1:3] = 0.25, 0.75
    assert markov.visits(matrix, 0, range(4)).value.tolist() == [1, np.inf, 1.5, 0]
    assert markov.visits(matrix, 0).value.tolist() == [1, 0, 1.5, 0]
    exits = markov.exit_distribution(matrix, 0, range(4))
    assert exits.last.tolist() == [0, 0, 0.75, 0]
    assert exits.first.tolist() == [0, 0, 0, 0]


@pytest.mark.parametrize("sets", [1e-3, 1e-20, 1e-150])
def test_sum_of_visits_is_the_time_also_in_sets_that_are_hardly_left(sets):
    matrix = np.array([[0.5, 0.5, 0], [0.25, 0.75, sets], [0, 0, 1]])
    found = markov.visits(Chain.from_scipy(matrix / matrix.sum(axis=1, keepdims=True)), 0)
    exact_time = exact.times(matrix / matrix.sum(axis=1, keepdims=True), 2)[0]
    assert exact.relative(float(found.value.sum()), [exact_time]) < 1e-14


@pytest.mark.parametrize("cells", [10, 190, 700])
def test_quasi_stationary_distribution_of_an_open_line_is_a_sine(cells):
    matrix = np.diag(np.full(cells - 1, 0.5), 1) + np.diag(np.full(cells - 1, 0.5), -1)
    found = markov.quasi_stationary(matrix, range(cells))
    sine = np.sin(np.pi * np.arange(1, cells + 1) / (cells + 1))
    leaving = 2 * np.sin(np.pi / (cells + 1) / 2) ** 2
    np.testing.assert_allclose(found.value, sine / sine.sum(), rtol=1e-11)
    assert abs(found.leaving / leaving - 1) <= found.certificate.residual + 1e-15 < 1e-8


@pytest.mark.parametrize("seed", range(4))
def test_quasi_stationary_distribution_is_the_leading_left_eigenvector(seed):
    matrix = random_matrix(seed, sink=0.2)
    found = markov.quasi_stationary(matrix, range(10))
    values, vectors = np.linalg.eig(matrix[:10, :10].T)
    first = values.real.argmax()
    assert found.leaving == pytest.approx(1 - values[first].real, rel=1e-11)
    vector = vectors[:, first].real
    np.testing.assert_allclose(found.value[:10], vector / vector.sum(), rtol=1e-10)
    assert found.value[10:].tolist() == [0] * 4


@pytest.mark.parametrize("rare", [1e-8, 1e-20, 1e-200])
def test_leaving_of_a_rarely_left_set_has_its_digits(rare):
    """For a set of two cells, the probability of leaving is a root of a quadratic equation."""
    matrix = np.array([[0.5, 0.5, 0], [0.25, 0.75 - rare, rare], [0, 0, 1]])
    found = markov.quasi_stationary(Chain.from_scipy(matrix), [0, 1])
    # (1/2 - l) (1/4 + rare - l) = 1/8 has the small root 2 rare / 3, up to rare^2.
    assert found.leaving == pytest.approx(2 * rare / 3, rel=1e-7 if rare == 1e-8 else 1e-14)
    assert found.certificate.residual < 1e-11


def test_two_wells_that_are_left_with_similar_rates_are_told_apart():
    wells = np.array([[1 - 2e-20, 1e-20, 1e-20], [1e-21, 1 - 3e-21, 2e-21], [0, 0, 1]])
    found = markov.quasi_stationary(Chain.from_scipy(wells), [0, 1])
    # In units of 1e-21: leaving is the smaller eigenvalue of [[20, -10], [-1, 3]].
    least = (23 - math.sqrt(23**2 - 4 * (60 - 10))) / 2
    assert found.leaving == pytest.approx(least * 1e-21, rel=1e-13)


@pytest.mark.parametrize("rare", [1e-6, 1e-20])
def test_slowest_of_two_large_clusters_is_found(rare):
    """Two clusters of 120 cells; mass goes from the second to the first, and from there out."""
    draw = np.random.default_rng(3)
    matrix = np.zeros((241, 241))
    for k in (0, 120):
        matrix[k : k + 120, k : k + 120] = draw.dirichlet(np.ones(120), 120)
    matrix[120, 0], matrix[0, 240], matrix[240, 240] = 0.9 * rare, rare, 1
    chain = Chain.from_scipy(matrix / matrix.sum(axis=1, keepdims=True))
    leaving = []
    for k in (0, 120):
        inside = matrix[k : k + 120, k : k + 120]
        pi = np.linalg.solve(np.eye(120) - inside.T + 1, np.ones(120))
        leaving.append(pi[0] * (rare if k == 0 else 0.9 * rare))
    slowest = int(np.argmin(leaving))
    found = markov.quasi_stationary(chain, range(240))
    # Sums over many steps between the clusters change the least by the order of the coupling.
    assert found.leaving == pytest.approx(leaving[slowest], rel=max(10 * rare, 1e-12))
    assert found.value[:120].sum() == pytest.approx(
        1 if slowest == 0 else leaving[1] / leaving[0], rel=max(100 * rare, 1e-10)
    )


def test_parts_of_a_set_that_lead_only_one_way():
    # Cells 0 and 1 are slower, and lead to 2 and 3; cell 4 leads to 0, and stays for .2.
    matrix = np.zeros((6, 6))
    matrix[0, :3] = 0.6, 0.39, 0.01
    matrix[1, :2] = 0.5, 0.5
    matrix[2, 2:4] = 0.5, 0.2
    matrix[3, 2:4] = 0.1, 0.5
    matrix[4, [0, 4, 5]] = 0.7, 0.2, 0.1
    found = markov.quasi_stationary(matrix, range(5))
    values, vectors = np.linalg.eig(matrix[:5, :5].T)
    first = values.real.argmax()
    vector = vectors[:, first].real / vectors[:, first].real.sum()
    np.testing.assert_allclose(found.value[:5], vector, atol=1e-14)
    assert found.value[4] == 0
    assert found.leaving == pytest.approx(1 - values[first].real, rel=1e-12)
    with pytest.raises(ValueError, match="never left from cell 0"):
        markov.quasi_stationary(np.eye(3), [0, 1])


@pytest.mark.parametrize("seed", range(3))
def test_variances_equal_moments_in_rational_numbers(seed):
    matrix = random_matrix(seed, cells=7)
    result = markov.passage_time_variance(matrix, 3)
    time = exact.times(matrix, 3)
    inside = [i for i in range(7) if i != 3]
    chance = [[exact.rational(p) for p in row] for row in matrix]
    for i in range(7):
        chance[i][i] = 1 - sum((p for j, p in enumerate(chance[i]) if j != i), exact.rational(0))
    system = [[int(i == j) - chance[i][j] for j in inside] for i in inside]
    right = [[2 * time[i] - 1] for i in inside]
    second = [row[0] for row in exact.solve(system, right)]
    truth = [s - time[i] ** 2 for i, s in zip(inside, second, strict=True)]
    assert exact.relative(np.asarray(result.value)[inside], truth) < 1e-13
    assert result.certificate.residual < 1e-10


def test_variances_of_certain_infinite_and_geometric_times():
    ring = np.roll(np.eye(5), 1, axis=1)
    assert markov.passage_time_variance(ring, 2).value.tolist() == [0] * 5
    assert markov.passage_time_variance(examples.ruin(), 3).value.tolist() == [np.inf] * 3 + [0]
    for rare in (1e-3, 1e-12, 1e-60, 1e-150):
        matrix = np.array([[1 - rare, rare], [0, 1]])
        stored = matrix[0, 1]
        value = markov.passage_time_variance(Chain.from_scipy(matrix), 1).value[0]
        assert value == pytest.approx((1 - stored) / stored / stored, rel=1e-12)


@pytest.mark.parametrize("rare", [0.25, 1e-14, 1e-100])
def test_quantiles_of_geometric_times(rare):
    matrix = np.array([[1 - rare, rare], [0, 1]])
    levels = np.array([1e-9, 0.25, 0.5, 0.99])
    found = markov.passage_quantiles(Chain.from_scipy(matrix), 0, 1, levels)
    expected = np.ceil(np.log1p(-levels) / math.log1p(-rare))
    np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_quantiles_of_a_line_uphill_are_those_of_an_exponential_distribution():
    """In 64 bits, the time over its mean of 1e231 steps is exponential."""
    matrix, levels = birth_and_death(np.full(300, 0.125), np.full(300, 0.75)), [0.05, 0.5, 0.95]
    mean = markov.hitting_times(matrix, 300).value[0]
    begin = time.process_time()
    found = markov.passage_quantiles(matrix, 0, 300, levels)
    assert time.process_time() - begin < 10
    np.testing.assert_allclose(found, -np.log1p(-np.array(levels)) * mean, rtol=1e-11)


def test_numbers_out_of_range_say_what_is_expected():
    with pytest.raises(ValueError, match="levels: expected numbers above 0 and below 1"):
        markov.passage_quantiles(examples.ruin(), 1, 3, [0.0, 1.0])
    with pytest.raises(ValueError, match="target: cell 0 stands 2 times; a mask has booleans"):
        markov.hitting_times(examples.walk(), [0, 0, 1])
    matrix = np.array([[1, 1e-200], [0, 1]])
    with pytest.raises(RuntimeError, match="above 1e308, too large for 64 bits"):
        markov.passage_time_variance(matrix, 1)
    assert markov.passage_time_variance(matrix, 1, throw=False).value.tolist() == [np.inf, 0]


def test_quantiles_are_those_of_the_law_step_by_step(monkeypatch):
    matrix = random_matrix(4, sink=0.01)
    law = np.cumsum(np.asarray(markov.first_passage(matrix, 2, 7, 2000)))
    levels = np.array([0.01, 0.2, 0.5, 0.8])
    expected = [int(np.argmax(law >= level)) for level in levels]
    assert markov.passage_quantiles(matrix, 2, 7, levels).tolist() == expected
    assert markov.passage_quantiles(matrix, 2, 7, [0.9999]).tolist() == [np.inf]
    monkeypatch.setattr(markov.passage_times, "_DENSE", 5)
    assert markov.passage_quantiles(matrix, 2, 7, levels).tolist() == expected
    assert markov.passage_quantiles(matrix, 2, 7, [0.9999]).tolist() == [np.inf]
    # Above the barrier of a line, the last part of the time is geometric.
    line = walk_with_odds(16, 0.3)
    steps = markov.passage_quantiles(line, 0, 15, [0.01, 0.5, 0.99])
    monkeypatch.setattr(markov.passage_times, "_DENSE", 1000)
    np.testing.assert_allclose(steps, markov.passage_quantiles(line, 0, 15, [0.01, 0.5, 0.99]))


def test_most_probable_path_has_the_largest_product():
    draw = np.random.default_rng(0)
    for _ in range(20):
        matrix = random_matrix(draw, cells=6) * (draw.random((6, 6)) < 0.6)
        matrix[5, :] = 0
        # Products of the best paths of at most n steps, without logarithms.
        best = (np.arange(6) == 5).astype(float)
        for _ in range(6):
            best = np.maximum(best, (matrix * best).max(axis=1))
        if best[[0, 1]].max() == 0:
            with pytest.raises(ValueError, match="no path leads to it"):
                markov.most_probable_path(matrix, [0, 1], 5)
            continue
        path, log_probability = markov.most_probable_path(matrix, [0, 1], 5)
        product = np.prod([matrix[i, j] for i, j in itertools.pairwise(path)])
        assert math.exp(log_probability) == pytest.approx(product, rel=1e-12)
        assert product == pytest.approx(best[[0, 1]].max(), rel=1e-12)
    ring = np.roll(np.eye(5), 1, axis=1)
    assert markov.most_probable_path(ring, 1, 0)[0].tolist() == [1, 2, 3, 4, 0]
    path, log_probability = markov.most_probable_path(ring, 2, [1, 2])
    assert (path.tolist(), log_probability) == ([2], 0)


WITHIN, SOURCE, TARGET = np.arange(14) < 9, [0, 3], [5, 9]
DIFFERENTIABLE = {
    "visits": lambda chain: markov.visits(chain, 2, WITHIN).value,
    "exits": lambda chain: markov.exit_distribution(chain, 2, WITHIN).first,
    "committor": lambda chain: markov.committor(chain, SOURCE, TARGET).value,
    "backward": lambda chain: markov.committor(chain, SOURCE, TARGET, backward=True).value,
    "net": lambda chain: markov.reactive_flux(chain, SOURCE, TARGET).net,
    "time": lambda chain: markov.reactive_flux(chain, SOURCE, TARGET).time,
    "variance": lambda chain: markov.passage_time_variance(chain, 4).value,
    "quasi": lambda chain: markov.quasi_stationary(chain, WITHIN).value,
    "leaving": lambda chain: markov.quasi_stationary(chain, WITHIN).leaving,
}


@pytest.mark.parametrize("name", DIFFERENTIABLE)
def test_derivatives_equal_central_differences(name):
    chain = Chain.from_scipy(random_matrix(1))
    of_chain = DIFFERENTIABLE[name]
    draw = np.random.default_rng(2)
    probability = np.asarray(chain.probability)
    change = probability * draw.normal(size=probability.shape) / 4
    change -= probability * change.sum(axis=0)

    def value(x):
        return of_chain(Chain(chain.image, probability + x * change))

    step = 1e-5
    expected = (np.asarray(value(step)) - np.asarray(value(-step))) / (2 * step)
    now, found = jax.jvp(value, (0.0,), (1.0,))
    np.testing.assert_allclose(now, value(0.0), rtol=1e-12)
    np.testing.assert_allclose(found, expected, atol=1e-7 * max(1, np.abs(expected).max()))
    weight = draw.random(np.shape(expected))
    reverse = jax.jit(jax.grad(lambda x: (value(x) * weight).sum()))(0.0)
    assert reverse == pytest.approx((np.asarray(found) * weight).sum(), rel=1e-9)
    many = jax.vmap(value)(np.array([0.0, step]))
    np.testing.assert_allclose(many[1], value(step), rtol=1e-11, atol=1e-16)


@pytest.mark.parametrize(("apart", "link"), [(1e-2, 1e-3), (1e-4, 1e-5)])
def test_derivatives_of_two_parts_that_are_left_almost_equally_fast(apart, link):
    def leaving(link):
        rows = [[0.9 - link, link, 0.1], [link, 0.9 - apart - link, 0.1 + apart], [0, 0, 1]]
        image = np.tile(np.arange(3, dtype=np.int32)[:, None], (1, 3))
        chain = Chain(image, jnp.array(rows, float).T)
        return markov.quasi_stationary(chain, [0, 1]).leaving

    # The larger eigenvalue of the matrix of the two parts is a root of a quadratic equation.
    known = 1 - link / math.hypot(apart / 2, link)
    assert jax.grad(leaving)(link) == pytest.approx(known, rel=1e-9)
