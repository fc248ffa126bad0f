import itertools
import math

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra import numpy as hnp
from scipy.interpolate import BPoly

from jaxcell.base.certificate import Outcome
from jaxcell.patrol.perimeter import (
    Movement,
    Perimeter,
    detection_polynomials,
    hitting_law,
    maximin,
    mean_hitting_times,
)


RING = Perimeter(12, 2, Movement.DCP)


def visits(perimeter, coins):
    """Move each robot on the whole perimeter, and yield the segments of robots after each step."""
    size, movement = perimeter.segments, perimeter.movement
    robots = [(start, 1) for start in range(0, size, perimeter.distance)]
    for coin in coins:
        for k, (place, heading) in enumerate(robots):
            turn = 1 if coin else -1
            ahead = 0 if movement is Movement.DCP and not coin else heading * turn
            robots[k] = (place + ahead) % size, 1 if movement is Movement.BMP else heading * turn
        yield {place for place, _ in robots}


def at(polynomials, p):
    return BPoly(polynomials.T[:, None], [0, 1])(p)


@pytest.mark.parametrize("movement", Movement)
@pytest.mark.parametrize(("segments", "robots"), [(3, 3), (4, 2), (3, 1), (8, 2), (5, 1)])
def test_polynomials_count_all_sequences_of_coins(movement, segments, robots):
    perimeter, time = Perimeter(segments, robots, movement), 7
    count = np.zeros((segments, time + 1))
    for coins in itertools.product((0, 1), repeat=time):
        for segment in set().union(*visits(perimeter, coins)):
            count[segment, sum(coins)] += 1
    share = count / [math.comb(time, k) for k in range(time + 1)]
    found = detection_polynomials(perimeter, time)
    # Every stretch between two robots is like the first.
    np.testing.assert_allclose(np.tile(found, (robots, 1)), share, atol=1e-14)


def test_robots_that_always_go_ahead_detect_in_time():
    for movement in Movement:
        solution = maximin(detection_polynomials(Perimeter(12, 2, movement), 6))
        assert solution.value == 1
        assert solution.p == 1
    # In one step less, only the robot's own segment is missed.
    assert maximin(detection_polynomials(RING, 5)[1:]).value == 1


@given(hnp.arrays(np.float64, hnp.array_shapes(min_dims=2, max_dims=2), elements=st.floats(0, 1)))
def test_maximin_is_no_worse_than_a_grid(polynomials):
    solution = maximin(polynomials)
    grid = np.linspace(0, 1, 1001)
    assert solution.certificate.outcome is Outcome.CONVERGED
    assert solution.value >= at(polynomials, grid).min(axis=1).max() - 1e-11
    assert solution.value == pytest.approx(at(polynomials, solution.p).min(), abs=1e-11)


@pytest.mark.parametrize("scale", [1e3, 1e6, 1e9])
def test_maximin_ends_where_intervals_are_too_narrow_to_tell(scale):
    # Bounds of numbers so large do not come within the tolerance before intervals of p end.
    solution = maximin(scale * np.array([[0, 0.5, 1], [1, 0, 0]]))
    best = (3 - 5**0.5) / 2
    assert solution.p == pytest.approx(best, abs=2.0**-44)
    assert abs(solution.value - scale * best) <= solution.certificate.residual <= scale * 2.0**-43
    assert solution.certificate.iterations <= 44
    assert solution.certificate.outcome is Outcome.STALLED


@pytest.mark.parametrize("movement", Movement)
def test_the_law_sums_to_the_polynomials_and_the_mean(movement):
    perimeter, p = Perimeter(10, 2, movement), 0.7
    law = np.asarray(hitting_law(perimeter, p, 1500))
    for time in (1, 4, 9):
        detected = at(detection_polynomials(perimeter, time), p)
        np.testing.assert_allclose(law[:, :time].sum(axis=1), detected, atol=1e-14)
    np.testing.assert_allclose(law.sum(axis=1), 1, atol=1e-12)
    mean = law @ np.arange(1, 1501)
    np.testing.assert_allclose(mean_hitting_times(perimeter, p), mean, rtol=1e-9)


def test_means_in_closed_form():
    d = 8
    i = np.arange(1, d)
    # A fair coin makes two of the models the simple random walk.
    for movement in (Movement.BMP, Movement.DNCP):
        time = mean_hitting_times(Perimeter(3 * d, 3, movement), 0.5)
        np.testing.assert_allclose(time, [d, *(i * (d - i))], rtol=1e-9)
    # The gambler's ruin.
    p, q = 0.6, 0.4
    ruin = i / (q - p) - d / (q - p) * (1 - (q / p) ** i) / (1 - (q / p) ** d)
    found = np.asarray(mean_hitting_times(Perimeter(d, 1, Movement.BMP), p))
    np.testing.assert_allclose(found[1:][::-1], ruin, rtol=1e-9)
    for movement in Movement:
        time = mean_hitting_times(Perimeter(d, 1, movement), 1.0)
        np.testing.assert_allclose(time, [d, *i], rtol=1e-12)


def test_robots_that_only_turn_reach_nothing_new():
    time = np.asarray(mean_hitting_times(Perimeter(8, 1, Movement.DCP), 0.0))
    assert time[0] == 1
    assert np.isinf(time[1:]).all()
    # One segment behind, then back where it began.
    time = np.asarray(mean_hitting_times(Perimeter(8, 1, Movement.DNCP), 0.0))
    assert time[[0, 7]].tolist() == [2, 1]
    assert np.isinf(time[1:7]).all()


@pytest.mark.parametrize(
    ("ask", "message"),
    [
        (lambda: Perimeter(12, 5, Movement.BMP), "robots: .* divisor of the 12 segments, got 5"),
        (lambda: Perimeter(12, 0, Movement.BMP), "robots: .* whole number of at least 1, got 0"),
        (lambda: Perimeter(0, 1, Movement.BMP), "segments: .* number of at least 1, got 0"),
        (lambda: detection_polynomials(RING, 0), "time: .* whole number of at least 1, got 0"),
        (lambda: RING.chain(-0.1), "p: expected a probability"),
        (lambda: RING.chain(1.1), "p: expected a probability"),
        (lambda: RING.chain(math.nan), "p: expected a probability"),
        (lambda: maximin(np.array([[np.nan]])), "polynomials: expected finite numbers"),
    ],
)
def test_bad_perimeters_and_questions_are_refused(ask, message):
    with pytest.raises(ValueError, match=message):
        ask()
