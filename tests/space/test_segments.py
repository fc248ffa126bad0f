import typing

import numpy as np
import pytest
import shapely
from hypothesis import HealthCheck, given, settings, strategies as st
from hypothesis.extra import numpy as hnp
from random_rooms import cells_of, slanted_rooms
from shapely import box

from jaxcell.base.limits import Collision
from jaxcell.space import ENDPOINT, CellSpace, Motion, Workspace, free_steps, motion, stencil
from jaxcell.space.steps import Steps


def workspace_of(free):
    """The map whose obstacles are the blocked squares."""
    obstacles = [box(x, y, x + 1, y + 1) for y, x in np.argwhere(~free)]
    return Workspace(box(0, 0, *free.shape[::-1]), obstacles)


@pytest.fixture(params=[*motion.RULES, "landing"])
def rule(request, monkeypatch):
    """The name of a rule; the last is that of a stranger, without quick functions."""
    if request.param != "landing":
        yield request.param
        return
    # The robot jumps over obstacles in the first half of its step.
    landing = motion.Rule(lambda paths: shapely.linestrings((paths + paths[:, -1:]) / 2))
    monkeypatch.setitem(motion.RULES, "swept", landing)
    stencil.cache_clear()
    yield "swept"
    stencil.cache_clear()


def test_names_in_the_help_are_those_of_the_rules():
    assert list(motion.RULES) == list(typing.get_args(Collision))


@settings(max_examples=20, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    hnp.arrays(bool, (4, 5), elements=st.sampled_from([True, True, False])).filter(np.any),
    st.sampled_from(
        [(4, 1.0), (8, 1.0), (8, 2.0), (12, 1.0), (12, 2.5), (20, 1.7), (8, 1.5 * 2**0.5)]
    ),
)
def test_squares_and_walls_agree(rule, free, scale):
    directions, step = scale
    cells = CellSpace.of(workspace_of(free), 1.0, directions)
    assert cells.gridded
    np.testing.assert_array_equal(cells.free, free)
    steps = Steps.of(cells, Motion(step, rule))
    expected = free_steps(cells, Motion(step, rule))
    np.testing.assert_array_equal(steps.targets(cells)[steps.way], expected)


@settings(max_examples=20, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    hnp.arrays(bool, (4, 5), elements=st.sampled_from([True, True, False])).filter(np.any),
    st.sampled_from([(4, 1.0), (8, 1.0), (8, 2.0), (12, 2.5), (20, 1.7), (8, 1.5 * 2**0.5)]),
)
def test_a_rule_is_its_part_in_the_closed_free_space(rule, free, scale):
    directions, step = scale
    cells = CellSpace.of(workspace_of(free), 1.0, directions)
    closed = shapely.union_all([box(x, y, x + 1, y + 1) for y, x in np.argwhere(free)])
    # The swept rule also forbids to pass points where two obstacles meet.
    points = [
        (x + 1, y + 1)
        for y, x in np.ndindex(3, 4)
        if free[y, x] == free[y + 1, x + 1] != free[y, x + 1] == free[y + 1, x]
    ]
    pinches = shapely.MultiPoint(points)
    targets = free_steps(cells, Motion(step, rule))
    x, y, _ = cells.centre(np.arange(cells.positions))
    for direction in range(directions):
        angle = 2 * np.pi * direction / directions
        ends = x + step * np.cos(angle), y + step * np.sin(angle)
        paths = np.moveaxis(np.stack([(x, y), ends]), 2, 0)
        parts = motion.RULES[rule].part(paths)
        inside = shapely.covers(closed.buffer(1e-7, join_style="mitre"), parts)
        for position in np.flatnonzero(shapely.distance(pinches, parts) > 1e-7 if points else x):
            column, row = np.floor(np.round(paths[position, 1], 9)).astype(int)
            on_map = 0 <= row < 4 and 0 <= column < 5 and free[row, column]
            end = cells.position_of_square[row, column] if inside[position] and on_map else position
            assert targets[direction, position] == end


@pytest.mark.parametrize("blocked", [[], [(1, 2)], [(2, 1)], [(1, 2), (2, 1)]])
def test_a_step_may_end_in_a_corner_unless_two_obstacles_meet_there(blocked):
    free = np.ones((3, 3), bool)
    free[tuple(np.array(blocked, int).reshape(-1, 2).T)] = False
    cells = CellSpace.of(workspace_of(free), 1.0, 8)
    motion = Motion(1.5 * 2**0.5)
    steps = Steps.of(cells, motion)
    end = 0 if len(blocked) == 2 else cells.positions - 1
    assert steps.targets(cells)[steps.way][1, 0] == free_steps(cells, motion)[1, 0] == end


@given(
    slanted_rooms(st.floats(0, 6, allow_subnormal=False), (0.0, 0.0, 0.3)),
    st.sampled_from([(7, 1.0), (16, 1.0), (9, 2.3)]),
)
def test_a_step_is_free_if_its_segment_is_covered(room, scale):
    directions, step = scale
    cells = cells_of(room, 0.9, directions)
    # Steps that touch a wall within a rounding error have tests of their own below.
    surely, maybe = (cells.workspace.free_space.buffer(margin) for margin in (-1e-6, 1e-6))
    x, y, _ = cells.centre(np.arange(cells.positions))
    for rule in ("swept", "endpoint"):
        targets = free_steps(cells, Motion(step * cells.cell, rule))
        for direction in range(directions):
            angle = 2 * np.pi * direction / directions
            ends = np.stack([x, y, x + 0.9 * step * np.cos(angle), y + 0.9 * step * np.sin(angle)])
            ends = ends.T.reshape(-1, 2, 2)
            shapes = shapely.linestrings(ends) if rule == "swept" else shapely.points(ends[:, 1])
            covered = shapely.covers(surely, shapes)
            clear = covered == shapely.covers(maybe, shapes)
            for position in np.flatnonzero(clear):
                try:
                    expected = (
                        int(cells.index(*ends[position, 1])) if covered[position] else position
                    )
                except ValueError:
                    expected = position
                assert targets[direction, position] == expected, (rule, direction, position)


ROOM, FLOOR, THIN = box(0, 0, 6, 6), box(0, 0, 6, 1.5), box(1.9, 0, 2.1, 6)
# The corner of an obstacle to the lower left of the centre (1.5, 1.5).
CORNER = box(0.6, 0.6, 1.5, 1.5)
# The tip of a triangle that points at the path of a diagonal step, and another tip at that point.
TIP, OTHER_TIP = [(2, 2), (3, 1), (3.5, 1.2)], [(2, 2), (1, 3), (1.2, 3.5)]


@pytest.mark.parametrize(
    ("obstacles", "direction", "free"),
    [
        # A step may graze a corner.
        ([box(2, 1, 3, 2)], 1, True),
        ([box(1, 2, 2, 3)], 1, True),
        ([TIP], 1, True),
        # It may not slip between two obstacles that meet in a point.
        ([box(2, 1, 3, 2), box(1, 2, 2, 3)], 1, False),
        ([TIP, OTHER_TIP], 1, False),
        # It may run along a wall, but not past a point where another obstacle meets the wall.
        ([FLOOR], 0, True),
        ([FLOOR], 6, False),
        ([FLOOR, [(2, 1.5), (2.5, 3), (1.5, 3)]], 0, False),
        ([FLOOR, [(2, 1.6), (2.5, 3), (1.5, 3)]], 0, True),
        # It may not go through an obstacle that is thinner than the step.
        ([THIN], 0, False),
        # It may leave a corner into the free side, and along the sides of the corner.
        ([CORNER], 5, False),
        *(([CORNER], direction, True) for direction in (0, 1, 2, 4, 6)),
    ],
)
def test_steps_beside_walls(obstacles, direction, free):
    cells = CellSpace.of(Workspace(ROOM, obstacles), 1.0, 8)
    position = int(cells.index(1.5, 1.5))
    assert (free_steps(cells)[direction, position] != position) == free


def test_a_step_whose_end_is_tested_goes_through_a_thin_obstacle():
    cells = CellSpace.of(Workspace(ROOM, [THIN]), 1.0, 8)
    assert free_steps(cells, ENDPOINT)[0, cells.index(1.5, 1.5)] == cells.index(2.5, 1.5)


@pytest.mark.parametrize("step", [41.0, 1e9, 1e300])
@pytest.mark.parametrize("collision", ["swept", "endpoint"])
def test_a_step_longer_than_the_map_leads_nowhere(step, collision):
    shape = stencil(36, Motion(step, collision), (20, 35))
    assert len(shape.offset) == len(shape.crossed) == 1
    cells = CellSpace.of(Workspace([(0, 0), (35, 0), (33, 20), (0, 18)]), 1.0, 36)
    targets = free_steps(cells, Motion(step, collision))
    np.testing.assert_array_equal(targets, np.tile(np.arange(cells.positions), (36, 1)))


def test_steps_that_lead_off_the_map_are_one_way():
    # Steps of thirty squares lead off a map of twenty rows to the North and South only.
    shape = stencil(8, Motion(30.0, "endpoint"), (20, 35))
    off = shape.way[[1, 2, 3, 5, 6, 7]]
    assert len(set(off.tolist())) == 1
    assert len(set(shape.way.tolist())) == 3
    assert shape.offset[shape.way[[0, 4]]].tolist() == [[0, 30], [0, -30]]
