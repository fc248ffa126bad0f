import itertools

import hypothesis.strategies as st
from hypothesis import given

from jaxcell.automata import Filter, fastest_localization, subset_construction


def first_string(filter, uncertainty, longest):
    """Try all strings, shortest first and then in dictionary order, until one localizes."""
    filter = filter.with_trap()
    for length in range(longest + 1):
        for word in itertools.product("01", repeat=length):
            state = filter.start()
            for digit in word:
                state = state.observe(int(digit))
            if state.localized and uncertainty in (None, state.uncertainty):
                return "".join(word)
    return None


@given(data=st.data(), open_world=st.booleans())
def test_string_is_the_first_of_all_that_localize(graphs, data, open_world):
    filter = Filter.of(subset_construction(*data.draw(graphs)), open_world=open_world)
    for uncertainty in (None, *(cycle.uncertainty for cycle in filter.cycles)):
        found = fastest_localization(filter, uncertainty)
        assert found is not None
        if len(found) <= 7:
            assert found == first_string(filter, uncertainty, 7)
        else:
            assert first_string(filter, uncertainty, 6) is None
    assert fastest_localization(filter, 10**6) is None
