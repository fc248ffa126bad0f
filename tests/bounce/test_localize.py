import math

import numpy as np
import pytest
from hypothesis import given, strategies as st
from random_rooms import grids

from jaxcell.bounce import bounce_map, localization_filter, localize
from jaxcell.space import CellSpace


GRIDS = grids(1, (4, 5)) | grids(9, (4, 5)) | grids(15, (4, 5))


@given(GRIDS, st.integers(1, 7), st.data())
def test_the_cells_left_by_a_filter_contain_the_robot(free, shift, data):
    cells = CellSpace.of_grid(free, 8)
    simple_map = bounce_map(cells, shift * math.pi / 4)
    filter = localization_filter(simple_map)
    start = data.draw(st.integers(0, cells.size - 1))
    run = localize(simple_map, filter, start)
    assert run.truth_is_a_candidate
    image, bumped = np.asarray(simple_map.image), np.asarray(simple_map.bumped)
    np.testing.assert_array_equal(run.path[1:], image[run.path[:-1]])
    np.testing.assert_array_equal(run.observations, bumped[run.path[:-1]])
    # The cells that the observations leave, from every start.
    ends = np.arange(cells.size)
    for observation in run.observations:
        ends = image[ends[bumped[ends] == observation]]
    np.testing.assert_array_equal(run.candidates, np.unique(ends))
    assert filter.run(run.observations.tolist()).localized_at == len(run.observations)


def test_another_map_is_refuted_in_the_open_world():
    here = bounce_map(CellSpace.of_grid(np.ones((3, 3), bool), 8), math.pi / 2)
    corridor = CellSpace.of_grid(np.ones((1, 9), bool), 8)
    there = bounce_map(corridor, math.pi / 2)
    filter = localization_filter(here, open_world=True)
    # Eight free steps in a row do not occur in a room of 3 x 3.
    run = localize(there, filter, int(corridor.index(0.5, 0.5)))
    assert run.states[-1] == filter.trap
    assert run.candidates.size == 0
    assert not run.truth_is_a_candidate
    assert "".join(map(str, run.observations)) == "000"


def test_a_start_that_does_not_exist_is_refused():
    simple_map = bounce_map(CellSpace.of_grid(np.ones((2, 2), bool), 4), math.pi / 2)
    with pytest.raises(ValueError, match="start: cell 16 does not exist; cells are 0 to 15"):
        localize(simple_map, localization_filter(simple_map), 16)
