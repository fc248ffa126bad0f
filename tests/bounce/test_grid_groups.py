import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from hypothesis.extra import numpy as hnp
from oracles.simple_maps import simple_map_groups

from jaxcell import bundled
from jaxcell.bounce import Walls, bounce_map, grid_groups, heading_filter_sizes, wall_groups, walls
from jaxcell.space import CELL_BY_CELL, ENDPOINT, CellSpace, Motion, Workspace
from jaxcell.space.steps import Steps


# Of one shape, because each shape is compiled.
GRIDS = hnp.arrays(bool, (5, 6), elements=st.sampled_from([True, True, True, False])).filter(np.any)
MOTIONS = [CELL_BY_CELL, ENDPOINT]
# Few settings, because each is compiled.
SETTINGS = st.sampled_from([(8, CELL_BY_CELL), (7, ENDPOINT), (24, Motion(1.7))])


def image_of(free, directions, shift, motion=CELL_BY_CELL):
    cells = CellSpace.of_grid(free, directions)
    result = bounce_map(cells, 2 * math.pi * shift / directions, motion=motion)
    return np.asarray(result.image), np.asarray(result.bumped), cells.positions


def totals_of_cells(image):
    """The fields of `GroupTotals`, from the groups of all cells."""
    group, step, period = simple_map_groups(image)
    basin = np.bincount(group)
    return period.size, step.max(), period.min(), period.max(), period.sum(), basin.max()


def totals_at(totals, *index):
    return tuple(getattr(totals, field.name)[index] for field in dataclasses.fields(totals))


@given(GRIDS, SETTINGS, st.data())
def test_groups_of_all_angles_are_those_of_a_walk(free, setting, data):
    directions, motion = setting
    shift = data.draw(st.integers(0, directions - 1))
    angles = 2 * math.pi * np.arange(directions) / directions
    totals = grid_groups(free, angles, directions, motion=motion)
    image, _, _ = image_of(free, directions, shift, motion=motion)
    assert totals_at(totals, shift) == totals_of_cells(image)


def test_groups_of_larger_rooms_are_those_of_a_walk():
    rng = np.random.default_rng(0)
    free = rng.random((3, 12, 15)) < 0.9
    angles = np.radians([0, 7, 36, 45, 90, 120, 179, 180, 240])
    totals = grid_groups(free, angles, 360)
    assert totals.count.shape == (3, 9)
    for room, angle in ((0, 1), (1, 4), (2, 6), (2, 7)):
        image, _, _ = image_of(free[room], 360, round(math.degrees(angles[angle])))
        assert totals_at(totals, room, angle) == totals_of_cells(image)
    assert totals_at(grid_groups(free[1], angles[4], 360)) == totals_at(totals, 1, 4)


@given(st.lists(GRIDS, min_size=2, max_size=4), st.sampled_from(MOTIONS))
@settings(max_examples=20)
def test_a_room_does_not_depend_on_the_others_of_its_batch(rooms, motion):
    angles = np.radians([45, 90, 135])
    together = grid_groups(np.array(rooms), angles, 8, motion=motion)
    sizes = heading_filter_sizes(walls(np.array(rooms), 8, motion=motion), np.array([1, 3]))
    for i, free in enumerate(rooms):
        alone = grid_groups(free, angles, 8, motion=motion)
        for angle in range(3):
            assert totals_at(together, i, angle) == totals_at(alone, angle)
        only = walls(free[None], 8, motion=motion)
        np.testing.assert_array_equal(heading_filter_sizes(only, np.array([1, 3]))[0], sizes[i])


@given(GRIDS, SETTINGS, st.data())
def test_filter_has_a_state_for_each_set_that_observations_leave(free, setting, data):
    directions, motion = setting
    shift = data.draw(st.integers(0, directions - 1))
    image, bumped, positions = image_of(free, directions, shift, motion=motion)
    start = frozenset(range(positions))
    states, left = {start}, [start]
    while left:
        state = left.pop()
        for bit in (0, 1):
            following = frozenset(int(image[z]) for z in state if bumped[z] == bit)
            if following and following not in states:
                states.add(following)
                left.append(following)
    sizes = heading_filter_sizes(
        walls(free[None], directions, motion=motion), np.arange(directions)
    )
    assert sizes[0, shift] == len(states)


def test_filter_of_a_closed_cell_turns_on_the_spot():
    # One free square: a state for each heading.
    sizes = heading_filter_sizes(walls(np.ones((1, 1, 1), bool), 12), np.array([0, 1, 2, 3, 4, 6]))
    assert sizes.tolist() == [[1, 12, 6, 4, 3, 2]]


def test_angles_steps_and_grids_that_do_not_fit_are_refused():
    free = np.ones((2, 3, 4), bool)
    with pytest.raises(ValueError, match=r"bounce: 10 deg is not a whole number of the 8"):
        grid_groups(free, math.radians(10), 8)
    with pytest.raises(ValueError, match=r"step: expected at least one cell, 1 m, got 0.5"):
        grid_groups(free, math.radians(90), 8, motion=Motion(0.5))
    free[1] = False
    with pytest.raises(ValueError, match=r"free: expected a free square .*, got none in number 1"):
        grid_groups(free, math.radians(90), 8)


@pytest.mark.parametrize(("name", "cell", "directions"), [("lab_a", 1.0, 8), ("cafe", 0.5, 12)])
@pytest.mark.parametrize("motion", MOTIONS)
def test_walls_of_a_map_determine_its_groups(name, cell, directions, motion):
    cells = CellSpace.of(Workspace.load(bundled(f"maps/{name}.json")), cell, directions)
    shift = np.arange(directions)
    totals = wall_groups(Walls.of(Steps.of(cells, motion)), shift)
    for turn in shift.tolist():
        image = bounce_map(cells, 2 * math.pi * turn / directions, motion=motion).image
        assert totals_at(totals, 0, turn) == totals_of_cells(image)
