"""The ends of observed drifters, with sampling errors."""

import numpy as np
import pytest

from jaxcell import drift


DAY = 86_400.0


def moves_of(begin, end, lag=DAY):
    """One move per drifter between the centres of cells of a degree in a row; -1 is far away."""
    lon = np.stack([begin, np.where(end < 0, 90, end)], axis=1).ravel() + 0.5
    time, number = np.tile([0.0, lag], begin.size), np.arange(begin.size).repeat(2)
    seen = drift.Trajectories(lon, 0 * lon + 0.5, time, number)
    return seen, drift.count_moves(
        seen, drift.boxes(seen, 1.0, (0, 0, int(begin.max()) + 1, 1)), lag
    )


@pytest.fixture(scope="module")
def pair():
    """Two cells that 30 and 60 of 300 leave for each other, and 30 of 300 for good."""
    begin = np.repeat([0, 1], 300)
    ends = [0] * 240 + [1] * 30 + [-1] * 30 + [1] * 240 + [0] * 60
    seen, moves = moves_of(begin, np.array(ends))
    return drift.ObservedDrift.of(seen, moves, after=2 * DAY, sets=2, samples=150)


def test_answers_are_those_of_the_chain(pair):
    matrix = np.array([[0.8, 0.1], [0.2, 0.8]])
    hours = 24 * np.linalg.solve(np.eye(2) - matrix, np.ones(2))
    np.testing.assert_allclose(pair.absorption_time[0, 0], hours)
    np.testing.assert_allclose(pair.distribution[0, 0], [0.5, 0.5] @ matrix @ matrix)
    assert pair.count[0, 0].tolist() == [300, 300]
    named = dict(zip(pair.estimates_name.tolist(), pair.estimates_value, strict=True))
    assert named["persistent groups"] == 0
    assert named["median hours to the end"] == pytest.approx(hours.mean())
    assert named["share left after 2 days"] == pytest.approx(1 - pair.distribution.sum())
    sets = pair.nearly_closed_sets
    leaks = [named[f"leakage of set {k}"] for k in sets.rank]
    np.testing.assert_allclose(leaks, sets.leakage)


def test_errors_are_those_of_multinomial_shares(pair):
    """The oracle draws the shares of moves from each cell from a multinomial law."""
    named = dict(zip(pair.estimates_name.tolist(), pair.estimates_error, strict=True))
    for rank in pair.nearly_closed_sets.rank:
        assert named[f"leakage of set {rank}"] == pytest.approx((0.2 * 0.8 / 300) ** 0.5, rel=0.25)
    matrix, draws = np.array([[0.8, 0.1, 0.1], [0.2, 0.8, 0.0]]), []
    random = np.random.default_rng(1)
    for _ in range(2000):
        rows = np.stack([random.multinomial(300, row) / 300 for row in matrix])[:, :2]
        draws.append(24 * np.linalg.solve(np.eye(2) - rows, np.ones(2)))
    np.testing.assert_allclose(pair.absorption_time_error[0, 0], np.std(draws, axis=0), rtol=0.25)
    assert (pair.estimates_low <= pair.estimates_high).all()
    # Some leave for good in every draw.
    assert not pair.persistent_share.any()


def test_a_cell_is_persistent_in_draws_without_its_only_exit():
    """Only 1 of 20 drifters leaves the cell; no draw has it with probability (1 - 1/20)^20."""
    seen, moves = moves_of(np.zeros(20, int), np.array([-1] + [0] * 19))
    found = drift.ObservedDrift.of(seen, moves, samples=80)
    assert found.persistent_groups == 0
    assert found.persistent_share.item() == pytest.approx(0.95**20, abs=0.15)
    (remark,) = found.remarks
    assert remark.startswith("In the long run all drifters have left the map")
