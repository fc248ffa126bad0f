"""Evidence, compared with exact fractions and with the enumeration of all strings."""

import collections
import functools
import itertools
import math
from fractions import Fraction

import numpy as np
import pytest

from jaxcell.automata import Evidence


HALF, WRONG = Fraction(1, 2), Fraction(1, 5)
ORDERS = range(9)


@functools.cache
def estimated(zeros: int, ones: int) -> Fraction:
    """The integral of p**ones (1 - p)**zeros over Jeffreys' prior, by factorials."""
    f, both = math.factorial, zeros + ones
    return Fraction(f(2 * zeros) * f(2 * ones), 4**both * f(zeros) * f(ones) * f(both))


def learned(string: str, order: int) -> Fraction:
    """The probability of a string for a chain of unknown probabilities, after zeros."""
    padded, after = "0" * order + string, collections.defaultdict(collections.Counter)
    for time, observation in enumerate(string):
        after[padded[time : time + order]][observation] += 1
    return math.prod(estimated(count["0"], count["1"]) for count in after.values())


def rival(string: str, expected: list[Fraction]) -> Fraction:
    """The probability of a string for the rival of a map that expects each of its observations."""
    chains = sum(learned(string, order) for order in ORDERS) / len(ORDERS)
    errs = math.prod((1 - WRONG) * p + WRONG * (1 - p) for p in expected)
    return HALF * chains + HALF * errs


def decibans(string: str, expected: list[Fraction]) -> list[float]:
    evidence, found = Evidence(), []
    for observation, probability in zip(string, expected, strict=True):
        evidence.observe(int(observation), float(probability))
        found.append(evidence.decibans)
    return found


def on_the_map(string: str) -> list[Fraction]:
    """The probability of each observation of a robot that bumps mostly at each third step."""
    odds = (Fraction(1, 8), Fraction(1, 30), Fraction(39, 40))
    bumps = [odds[time % 3] for time in range(len(string))]
    return [p if o == "1" else 1 - p for o, p in zip(string, bumps, strict=True)]


@pytest.mark.parametrize("seed", range(6))
def test_evidence_is_the_ratio_of_exact_probabilities(seed):
    rng = np.random.default_rng(seed)
    string = "".join(map(str, rng.integers(0, 2, 40))) + "001" * 12
    expected = [Fraction(int(n), 100) for n in rng.integers(1, 100, len(string))]
    found = decibans(string, expected)
    for length in (1, 2, 9, 25, len(string)):
        ratio = math.prod(expected[:length]) / rival(string[:length], expected[:length])
        exact = 10 * (math.log10(ratio.numerator) - math.log10(ratio.denominator))
        assert found[length - 1] == pytest.approx(exact, abs=1e-9)


def test_each_error_is_at_most_as_probable_as_the_evidence_says():
    on_map, by_rival = collections.Counter(), collections.Counter()
    total = Fraction(0)
    for digits in itertools.product("01", repeat=12):
        string = "".join(digits)
        expected = on_the_map(string)
        path, chance = decibans(string, expected), rival(string, expected)
        total += chance
        for bound in (2, 5, 10):
            on_map[bound] += (min(path) <= -bound) * math.prod(expected)
            by_rival[bound] += (max(path) >= bound) * chance
    assert total == 1
    for bound in (2, 5, 10):
        for error in (on_map[bound], by_rival[bound]):
            assert 0 < error <= 10 ** (-bound / 10)


def test_an_impossible_observation_is_evidence_that_no_later_one_outweighs():
    evidence = Evidence()
    evidence.observe(1, 0.0)
    evidence.observe(0, 1.0)
    assert evidence.decibans == -math.inf


@pytest.mark.parametrize(
    ("expected", "words"), [(1.0, "1.5 times better than"), (0.01, "35 times worse than")]
)
def test_evidence_is_told_as_a_factor(expected, words):
    # After one observation, every chain has the probability 1/2.
    evidence = Evidence()
    evidence.observe(1, expected)
    assert words in evidence.words
