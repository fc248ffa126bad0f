import itertools
import math

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given

from jaxcell.automata import adaptive_choice, equivalence, homing_sequence


@st.composite
def machines(draw, most=6):
    """Draw images and observations such that no two states have both in common."""
    states, inputs = draw(st.integers(1, most)), draw(st.integers(1, 3))
    images, observations = [], []
    for _ in range(inputs):
        seen = draw(st.lists(st.sampled_from([0, 0, 0, 1, 5]), min_size=states, max_size=states))
        onto = {value: draw(st.permutations(range(states))) for value in (0, 1, 5)}
        images.append([onto[value][x] for x, value in enumerate(seen)])
        observations.append(seen)
    return np.array(images), np.array(observations)


def best_costs(machine, place, aim):
    """Compute the cost of each set by value iteration over all sets."""
    images, observations = machine
    states = range(images.shape[1])
    sets = [s for size in states for s in itertools.combinations(states, size + 1)]
    cost = {s: 0 if is_settled(machine, s, place) else math.inf for s in sets}

    def after(states, i):
        groups = {}
        for x in states:
            groups.setdefault(observations[i, x], set()).add(int(images[i, x]))
        return [cost[tuple(sorted(group))] for group in groups.values()]

    def look_ahead(states):
        each = [after(states, i) for i in range(len(images))]
        if aim == "worst":
            return 1 + min(map(max, each))
        return len(states) + min(map(sum, each))

    while True:
        better = {states: min(c, look_ahead(states)) if c else 0 for states, c in cost.items()}
        if better == cost:
            return cost
        cost = better


def is_settled(machine, states, place):
    label = equivalence(*machine)
    return all(
        label[a] == label[b] or (place is not None and place[a] == place[b])
        for a, b in itertools.combinations(states, 2)
    )


def inputs_made(machine, strategy, root, place):
    """Count the inputs of a strategy from each state of a root, and check that it ends settled."""
    images, observations = machine
    counts = []
    for x in strategy.sets[root]:
        here, count = root, 0
        while (i := strategy.choice[here]) >= 0:
            assert x in strategy.sets[here]
            here, x = strategy.after[here][int(observations[i, x])], int(images[i, x])
            count += 1
        assert x in strategy.sets[here]
        assert is_settled(machine, strategy.sets[here], place)
        counts.append(count)
    return counts


@given(machines(), st.sampled_from(["worst", "mean"]), st.data())
def test_costs_are_those_of_value_iteration_over_all_sets(machine, aim, data):
    states = machine[0].shape[1]
    places = st.lists(st.integers(0, 2), min_size=states, max_size=states)
    place = data.draw(st.none() | places.map(np.array))
    cost = best_costs(machine, place, aim)
    roots = [tuple(range(states)), tuple(range(0, states, 2))]
    best = adaptive_choice(*machine, roots, place=place, aim=aim)
    total = max if aim == "worst" else sum
    assert best.optimal
    assert best.upper == [cost[root] for root in roots]
    cut = [adaptive_choice(*machine, roots, place=place, aim=aim, limit=n) for n in (0, 2)]
    assert cut[0].searched == 0 <= cut[1].searched <= 2
    for strategy in (best, *cut):
        for i, root in enumerate(strategy.roots):
            assert strategy.lower[i] <= best.upper[i] <= strategy.upper[i]
            assert total(inputs_made(machine, strategy, root, place)) == strategy.upper[i]


def test_equal_sets_have_one_number():
    # The input leads from the first root to the second.
    images, observations = np.array([[4, 5, 0, 1, 2, 3]]), np.array([[0, 0, 1, 2, 1, 2]])
    strategy = adaptive_choice(images, observations, [[0, 1], [4, 5]])
    assert strategy.sets == [(0, 1), (4, 5), (2,), (3,)]
    assert strategy.after == [{0: 1}, {1: 2, 2: 3}, {}, {}]
    assert strategy.upper == [2, 1]


def test_machines_that_merge_states_are_refused():
    images, observations = np.array([[2, 3, 2, 3, 0, 1]]), np.array([[0, 0, 0, 1, 2, 2]])
    with pytest.raises(ValueError, match=r"images\[0\]: two states have the same image"):
        adaptive_choice(images, observations, [[0, 1]])


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
            for states in sets:
                for x in states:
                    key = states, observations[i, x]
                    groups.setdefault(key, set()).add(int(images[i, x]))
            sets = {g for group in groups.values() if cost[g := tuple(sorted(group))]}
        return sets

    start = {root for root in roots if cost[root]}
    best = homing_sequence(*machine, roots, place=place and np.array(place))
    assert best.optimal
    assert not unsettled(start, best.inputs)
    cut = homing_sequence(*machine, roots, place=place and np.array(place), limit=1)
    assert cut.least <= best.inputs.size <= cut.inputs.size
    assert not unsettled(start, cut.inputs)
    # Try all shorter sequences if they are few.
    shorter = best.inputs.size - 1
    if 0 <= shorter <= 6:
        for word in itertools.product(range(len(images)), repeat=shorter):
            assert unsettled(start, word)


def test_inputs_to_avoid_are_not_taken_where_others_cost_as_little():
    """Three inputs tell two states apart at once; a fourth does not."""
    images = np.array([[0, 1], [1, 0], [0, 1], [1, 0]])
    observations = np.array([[0, 1], [0, 1], [1, 0], [0, 0]])
    avoid = np.array([[True, False], [True, True], [False, False], [False, False]])
    plain = adaptive_choice(images, observations, [[0, 1]])
    assert (plain.choice[plain.roots[0]], plain.upper) == (0, [1])
    found = adaptive_choice(images, observations, [[0, 1]], avoid=avoid)
    assert (found.choice[found.roots[0]], found.upper) == (2, [1])
    assert found.optimal
