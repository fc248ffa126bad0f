import hypothesis.strategies as st
import numpy as np
from hypothesis import given

from jaxcell.automata import Filter, minimize, subset_construction


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
    filter = Filter.of(subset_construction(*data.draw(graphs)), open_world=open_world)
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
