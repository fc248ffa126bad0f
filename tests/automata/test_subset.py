import itertools

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given

from jaxcell.automata import subset, subset_construction


def sets_one_by_one(image, observation):
    """Construct subsets one by one. Returns the successors of each set, and the sets."""
    image, observation = image.tolist(), observation.tolist()
    start = frozenset(range(len(image)))
    number, queue, rows = {start: 0}, [start], []
    for cells in queue:
        row = [-1, -1]
        for bit in (0, 1):
            reached = frozenset(image[c] for c in cells if observation[c] == bit)
            if reached:
                if reached not in number:
                    number[reached] = len(queue)
                    queue.append(reached)
                row[bit] = number[reached]
        rows.append(row)
    return rows, [sorted(cells) for cells in queue]


def lists(automaton):
    members, offsets = automaton.members.tolist(), automaton.offsets.tolist()
    sets = [members[a:b] for a, b in itertools.pairwise(offsets)]
    return automaton.transition.tolist(), sets


@pytest.mark.parametrize(
    ("room", "angle", "states"), [("a", 45, 129), ("a", 135, 124), ("b", 45, 147), ("b", 135, 202)]
)
def test_states_of_table_2_1(labs, room, angle, states):
    assert len(subset_construction(*labs[room, angle]).transition) == states


@given(data=st.data())
def test_automaton_equals_sets_one_by_one(graphs, data):
    graph = data.draw(graphs)
    assert lists(subset_construction(*graph)) == sets_one_by_one(*graph)


def test_automata_of_larger_maps_equal_sets_one_by_one(labs, bounce):
    rng = np.random.default_rng(0)
    graphs = [*labs.values(), bounce(rng.random((12, 20)) < 0.8, 36, 9)]
    graphs += [(rng.integers(0, n, n), rng.random(n) < 0.5) for n in (100, 1000, 3000)]
    # Few observations are 1, so that sets are large and levels many.
    graphs += [(rng.permutation(n), rng.random(n) < 0.1) for n in (100, 500)]
    for image, observation in graphs:
        result = subset_construction(image.astype(np.int32), observation)
        assert lists(result) == sets_one_by_one(image, observation)


@given(data=st.data(), bits=st.integers(0, 2))
def test_hash_collisions_do_not_change_the_automaton(graphs, data, bits):
    graph = data.draw(graphs)
    random_words, seeds = subset.random_words, []

    def weak_words(cells, seed):
        seeds.append(seed)
        words = random_words(cells, seed)
        return words if seed == 3 else words & np.uint64(2**bits - 1)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(subset, "random_words", weak_words)
        assert lists(subset_construction(*graph)) == sets_one_by_one(*graph)
    # With words of zero bits, all sets have the same hash.
    if bits == 0 and len(sets_one_by_one(*graph)[1]) > 1:
        assert seeds == [0, 1, 2, 3]


@pytest.mark.parametrize("dtype", [np.uint8, np.uint32, np.int64])
def test_images_of_any_integer_type(labs, dtype):
    image, observation = labs["a", 45]
    expected = lists(subset_construction(image, observation))
    assert lists(subset_construction(image.astype(dtype), observation)) == expected


@pytest.mark.parametrize(
    ("image", "message"),
    [
        ([], "no cells"),
        ([0, 2], r"image\[1\] is 2; expected a cell from 0 to 1"),
        ([0, -1], r"image\[1\] is -1"),
    ],
)
def test_bad_images_are_refused(image, message):
    with pytest.raises(ValueError, match=message):
        subset_construction(np.array(image, np.int32), np.zeros(len(image), bool))
