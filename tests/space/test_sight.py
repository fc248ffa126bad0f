import numpy as np
import pytest
import shapely
from hypothesis import given, strategies as st
from hypothesis.extra import numpy as hnp
from random_rooms import cells_of, slanted_rooms
from shapely import box

from jaxcell.space import CellSpace, Workspace, visible_cells
from jaxcell.space.sight import AT_CENTRE


ROOM = box(0, 0, 6, 6)
RADII = 0.0, 0.3


def cells_among(*obstacles, boundary=ROOM, cell=1.0):
    return CellSpace.of(Workspace(boundary, obstacles), cell, 1)


def sees(cells, start, end, reach=20.0):
    return bool(visible_cells(cells, reach)[cells.index(*start), cells.index(*end)])


def parts_of(cells):
    """List the triangles of the free part of each cell: their cell, and their corners."""
    x, y, _ = cells.centre(np.arange(cells.positions))
    half = cells.cell / 2
    boxes = box(x - half, y - half, x + half, y + half)
    free = shapely.intersection(cells.workspace.environment, boxes)
    triangles, of = shapely.get_parts(
        shapely.constrained_delaunay_triangles(free), return_index=True
    )
    return of, shapely.get_coordinates(triangles).reshape(-1, 4, 2)


@given(slanted_rooms(radii=RADII), st.floats(0.7, 7))
def test_a_cell_is_visible_if_the_hull_of_its_parts_and_the_centre_is_free(room, reach):
    cells = cells_of(room, 1.1)
    x, y, _ = cells.centre(np.arange(cells.positions))
    of, corners = parts_of(cells)
    visible = visible_cells(cells, reach)
    for i in range(cells.positions):
        here = np.broadcast_to([x[i], y[i]], (len(of), 1, 2))
        hulls = shapely.convex_hull(shapely.multipoints(np.concatenate([here, corners], axis=1)))
        hidden = shapely.area(shapely.difference(hulls, cells.workspace.environment))
        hidden = np.bincount(of, hidden)
        far = np.full(cells.positions, -np.inf)
        np.maximum.at(far, of, np.hypot(*np.moveaxis(corners - here, -1, 0)).max(axis=1) - reach)
        # Cases that a rounding error decides have tests of their own below.
        clear = ((hidden < 1e-12) | (hidden > 1e-6)) & (np.abs(far) > 1e-6)
        expected = (hidden < 1e-6) & (far < 0)
        np.testing.assert_array_equal(visible[i][clear], expected[clear])


@given(
    hnp.arrays(bool, (6, 5), elements=st.sampled_from([True, True, False])).filter(np.any),
    st.sampled_from([0.6, 1.0, 1.6, 2.9, 3.6, np.inf]),
)
def test_squares_are_exact(free, reach):
    # All coordinates are halves, so that shapely's predicates are exact.
    cells = CellSpace.of_grid(free, 1)
    squares = [box(c, r, c + 1, r + 1) for r, c in np.argwhere(free)]
    environment = shapely.union_all(squares)
    visible = visible_cells(cells, reach)
    for i, here in enumerate(squares):
        for j, there in enumerate(squares):
            hull = shapely.union(here.centroid, there).convex_hull
            x, y = shapely.get_coordinates(there).T
            near = np.hypot(x - here.centroid.x, y - here.centroid.y).max() <= reach
            assert visible[i, j] == (near and environment.covers(hull))


@given(
    hnp.arrays(bool, (4, 5), elements=st.sampled_from([True, True, False])).filter(np.any),
    st.floats(0.05, 20),
)
def test_a_map_of_any_scale_is_as_its_grid(free, side):
    grid = CellSpace.of_grid(free, 1, cell=side, origin=(-7.3, 2.1))

    def rectangle(left, bottom, right, top):
        return box(-7.3 + left * side, 2.1 + bottom * side, -7.3 + right * side, 2.1 + top * side)

    obstacles = [rectangle(c, r, c + 1, r + 1) for r, c in np.argwhere(~free)]
    cells = cells_among(*obstacles, boundary=rectangle(0, 0, *free.shape[::-1]), cell=side)
    np.testing.assert_array_equal(cells.free, free)
    for reach in (2.0 * side, 3.2 * side):
        np.testing.assert_array_equal(visible_cells(cells, reach), visible_cells(grid, reach))


@given(slanted_rooms(radii=RADII), st.floats(0.5, 7))
def test_a_centre_is_visible_if_the_segment_to_it_is_free(room, reach):
    cells = cells_of(room, 0.7)
    visible = visible_cells(cells, reach, part=AT_CENTRE)
    surely, maybe = (cells.workspace.environment.buffer(margin) for margin in (-1e-6, 1e-6))
    x, y, _ = cells.centre(np.arange(cells.positions))
    i, j = np.nonzero(~np.eye(cells.positions, dtype=bool))
    ends = np.stack([x[i], y[i], x[j], y[j]], axis=1).reshape(-1, 2, 2)
    distance = np.hypot(*(ends[:, 1] - ends[:, 0]).T)
    lines = shapely.linestrings(ends)
    covered = shapely.covers(surely, lines)
    clear = (covered == shapely.covers(maybe, lines)) & (np.abs(distance - reach) > 1e-6)
    expected = covered & (distance <= reach)
    np.testing.assert_array_equal(visible[i, j][clear], expected[clear])


def test_all_of_a_cell_has_to_be_in_range():
    cells = cells_among()
    here, beside, across = (cells.index(*p) for p in ((0.5, 0.5), (1.5, 0.5), (1.5, 1.5)))
    own, next_to, corner = np.sqrt(0.5), np.sqrt(2.5), np.sqrt(4.5)
    for reach, seen in ((own, 1), (next_to, 3), (corner, 4)):
        assert visible_cells(cells, reach)[here].sum() == seen
        assert visible_cells(cells, reach - 1e-6)[here].sum() < seen
    assert visible_cells(cells, next_to)[here, beside]
    assert visible_cells(cells, corner)[here, across]


def test_sight_runs_along_a_wall():
    low = cells_among(box(1, 1, 5, 2))
    assert sees(low, (0.5, 0.5), (5.5, 0.5))
    assert sees(low, (0.5, 2.5), (5.5, 2.5))
    # The top of this wall runs through a row of centres.
    halved = cells_among(box(1, 0, 5, 2.5))
    assert sees(halved, (0.5, 2.5), (4.5, 2.5))
    assert not sees(halved, (0.5, 2.5), (5.5, 2.5))


def test_sight_grazes_a_corner_and_the_cell_behind_it_is_hidden():
    cells = cells_among(box(2, 1, 3, 2))
    # The line from (1.5, 0.5) to the corner (2, 1) goes on along the diagonal.
    assert sees(cells, (1.5, 1.5), (1.5, 3.5))
    assert not sees(cells, (1.5, 1.5), (2.5, 2.5))
    assert sees(cells, (1.5, 2.5), (2.5, 2.5))
    assert not sees(cells, (1.5, 1.5), (3.5, 1.5))
    assert not sees(cells, (0.5, 1.5), (5.5, 1.5))


def test_the_blocked_part_of_a_cell_need_not_be_seen():
    # The wall leaves three quarters of each square of the column from 2 to 3.
    cells = cells_among(box(2.75, 0, 6, 6))
    assert cells.positions == 18
    assert visible_cells(cells, 20.0).all()
    # The range, too, counts to what is free.
    assert sees(cells, (0.5, 0.5), (2.5, 0.5), np.hypot(2.25, 0.5))
    assert not sees(cells, (0.5, 0.5), (2.5, 0.5), np.hypot(2.25, 0.5) - 1e-6)


def test_a_cell_that_a_wall_cuts_in_two_is_never_seen():
    cells = cells_among(box(2.6, 0, 2.7, 6))
    visible = visible_cells(cells, 20.0)
    cut = cells.index(2.5, np.arange(6) + 0.5)
    assert not visible[:, cut].any()
    assert np.delete(visible, cut, axis=1).any(axis=0).all()


def test_a_centre_on_a_wall_sees_its_free_side():
    cells = cells_among(box(1.5, 1.5, 3.5, 3.5))
    for wall, seen, hidden in (
        ((1.5, 2.5), (0.5, 2.5), (4.5, 2.5)),
        ((2.5, 1.5), (2.5, 0.5), (2.5, 4.5)),
        ((1.5, 1.5), (0.5, 0.5), (4.5, 4.5)),
        ((1.5, 1.5), (5.5, 0.5), (4.5, 3.5)),
    ):
        assert sees(cells, wall, wall)
        assert sees(cells, wall, seen)
        assert not sees(cells, wall, hidden)


def test_the_radius_of_the_robot_is_no_wall():
    pillar = box(2.9, 2.9, 3.1, 3.1)
    point, disc = (CellSpace.of(Workspace(ROOM, [pillar], radius), 0.5, 1) for radius in (0.0, 0.4))
    same = point.position_of_square.ravel()[disc.square]
    assert disc.positions < point.positions
    expected = visible_cells(point, 3.0)[np.ix_(same, same)]
    np.testing.assert_array_equal(visible_cells(disc, 3.0), expected)


@pytest.mark.parametrize("reach", [0, -1.0, np.nan])
def test_ranges_that_are_not_positive_are_refused(reach):
    with pytest.raises(ValueError, match="reach: expected more than 0 m, got"):
        visible_cells(cells_among(), reach)


def test_a_centre_is_seen_if_a_segment_to_it_is_free_and_grazes_no_corner():
    cells = cells_among(box(2.17, 1.31, 3.13, 4.23))
    centres = visible_cells(cells, 4.05, part=AT_CENTRE)
    whole = visible_cells(cells, 4.05)
    assert not (whole & ~centres).any()
    assert (centres & ~whole).any()
    # A ray over the corner of a square pillar does not see what is behind it.
    corner = cells_among(box(2, 1, 3, 2))
    ends = corner.index(1.5, 1.5), corner.index(2.5, 2.5)
    assert not visible_cells(corner, 20.0, part=AT_CENTRE)[ends]
    with pytest.raises(ValueError, match=r"part: expected 1e-06 to 1, got 0"):
        visible_cells(cells, 4.0, part=0)
