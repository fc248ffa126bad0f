import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given

from jaxcell.automata import Environments, Filter, subset_construction


@given(data=st.data(), string=st.text("01", max_size=15), open_world=st.booleans())
def test_maps_are_filtered_independently(graphs, data, string, open_world):
    maps = data.draw(st.lists(graphs, min_size=1, max_size=4))
    filters = {
        f"map {i}": Filter.of(subset_construction(*graph), open_world=open_world)
        for i, graph in enumerate(maps)
    }
    state = Environments(filters).run(string)
    runs = {name: filter.with_trap().run(string) for name, filter in filters.items()}
    assert state.remaining == tuple(n for n, run in runs.items() if run.refuted_at is None)
    assert state.refuted_at == {
        name: run.refuted_at for name, run in runs.items() if run.refuted_at is not None
    }
    assert list(state.cells) == list(state.remaining)
    for name, cells in state.cells.items():
        np.testing.assert_array_equal(cells, filters[name].cells(int(runs[name].states[-1])))


def test_no_maps_are_refused():
    with pytest.raises(ValueError, match="at least one map"):
        Environments({})
