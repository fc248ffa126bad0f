import sys

import numpy as np
import pytest
import scipy.optimize

from jaxcell.optimize import Graph
from jaxcell.patrol import angular_regions, capture_probabilities, distributed_policies
from jaxcell.patrol.map.game import contested, share_game
from jaxcell.patrol.map.policies import centralized_policies


# The package may have the function under this name.
MODULE = sys.modules["jaxcell.patrol.map.game"]


def corridor():
    """Nine places on a line, each of which sees its neighbours."""
    graph = Graph([(i, i + 1) for i in range(8)], xy=[(i, 0) for i in range(9)])
    visible = np.abs(np.subtract.outer(np.arange(9), np.arange(9))) <= 1
    return graph, visible


def maximin(capture):
    """The value of the game by one linear program for the robots alone."""
    strategies, targets = capture.shape
    # Of the variables, the last is what all targets have at least.
    found = scipy.optimize.linprog(
        np.append(np.zeros(strategies), -1),
        A_ub=np.column_stack([-capture.T, np.ones(targets)]),
        b_ub=np.zeros(targets),
        A_eq=[[1] * strategies + [0]],
        b_eq=[1],
    )
    return -found.fun


def test_the_mixture_is_a_maximin_strategy():
    graph, visible = corridor()
    shares, steps = [0.0, 0.3, 0.9], 6

    def policies(share):
        return distributed_policies(graph, visible, 2, share)

    game = share_game(graph, visible, policies, shares, steps)
    expected = [capture_probabilities(graph, visible, policies(h), [steps])[0] for h in shares]
    np.testing.assert_allclose(game.capture, expected, atol=1e-14)
    assert game.commitment.value == pytest.approx(maximin(game.capture), abs=1e-7)
    # What an adversary may choose from all cells is no better than what it chooses.
    assert game.mixed.min() == pytest.approx(game.commitment.value, abs=1e-7)
    assert game.mixed[game.attacked] == pytest.approx(game.commitment.value, abs=1e-7)
    np.testing.assert_allclose(game.capture_alone, game.capture.min(axis=1))
    assert game.commitment.value >= game.capture_alone.max() - 1e-7
    assert float(game.commitment.follower_value[0]) == pytest.approx(1 - game.commitment.value)


def test_payoffs_that_need_a_mixture(monkeypatch):
    """Each share defends one cell; the third cell is defended better than another, always."""
    graph, visible = corridor()
    rows = {0.1: [0.9, 0.1, 0.9], 0.5: [0.2, 0.6, 0.8]}
    monkeypatch.setattr(
        MODULE,
        "capture_probabilities",
        lambda graph, visible, share, times: np.pad([rows[share]], ((0, 0), (0, 6))),
    )
    targets = np.arange(3, dtype=np.int32)
    game = share_game(graph, visible, lambda share: share, [0.1, 0.5], 4, targets)
    assert game.targets.tolist() == [0, 1]
    # 0.9 p + 0.2 (1 - p) = 0.1 p + 0.6 (1 - p) at p = 1 / 3.
    np.testing.assert_allclose(game.commitment.weights, [1 / 3, 2 / 3], atol=1e-7)
    assert game.commitment.value == pytest.approx(1.3 / 3)


@pytest.mark.parametrize("seed", range(4))
def test_what_is_left_out_changes_nothing(seed, monkeypatch):
    graph, visible = corridor()
    random = np.random.default_rng(seed)
    # Few values, so that many cells are alike in some or all shares.
    rows = dict(zip([0.0, 0.5, 0.9], random.integers(1, 5, (3, 9)) / 5, strict=True))
    monkeypatch.setattr(
        MODULE,
        "capture_probabilities",
        lambda graph, visible, share, times: rows[share][None],
    )
    game = share_game(graph, visible, lambda share: share, list(rows), 4)
    whole = np.stack(list(rows.values()))
    assert game.commitment.value == pytest.approx(maximin(whole), abs=1e-7)
    for target in range(9):
        best = (whole[:, game.targets] <= whole[:, [target]]).all(axis=0)
        assert best.any()
    for target in game.targets:
        others = np.setdiff1d(game.targets, target)
        assert not (whole[:, others] <= whole[:, [target]]).all(axis=0).any()


def test_where_luck_decides():
    graph, visible = corridor()
    policies = distributed_policies(graph, visible, 1)
    assert contested(visible, policies).tolist() == list(range(9))
    regions = angular_regions(graph, 4, visible[4], 2)
    in_regions = centralized_policies(graph, visible, regions)
    assert contested(visible, in_regions, regions).tolist() == [0, 1, 2, 6, 7, 8]
    visible[0] = False
    assert contested(visible, policies).tolist() == list(range(1, 9))


@pytest.mark.parametrize(
    ("shares", "targets", "said"),
    [
        ([], None, "shares: expected at least one"),
        ([0.5], np.array([], np.int32), r"cells 0 to 8, got \[\]"),
        ([0.5], np.array([9], np.int32), r"cells 0 to 8, got \[9\]"),
        ([0.5], np.array([-1], np.int32), r"cells 0 to 8, got \[-1\]"),
    ],
)
def test_refusals(shares, targets, said):
    graph, visible = corridor()
    with pytest.raises(ValueError, match=said):
        share_game(graph, visible, lambda share: (), shares, 5, targets)
