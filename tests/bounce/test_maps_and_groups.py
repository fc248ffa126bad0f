import dataclasses
import math
import warnings

import jax
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from hypothesis.extra import numpy as hnp
from oracles.simple_maps import simple_map_groups
from random_rooms import grids

from jaxcell.bounce import (
    Walls,
    bounce_groups,
    bounce_map,
    bounce_shift,
    grid_groups,
    group_summary,
    heading_filter_sizes,
    moves,
    wall_groups,
    walls,
)
from jaxcell.mapping import periodic_groups
from jaxcell.space import CELL_BY_CELL, ENDPOINT, CellSpace, Motion, Workspace
from jaxcell.space.steps import Steps


GRIDS = grids(1, (5, 6)) | grids(21, (5, 6))
DIRECTIONS = st.sampled_from([(1, 4), (21, 8), (21, 24)]).flatmap(
    lambda sizes: st.tuples(grids(sizes[0], (5, 6)), st.just(sizes[1]))
)
CURVED = Workspace(
    [
        (0, 0),
        (9, 0),
        *((9 * math.cos(a), 7 * math.sin(a)) for a in np.linspace(0.2, 1.5, 9)),
        (0, 7),
    ],
    [[(3, 2), (4.3, 2.2), (3.5, 3.6)]],
    robot_radius=0.2,
)


# Of one shape, because each shape is compiled.
MASKS = hnp.arrays(bool, (5, 6), elements=st.sampled_from([True, True, True, False])).filter(np.any)
MOTIONS = [CELL_BY_CELL, ENDPOINT]
# Few settings, because each is compiled.
SETTINGS = st.sampled_from([(8, CELL_BY_CELL), (7, ENDPOINT), (24, Motion(1.7))])


def eq_2_4(cells, direction, position, shift):
    """The image of a cell and its bump by Eq. 2.4 of Alam 2018, with the rule `endpoint`."""
    columns = cells.free.shape[1]
    row, column = divmod(int(cells.square[position]), columns)
    angle = 2 * math.pi * direction / cells.directions
    to_column = math.floor(round(column + 0.5 + math.cos(angle), 9))
    to_row = math.floor(round(row + 0.5 + math.sin(angle), 9))
    inside = 0 <= to_row < cells.free.shape[0] and 0 <= to_column < columns
    if inside and cells.free[to_row, to_column]:
        return direction * cells.positions + int(cells.position_of_square[to_row, to_column]), False
    return (direction + shift) % cells.directions * cells.positions + position, True


@given(DIRECTIONS, st.integers(-30, 30))
def test_images_follow_eq_2_4(grid, shift):
    free, directions = grid
    cells = CellSpace.of_grid(free, directions)
    result = bounce_map(cells, 2 * math.pi * shift / directions, motion=ENDPOINT)
    pairs = [eq_2_4(cells, *divmod(z, cells.positions), shift) for z in range(cells.size)]
    np.testing.assert_array_equal(result.image, [image for image, _ in pairs])
    np.testing.assert_array_equal(result.bumped, [bumped for _, bumped in pairs])


@pytest.mark.parametrize(
    ("cells", "motion"),
    [
        (CellSpace.of(CURVED, 0.4, 24), Motion(0.64)),
        (CellSpace.of(CURVED, 0.4, 24), ENDPOINT),
        (CellSpace.of_grid(np.eye(7) == 0, 24), CELL_BY_CELL),
        (CellSpace.of_grid(np.eye(7) == 0, 24), Motion(1.6, "endpoint")),
    ],
)
def test_groups_from_walls_are_those_of_all_cells(cells, motion):
    angles = 2 * np.pi * np.arange(24) / 24
    images = bounce_map(cells, angles, motion=motion).image
    groups = jax.device_get(jax.jit(jax.vmap(periodic_groups))(images))
    assert_same_groups(bounce_groups(cells, angles, motion=motion), groups)
    summary = jax.device_get(group_summary(cells, angles, motion=motion))
    np.testing.assert_array_equal(summary.count, groups.count)
    for i, (group, step) in enumerate(zip(groups.group, groups.step, strict=True)):
        slots = summary.basin.shape[1]
        longest = np.zeros(slots)
        np.maximum.at(longest, group, step)
        np.testing.assert_array_equal(summary.basin[i], np.bincount(group, minlength=slots))
        np.testing.assert_array_equal(summary.transient[i], longest)
        on_group = np.bincount(group[step == 0], minlength=slots)
        np.testing.assert_array_equal(summary.period[i], on_group)
    totals = summary.totals()
    for name, total in vars(wall_groups(Walls.of(Steps.of(cells, motion)), np.arange(24))).items():
        np.testing.assert_array_equal(getattr(totals, name), total[0], err_msg=name)
    alone = group_summary(cells, angles[1], motion=motion).totals()
    assert totals_at(alone) == totals_at(totals, 1)


def assert_same_groups(groups, expected):
    for name in ("group", "step", "period", "count"):
        np.testing.assert_array_equal(getattr(groups, name), getattr(expected, name), err_msg=name)


@given(GRIDS, st.integers(0, 7))
@settings(max_examples=5)
def test_groups_of_random_grids_are_those_of_all_cells(free, shift):
    cells = CellSpace.of_grid(free, 8)
    angle = 2 * math.pi * shift / 8
    groups = periodic_groups(bounce_map(cells, angle).image)
    assert_same_groups(bounce_groups(cells, angle), groups)


@pytest.mark.parametrize(
    ("cells", "motion"),
    [
        (CellSpace.of(CURVED, 1.0, 12), CELL_BY_CELL),
        (CellSpace.of_grid(np.arange(42).reshape(6, 7) % 5 != 2, 8), ENDPOINT),
    ],
)
def test_traced_angles_have_the_maps_and_groups_of_each_angle(cells, motion):
    angles = 2 * math.pi * np.arange(-1, cells.directions + 2) / cells.directions
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = jax.jit(jax.vmap(lambda one: _of_angle(cells, one, motion)))(angles)
        at_once = jax.jit(_of_angle)(cells, angles.reshape(1, -1), motion)
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(at_once), strict=True):
        np.testing.assert_array_equal(one, other[0])
    for k, angle in enumerate(angles.tolist()):
        expected = jax.tree.leaves(_of_angle(cells, angle, motion))
        for one, other in zip(jax.tree.leaves(found), expected, strict=True):
            # A traced table of groups has zeros for as many groups as there are cells.
            table = np.zeros_like(one[k])
            table[tuple(map(slice, other.shape))] = other
            np.testing.assert_array_equal(one[k], table)


def _of_angle(cells, angle, motion):
    map = bounce_map(cells, angle, motion=motion)
    groups = bounce_groups(cells, angle, motion=motion)
    return map, groups, groups.period, group_summary(cells, angle, motion=motion)


def test_an_angle_is_a_whole_number_of_directions():
    np.testing.assert_array_equal(bounce_shift(np.deg2rad([45, 135, -45, 360]), 8), [1, 3, 7, 0])
    # Angles with the digits that people type are those that they mean.
    np.testing.assert_array_equal(bounce_shift(np.array([1.5708, 0.7854, 3.1416]), 8), [2, 1, 4])
    message = "bounce: 50 deg is not a whole number of the 8 directions, .* the nearest is 45 deg"
    with pytest.raises(ValueError, match=message):
        bounce_shift(np.deg2rad(50), 8)
    with pytest.raises(ValueError, match="bounce: nan deg"):
        bounce_shift(math.nan, 8)


@pytest.mark.parametrize("step", [0.5, math.nan, math.inf])
def test_steps_shorter_than_a_cell_or_not_finite_are_refused(step):
    cells = CellSpace.of_grid(np.ones((3, 3), bool), 8)
    with pytest.raises(ValueError, match=f"step: expected at least one cell, 1 m, got {step} m"):
        moves(cells, motion=Motion(step))


@pytest.mark.parametrize("collision", ["swept", "endpoint"])
def test_a_step_longer_than_the_map_bumps_everywhere(collision):
    # The first grid has fewer rows than columns, the other fewer columns than rows.
    for free in (np.ones((2, 9), bool), np.ones((9, 2), bool)):
        cells = CellSpace.of_grid(free, 8)
        image = np.roll(np.arange(cells.size), -3 * cells.positions)
        for step in (10.0, 1e9):
            result = bounce_map(cells, math.radians(135), motion=Motion(step, collision))
            np.testing.assert_array_equal(result.image, image)
            assert bool(result.bumped.all())
    groups = bounce_groups(cells, math.radians(135), motion=Motion(1e9, collision))
    assert (int(groups.count), set(groups.period.tolist())) == (cells.positions, {8})
    assert walls(free[None], 8, motion=Motion(1e9, collision)).count.tolist() == [[free.size]]


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


@given(MASKS, SETTINGS, st.data())
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
    traced = jax.jit(jax.vmap(lambda room: grid_groups(room, angles, 360)))(free)
    assert totals_at(traced, 2, 7) == totals_at(totals, 2, 7)
    assert totals_at(jax.jit(lambda room: grid_groups(room, angles[4], 360))(free[1])) == totals_at(
        totals, 1, 4
    )


@given(st.lists(MASKS, min_size=2, max_size=4), st.sampled_from(MOTIONS))
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


@given(MASKS, SETTINGS, st.data())
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


def test_a_grid_without_a_free_square_is_refused():
    free = np.ones((2, 3, 4), bool)
    free[1] = False
    with pytest.raises(ValueError, match=r"free: expected a free square .*, got none in number 1"):
        grid_groups(free, math.radians(90), 8)
