"""Orders of stops against all orders of a few, in one direction and in both."""

import itertools

import numpy as np
import pytest

from jaxcell.optimize.tour import best_order, good_order, improved_order, tour_length


def metric(stops, one_way, seed):
    random = np.random.default_rng(seed)
    between = random.uniform(1, 10, (stops, stops))
    between = between if one_way else between + between.T
    np.fill_diagonal(between, 0)
    for middle in range(stops):
        between = np.minimum(between, between[:, [middle]] + between[middle])
    return between


@pytest.mark.parametrize("one_way", [True, False])
@pytest.mark.parametrize("seed", range(3))
def test_orders_of_eight_stops_are_the_shortest_of_all(one_way, seed):
    between = metric(8, one_way, seed)
    least = min(
        between[[0, *rest], [*rest, 0]].sum() for rest in itertools.permutations(range(1, 8))
    )
    for order in best_order(between), good_order(between):
        assert sorted(order) == list(range(8))
        assert tour_length(order, between) == pytest.approx(least)


@pytest.mark.parametrize("one_way", [True, False])
def test_no_reversal_and_no_move_shortens_an_improved_order(one_way):
    between = metric(14, one_way, 5)
    order = improved_order(np.random.default_rng(0).permutation(14), between)
    length = tour_length(order, between)
    for turn in range(14):
        turned = np.roll(order, turn)
        for k in range(2, 14):
            assert tour_length(np.append(turned[:k][::-1], turned[k:]), between) > length - 1e-9
        for part, k in itertools.product(range(1, 4), range(4, 14)):
            rest = turned[part:]
            for moved in turned[:part], turned[:part][::-1]:
                other = np.concatenate([rest[: k - part], moved, rest[k - part :]])
                assert tour_length(other, between) > length - 1e-9
