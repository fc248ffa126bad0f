import hypothesis.strategies as st
import numpy as np
from hypothesis import given

from jaxcell.automata import Filter, minimize, subset_construction


def filter_of(graph, open_world=False):
    return Filter.of(subset_construction(*graph), open_world=open_world)


def moore_blocks(filter):
    """Compute Moore's partition: split by the blocks of the successors until nothing splits."""
    transition = filter.transition.tolist()
    block = filter.color.tolist()
    while True:
        keys = [
            (block[s], *(block[t] if t >= 0 else None for t in row))
            for s, row in enumerate(transition)
        ]
        number = {key: i for i, key in enumerate(dict.fromkeys(keys))}
        refined = [number[key] for key in keys]
        if len(number) == len(set(block)):
            return refined
        block = refined


@given(data=st.data(), open_world=st.booleans())
def test_merges_the_blocks_of_moores_partition(graphs, data, open_world):
    filter = filter_of(data.draw(graphs), open_world)
    quotient = minimize(filter)
    blocks = moore_blocks(filter)
    assert len(quotient.transition) == len(set(blocks))
    # Follow both together: the states that meet a state of the quotient are one block.
    partner, queue = {0: 0}, [(0, 0)]
    for state, merged in queue:
        assert quotient.color[merged] == filter.color[state]
        for after, after_merged in zip(
            filter.transition[state].tolist(), quotient.transition[merged].tolist(), strict=True
        ):
            assert (after < 0) == (after_merged < 0)
            if after >= 0 and partner.setdefault(after, after_merged) != after_merged:
                raise AssertionError("one state has two partners")
            if after >= 0 and (after, after_merged) not in queue:
                queue.append((after, after_merged))
    assert len(partner) == len(filter.transition)
    for merged in range(len(quotient.transition)):
        states = [state for state in partner if partner[state] == merged]
        assert len({blocks[state] for state in states}) == 1
        assert quotient.uncertainty[merged] == filter.uncertainty[states].max()
        union = sorted({cell for state in states for cell in filter.cells(state).tolist()})
        assert quotient.cells(merged).tolist() == union


@given(data=st.data(), open_world=st.booleans())
def test_quotient_of_quotient_is_itself(graphs, data, open_world):
    once = minimize(filter_of(data.draw(graphs), open_world))
    twice = minimize(once)
    for field in ("transition", "uncertainty", "offsets", "members", "color"):
        np.testing.assert_array_equal(getattr(once, field), getattr(twice, field))


def test_cycle_has_the_period_of_its_word():
    # Six cells in a circle, where the robot observes 0 1 1 0 1 1.
    image = np.array([1, 2, 3, 4, 5, 0], np.int32)
    (cycle,) = filter_of((image, np.array([False, True, True] * 2))).cycles
    assert cycle.states.size == 3


def test_states_of_a_cycle_with_one_observation_are_merged():
    circle = filter_of((np.array([1, 2, 0], np.int32), np.array([True, True, True])))
    assert minimize(circle).transition.tolist() == [[-1, 0]]
    assert minimize(circle).cells(0).tolist() == [0, 1, 2]


def test_metadata_is_kept(labs):
    filter = Filter.of(subset_construction(*labs["a", 45]), metadata={"map": "a"})
    assert minimize(filter).metadata == {"map": "a"}


def test_cycle_with_an_exit_is_minimal():
    filter = Filter(
        transition=np.array([[1, -1], [0, 2], [2, -1]], np.int32),
        uncertainty=np.ones(3, np.int32),
        offsets=np.arange(4),
        members=np.zeros(3, np.int32),
    )
    assert len(minimize(filter).transition) == len(set(moore_blocks(filter))) == 3
