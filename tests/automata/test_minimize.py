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
    # Blocks and states of the quotient are numbered in the order of their first states.
    blocks = np.array(moore_blocks(filter))
    first = np.unique(blocks, return_index=True)[1]
    after = filter.transition[first]
    np.testing.assert_array_equal(quotient.transition, np.where(after < 0, -1, blocks[after]))
    np.testing.assert_array_equal(quotient.color, filter.color[first])
    for merged in range(first.size):
        states = np.flatnonzero(blocks == merged).tolist()
        assert quotient.uncertainty[merged] == filter.uncertainty[states].max()
        union = sorted({cell for state in states for cell in filter.cells(state).tolist()})
        assert quotient.cells(merged).tolist() == union


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
