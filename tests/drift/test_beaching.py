"""Drifters that strand, and come afloat again."""

import numpy as np
import pytest
from seas import sea

from jaxcell import drift
from jaxcell.mapping import Chain


HOUR = 3600.0


def test_two_states_follow_their_closed_form():
    still = Chain.from_scipy(np.eye(1))
    chain, _ = drift.beaching(still, np.array([True]), HOUR, afloat=2 * HOUR, stranded=5 * HOUR)
    strands, floats = 1 - 2**-0.5, 1 - 2**-0.2
    share = np.array([1.0, 0.0])
    for n in range(1, 12):
        share = chain.push(share)
        left = (1 - strands - floats) ** n
        assert float(share[1]) == pytest.approx(strands / (strands + floats) * (1 - left))
        assert float(share.sum()) == pytest.approx(1)


def test_drifters_that_do_not_strand_drift_on():
    random = np.random.default_rng(0)
    matrix = random.dirichlet(np.ones(5), 5) * 0.9
    at_coast = np.array([False, True, False, True, True])
    chain, cell = drift.beaching(Chain.from_scipy(matrix), at_coast, HOUR, afloat=HOUR)
    beached = chain.to_scipy().toarray()
    half = np.where(at_coast, 0.5, 1.0)[:, None]
    np.testing.assert_allclose(beached[:5, :5], half * matrix)
    np.testing.assert_array_equal(cell, [1, 3, 4])
    np.testing.assert_array_equal(beached[[1, 3, 4], [5, 6, 7]], 0.5)
    # No drifter comes afloat again, so that each beach is an end.
    np.testing.assert_array_equal(beached[5:], np.eye(8)[5:])
    assert drift.long_term_behaviour(chain, HOUR).groups.count == 3


def test_stranded_shares_are_those_of_powers_of_the_matrix():
    wet = np.ones((2, 4), bool)
    wet[0, 0] = False
    water = drift.Water.of(sea(*np.zeros((2, 2, 4)), wet))
    # A tenth leaves the map in each step.
    matrix = np.random.default_rng(1).dirichlet(np.ones(7), 7) * 0.9
    behaviour = drift.long_term_behaviour(Chain.from_scipy(matrix), HOUR)
    times = {"afloat": 2 * HOUR, "stranded": 5 * HOUR}
    stranded = drift.Stranded.of(water, behaviour, 3.2 * HOUR, **times)
    chain, cell = drift.beaching(behaviour.chain, drift.coast(water), HOUR, **times)
    after = np.linalg.matrix_power(chain.to_scipy().toarray(), 3)[:7]
    assert (stranded.after_hours, stranded.beaches) == (3, cell.size)
    assert stranded.share == pytest.approx(after[:, 7:].sum() / 7)
    assert stranded.left == pytest.approx(1 - after.sum() / 7)
    assert 0.1 < stranded.left < 0.9
    chance, on_beach = np.full((2, 2, 4), np.nan)
    chance[wet] = after[:, 7:].sum(axis=1)
    np.testing.assert_allclose(stranded.chance, chance)
    on_beach[water.row[cell], water.column[cell]] = after[:, 7:].mean(axis=0)
    np.testing.assert_allclose(stranded.on_beach, on_beach)


def test_a_coast_is_beside_land():
    wet = np.ones((4, 5), bool)
    wet[1, 1] = False
    water = drift.Water.of(sea(np.zeros((4, 5)), np.zeros((4, 5)), wet))
    near = (abs(water.row - 1) <= 1) & (abs(water.column - 1) <= 1)
    np.testing.assert_array_equal(drift.coast(water), near)


def test_wrong_times_are_refused():
    still = Chain.from_scipy(np.eye(2))
    with pytest.raises(ValueError, match="afloat: expected more than 0 seconds, got 0"):
        drift.beaching(still, np.ones(2, bool), HOUR, afloat=0)
    with pytest.raises(ValueError, match="at_coast: expected 2 cells"):
        drift.beaching(still, np.ones(3, bool), HOUR, afloat=HOUR)
