import itertools
import math

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given

from jaxcell.automata import adaptive_choice, equivalence, homing_sequence
from jaxcell.automata.adaptive import levels


@st.composite
def machines(draw, most=6):
    """Images and observations that together never merge two states."""
    states, inputs = draw(st.integers(1, most)), draw(st.integers(1, 3))
    images, observations = [], []
    for _ in range(inputs):
        seen = draw(st.lists(st.sampled_from([0, 0, 0, 1, 5]), min_size=states, max_size=states))
        onto = {one: draw(st.permutations(range(states))) for one in (0, 1, 5)}
        images.append([onto[one][x] for x, one in enumerate(seen)])
        observations.append(seen)
    return np.array(images), np.array(observations)


def best_costs(machine, place, aim):
    """Compute the cost of each set by value iteration over all sets."""
    images, observations = machine
    states = range(images.shape[1])
    label = equivalence(images, observations).label
    cost = {}
    for size in states:
        for one in itertools.combinations(states, size + 1):
            settled = all(
                label[a] == label[b] or (place is not None and place[a] == place[b])
                for a, b in itertools.combinations(one, 2)
            )
            cost[one] = 0 if settled else math.inf

    def after(one, i):
        groups = {}
        for x in one:
            groups.setdefault(observations[i, x], set()).add(int(images[i, x]))
        return [cost[tuple(sorted(group))] for group in groups.values()]

    def look_ahead(one):
        each = [after(one, i) for i in range(len(images))]
        if aim == "worst":
            return 1 + min(map(max, each))
        return len(one) + min(map(sum, each))

    while True:
        better = {one: min(c, look_ahead(one)) if c else 0 for one, c in cost.items()}
        if better == cost:
            return cost
        cost = better


def carried_out(machine, found, root, place):
    """Count the inputs of the strategy from each state of a root; it ends in settled sets."""
    images, observations = machine
    label = equivalence(images, observations).label
    made = []
    for x in found.sets[root]:
        one, count = root, 0
        while found.choice[one] >= 0:
            assert x in found.sets[one]
            i = found.choice[one]
            one, x = found.after[one][int(observations[i, x])], int(images[i, x])
            count += 1
        assert x in found.sets[one]
        made.append(count)
        for a, b in itertools.combinations(found.sets[one], 2):
            assert label[a] == label[b] or (place is not None and place[a] == place[b])
    return made


@given(machines(), st.sampled_from(["worst", "mean"]), st.data())
def test_costs_are_those_of_value_iteration_over_all_sets(machine, aim, data):
    states = machine[0].shape[1]
    places = st.lists(st.integers(0, 2), min_size=states, max_size=states)
    place = data.draw(st.none() | places.map(np.array))
    cost = best_costs(machine, place, aim)
    roots = [tuple(range(states)), tuple(range(0, states, 2))]
    found = adaptive_choice(*machine, roots, place=place, aim=aim)
    total = max if aim == "worst" else sum
    assert found.optimal
    assert found.upper == [cost[root] for root in roots]
    for root, upper in zip(found.roots, found.upper, strict=True):
        assert total(carried_out(machine, found, root, place)) == upper
    for limit in (0, 2):
        cut = adaptive_choice(*machine, roots, place=place, aim=aim, limit=limit)
        assert cut.searched <= limit
        for root, low, high, known in zip(
            cut.roots, cut.lower, cut.upper, found.upper, strict=True
        ):
            assert low <= known <= high
            assert total(carried_out(machine, cut, root, place)) == high


@given(machines(most=8))
def test_levels_are_the_lengths_of_shortest_words(machine):
    classes = equivalence(*machine)
    found = levels(*machine)
    for a, b in itertools.combinations(range(machine[0].shape[1]), 2):
        differ = [i for i, level in enumerate(found) if level[a] != level[b]]
        if classes.label[a] == classes.label[b]:
            assert not differ
        else:
            assert differ[0] == classes.distinguish(a, b).size


def test_equal_sets_are_one_and_merging_machines_are_refused():
    # The first input leads to the same set for both observations.
    images = np.array([[2, 3, 2, 3, 0, 1]])
    with pytest.raises(ValueError, match=r"images\[0\]: two states have the same image"):
        adaptive_choice(images, np.array([[0, 0, 0, 1, 2, 2]]), [[0, 1]])
    observations = np.array([[0, 0, 1, 2, 1, 2]])
    images = np.array([[4, 5, 0, 1, 2, 3]])
    found = adaptive_choice(images, observations, [[0, 1], [4, 5]])
    assert found.sets == [(0, 1), (4, 5), (2,), (3,)]
    assert found.after == [{0: 1}, {1: 2, 2: 3}, {}, {}]
    assert found.upper == [2, 1]


@given(machines(most=5), st.data())
def test_homing_sequences_are_shortest_of_all(machine, data):
    images, observations = machine
    states = images.shape[1]
    place = data.draw(st.none() | st.lists(st.integers(0, 2), min_size=states, max_size=states))
    cost = best_costs(machine, place, "worst")
    roots = [tuple(range(states)), tuple(range(0, states, 2))]

    def unsettled(sets, word):
        for i in word:
            groups = {}
            for one in sets:
                for x in one:
                    key = one, observations[i, x]
                    groups.setdefault(key, set()).add(int(images[i, x]))
            sets = {g for group in groups.values() if cost[g := tuple(sorted(group))]}
        return sets

    start = {root for root in roots if cost[root]}
    found = homing_sequence(*machine, roots, place=place and np.array(place))
    assert found.optimal
    assert not unsettled(start, found.inputs)
    cut = homing_sequence(*machine, roots, place=place and np.array(place), limit=1)
    assert cut.least <= found.inputs.size <= cut.inputs.size
    assert not unsettled(start, cut.inputs)
    # All shorter sequences, while these are few.
    shorter = found.inputs.size - 1
    if 0 <= shorter <= 6:
        for word in itertools.product(range(len(images)), repeat=shorter):
            assert unsettled(start, word)
