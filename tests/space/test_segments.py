import numpy as np
import pytest
import shapely
from hypothesis import given, strategies as st
from hypothesis.extra import numpy as hnp
from random_rooms import cells_of, slanted_rooms
from shapely import box

from jaxcell.space import ENDPOINT, CellSpace, Motion, Workspace, free_steps, stencil
from jaxcell.space.steps import Steps


def workspace_of(free):
    """The map whose obstacles are the blocked squares."""
    obstacles = [box(x, y, x + 1, y + 1) for y, x in np.argwhere(~free)]
    return Workspace(box(0, 0, *free.shape[::-1]), obstacles)


@given(
    hnp.arrays(bool, (4, 5), elements=st.sampled_from([True, True, False])).filter(np.any),
    st.sampled_from(
        [(4, 1.0), (8, 1.0), (8, 2.0), (12, 1.0), (12, 2.5), (20, 1.7), (8, 1.5 * 2**0.5)]
    ),
    st.sampled_from(["swept", "endpoint"]),
)
def test_squares_and_walls_agree(free, scale, collision):
    directions, step = scale
    cells = CellSpace.of(workspace_of(free), 1.0, directions)
    assert cells.gridded
    np.testing.assert_array_equal(cells.free, free)
    motion = Motion(step, collision)
    steps = Steps.of(cells, motion)
    np.testing.assert_array_equal(steps.targets(cells)[steps.way], free_steps(cells, motion))


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


def step(workspace, start, direction):
    cells = CellSpace.of(workspace, 1.0, 8)
    position = int(cells.index(*start))
    return bool(free_steps(cells)[direction, position] != position)


ROOM = box(0, 0, 6, 6)


def test_step_may_graze_a_corner():
    assert step(Workspace(ROOM, [box(2, 1, 3, 2)]), (1.5, 1.5), 1)
    assert step(Workspace(ROOM, [box(1, 2, 2, 3)]), (1.5, 1.5), 1)
    # The tip of a triangle that points at the path.
    assert step(Workspace(ROOM, [[(2, 2), (3, 1), (3.5, 1.2)]]), (1.5, 1.5), 1)


def test_step_may_not_slip_between_two_obstacles_that_meet_in_a_point():
    assert not step(Workspace(ROOM, [box(2, 1, 3, 2), box(1, 2, 2, 3)]), (1.5, 1.5), 1)
    tips = [[(2, 2), (3, 1), (3.5, 1.2)], [(2, 2), (1, 3), (1.2, 3.5)]]
    assert not step(Workspace(ROOM, tips), (1.5, 1.5), 1)


def test_step_may_run_along_a_wall():
    floor = box(0, 0, 6, 1.5)
    assert step(Workspace(ROOM, [floor]), (1.5, 1.5), 0)
    assert not step(Workspace(ROOM, [floor]), (1.5, 1.5), 6)


def test_step_may_not_run_along_a_wall_past_a_point_where_another_obstacle_meets_it():
    floor = box(0, 0, 6, 1.5)
    assert not step(Workspace(ROOM, [floor, [(2, 1.5), (2.5, 3), (1.5, 3)]]), (1.5, 1.5), 0)
    assert step(Workspace(ROOM, [floor, [(2, 1.6), (2.5, 3), (1.5, 3)]]), (1.5, 1.5), 0)


def test_step_may_not_go_through_an_obstacle_thinner_than_a_step():
    thin = box(1.9, 0, 2.1, 6)
    assert not step(Workspace(ROOM, [thin]), (1.5, 1.5), 0)
    cells = CellSpace.of(Workspace(ROOM, [thin]), 1.0, 8)
    position = int(cells.index(1.5, 1.5))
    assert free_steps(cells, ENDPOINT)[0, position] == cells.index(2.5, 1.5)


@pytest.mark.parametrize(
    ("direction", "free"), [(0, True), (1, True), (2, True), (4, False), (6, False)]
)
def test_step_may_leave_a_corner_into_the_free_side(direction, free):
    # The centre (1.5, 1.5) is the corner of an obstacle to its lower left.
    corner = box(0.6, 0.6, 1.5, 1.5)
    assert step(Workspace(ROOM, [corner]), (1.5, 1.5), direction) == (free or direction in (4, 6))


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
