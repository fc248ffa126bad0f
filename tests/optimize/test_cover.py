import itertools
from fractions import Fraction

import numpy as np
import pytest
import scipy.sparse
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays

from jaxcell import optimize
from jaxcell.optimize.cover import greedy_cover, minimum_cover


def families(most_sets, most_elements):
    shape = st.tuples(st.integers(1, most_sets), st.integers(1, most_elements))
    return shape.flatmap(lambda shape: arrays(bool, shape))


def cover_by_sets(sets, choice):
    """Alg. 4.3 with the sets of Python."""
    members = [set(np.flatnonzero(row).tolist()) for row in sets]
    left = set().union(*members)
    chosen, gained = [], []
    while left:
        ranking = sorted(
            (s for s in range(len(members)) if members[s] & left),
            key=lambda s: (-len(members[s] & left), s),
        )
        best = ranking[min(choice, len(ranking) - 1)]
        chosen.append(best)
        gained.append(len(members[best] & left))
        left -= members[best]
    return chosen, gained


def smallest_by_trial(sets):
    seen = sets.any(axis=0)
    for size in range(len(sets) + 1):
        for some in itertools.combinations(range(len(sets)), size):
            if (sets[list(some)].any(axis=0) == seen).all():
                return size
    raise AssertionError


# More elements than a word has bits.
@given(families(12, 200), st.integers(0, 4), st.sampled_from("CF"))
def test_greedy_cover_is_that_of_the_algorithm(sets, choice, order):
    cover = greedy_cover(np.asarray(sets, order=order), choice)
    chosen, gained = cover_by_sets(sets, choice)
    assert cover.chosen.tolist() == chosen
    assert cover.gained.tolist() == gained
    assert (sets[cover.chosen].any(axis=0) == sets.any(axis=0)).all()
    np.testing.assert_array_equal(cover.uncovered, np.flatnonzero(~sets.any(axis=0)))


@given(families(7, 10))
def test_minimum_cover_is_the_smallest_of_all(sets):
    cover = minimum_cover(sets)
    assert (sets[cover.chosen].any(axis=0) == sets.any(axis=0)).all()
    assert cover.chosen.size == cover.bound == smallest_by_trial(sets)
    assert cover.certificate.residual == 0
    np.testing.assert_array_equal(cover.uncovered, np.flatnonzero(~sets.any(axis=0)))


@given(families(25, 25))
def test_greedy_cover_is_within_its_bound(sets):
    harmonic = sum(Fraction(1, k) for k in range(1, int(sets.sum(axis=1).max()) + 1))
    assert greedy_cover(sets).chosen.size <= harmonic * minimum_cover(sets).chosen.size


@pytest.mark.parametrize("shape", [(0, 3), (3, 0), (3, 3)])
@pytest.mark.parametrize("cover", [greedy_cover, minimum_cover])
def test_no_sets_are_chosen_if_none_has_an_element(cover, shape):
    found = cover(np.zeros(shape, bool))
    assert found.chosen.size == 0
    assert found.uncovered.tolist() == list(range(shape[1]))


def test_out_of_time_there_is_a_cover_and_a_bound():
    sets = np.random.default_rng(0).random((150, 150)) < 0.08
    cover = minimum_cover(sets, time_limit=0.0, throw=False)
    assert sets[cover.chosen].any(axis=0).all()
    assert cover.certificate.residual == cover.chosen.size - cover.bound > 0
    with pytest.raises(RuntimeError, match="minimum_cover: the residual stayed above"):
        minimum_cover(sets, time_limit=0.0)


def test_a_negative_choice_is_refused():
    with pytest.raises(ValueError, match=r"choice: expected .* at least 0, got -1"):
        greedy_cover(np.ones((2, 2), bool), -1)


@pytest.mark.parametrize("cover", [optimize.greedy_cover, optimize.minimum_cover])
def test_masks_may_be_lists_but_not_lists_of_elements(cover):
    assert cover([[True, False], [0, 1]]).chosen.tolist() == [0, 1]
    with pytest.raises(ValueError, match="sets: expected an array of True and False, got int"):
        cover([[0, 1], [1, 2]])
    with pytest.raises(ValueError, match="sets: expected an array, got lists of different lengths"):
        cover([[0, 1], [2]])


@given(families(6, 8), st.integers(1, 3))
def test_the_bound_is_not_below_the_best_cover_of_a_size(sets, count):
    cover = optimize.largest_cover(
        scipy.sparse.csr_array(sets * 1.0), count, np.ones(len(sets), bool)
    )
    size = min(count, len(sets))
    best = max(
        sets[list(some)].any(axis=0).sum()
        for some in itertools.combinations(range(len(sets)), size)
    )
    assert best <= cover.bound + 1e-9
    assert cover.gained.sum() >= (1 - np.exp(-1)) * best - 1e-9
    assert sets[cover.chosen].any(axis=0).sum() == cover.gained.sum()
    greedy = greedy_cover(sets)
    assert cover.chosen.tolist() == greedy.chosen[:count].tolist()


def test_sets_with_probabilities_are_expected_to_contain_elements():
    random = np.random.default_rng(0)
    shares = random.random((9, 30)) * (random.random((9, 30)) < 0.4)
    allowed = np.arange(9) != 4

    def expected(some):
        return (1 - np.prod(1 - shares[list(some)], axis=0)).sum()

    cover = optimize.largest_cover(scipy.sparse.csr_array(shares), 3, allowed)
    best = max(map(expected, itertools.combinations(np.flatnonzero(allowed).tolist(), 3)))
    assert expected(cover.chosen) == pytest.approx(cover.gained.sum())
    assert (1 - np.exp(-1)) * best <= cover.gained.sum() <= best <= cover.bound
    assert 4 not in cover.chosen
    with pytest.raises(ValueError, match="count: expected 1 or more, got 0"):
        optimize.largest_cover(scipy.sparse.csr_array(shares), 0, allowed)
