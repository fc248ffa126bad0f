import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely
from hypothesis import given, strategies as st
from hypothesis.extra import numpy as hnp

from jaxcell.base.bundled import bundled
from jaxcell.space import CellSpace, Motion, Workspace, free_steps, nearest_cell


BOX = [(0, 0), (4, 0), (4, 3), (0, 3)]


def test_positions_count_row_by_row_from_the_bottom_left():
    free = np.array([[1, 0, 1], [1, 1, 1]], bool)
    cells = CellSpace.of_grid(free, 4, cell=0.5, origin=(10.0, 20.0))
    assert (cells.positions, cells.size) == (5, 20)
    x, y, theta = cells.centre(np.arange(cells.size))
    np.testing.assert_allclose(x[:5], [10.25, 11.25, 10.25, 10.75, 11.25])
    np.testing.assert_allclose(y[:5], [20.25, 20.25, 20.75, 20.75, 20.75])
    np.testing.assert_allclose(theta, np.repeat([0, np.pi / 2, np.pi, 3 * np.pi / 2], 5))


def test_the_first_cell_of_the_dissertation_is_our_zero():
    cells = CellSpace.of_grid(np.ones((6, 8), bool), 8)
    # Cell 104 of 384, counted from 1, is position 7 of direction 2.
    x, y, theta = cells.centre(104 - 1)
    assert (float(x), float(y)) == (7.5, 0.5)
    assert float(theta) == pytest.approx(np.pi / 2)


@given(hnp.arrays(bool, (4, 5)).filter(np.any), st.integers(1, 12), st.floats(0.01, 100))
def test_index_inverts_centre(free, directions, side):
    cells = CellSpace.of_grid(free, directions, cell=side, origin=(-3.7, 11.1))
    z = np.arange(cells.size)
    np.testing.assert_array_equal(cells.index(*cells.centre(z)), z)


def test_a_cell_is_free_if_its_centre_is():
    triangle = Workspace([(0, 0), (6, 0), (0, 6)])
    cells = CellSpace.of(triangle, 1.0, 1)
    # Centres (c + 1/2, r + 1/2) with c + r + 1 <= 6: those on the slanted wall count.
    expected = np.add.outer(np.arange(6), np.arange(6)) <= 5
    np.testing.assert_array_equal(cells.free, expected)


def test_a_disc_robot_keeps_its_radius_from_the_walls():
    cells = CellSpace.of(Workspace(BOX, robot_radius=0.6), 1.0, 1)
    assert cells.positions == 2
    assert CellSpace.of(Workspace(BOX, robot_radius=0.5), 1.0, 1).positions == 12


def test_ties_go_up_and_right():
    cells = CellSpace.of(Workspace(BOX), 1.0, 8)
    assert cells.index(1.0, 1.0) == cells.index(1.5, 1.5)
    assert cells.index(1.0 - 1e-12, 1.0) == cells.index(1.5, 1.5)
    eighth = np.pi / 8
    assert cells.index(0.5, 0.5, eighth) == cells.index(0.5, 0.5, 2 * eighth)
    assert cells.index(0.5, 0.5, -eighth) == cells.index(0.5, 0.5, 0.0)
    assert cells.index(0.5, 0.5, 7 * np.pi) == cells.index(0.5, 0.5, np.pi)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda w: CellSpace.of(w, 0.0, 8), "cell: the side must be"),
        (lambda w: CellSpace.of(w, float("nan"), 8), "cell: the side must be"),
        (lambda w: CellSpace.of(w, 1.0, 0), "directions: at least 1"),
        (lambda w: CellSpace.of(w, 1e-5, 8), "squares"),
        (lambda w: CellSpace.of(w, 0.001, 360), "more than the 2147483647 cells"),
        (lambda w: CellSpace.of(w, 1.0, 8).index(5.0, 1.0), "off the map"),
        (lambda w: CellSpace.of(w, 1.0, 8).index(np.inf, 1.0), "finite"),
        (lambda w: CellSpace.of(w, 1.0, 8).centre(96), "cell 96 does not exist; cells are 0 to 95"),
        (lambda w: CellSpace.of(w, 1.0, 8).centre(-1), "cell -1 does not exist"),
    ],
)
def test_numbers_out_of_range_are_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call(Workspace(BOX))


def test_points_in_obstacles_and_spaces_without_centres_are_refused():
    walled = Workspace(BOX, obstacles=[[(1, 1), (2, 1), (2, 2), (1, 2)]])
    with pytest.raises(ValueError, match="in an obstacle"):
        CellSpace.of(walled, 1.0, 8).index(1.5, 1.5)
    with pytest.raises(ValueError, match="no cell of side 10 m"):
        CellSpace.of(Workspace([(0, 0), (1, 0), (0, 1)]), 10.0, 8)
    with pytest.raises(ValueError, match="got cells of a grid"):
        _ = CellSpace.of_grid(np.ones((1, 2), bool), 4).room


def test_walls_along_the_grid_are_recognised():
    obstacle = [(1, 1), (2, 1), (2, 2), (1, 2)]
    assert CellSpace.of(Workspace(BOX, [obstacle]), 1.0, 8).gridded
    assert CellSpace.of(Workspace(BOX, [obstacle]), 0.5, 8).gridded
    assert not CellSpace.of(Workspace(BOX, [obstacle]), 0.7, 8).gridded
    assert not CellSpace.of(Workspace(BOX, [[(1, 1), (2, 1), (2, 2)]]), 1.0, 8).gridded
    assert not CellSpace.of(Workspace(BOX, [obstacle], robot_radius=0.1), 1.0, 8).gridded


def test_free_space_lies_to_the_left_of_the_walls():
    cells = CellSpace.of(Workspace(BOX, [[(1, 1), (2, 1), (1.5, 2)]]), 0.5, 8)
    before, start, end = np.moveaxis(cells.walls, 1, 0)
    middle, along = (start + end) / 2, end - start
    left = middle + 1e-6 * np.stack([-along[:, 1], along[:, 0]], axis=1)
    assert shapely.contains_xy(cells.workspace.free_space, *(left * 0.5).T).all()
    assert {tuple(e) for e in end} == {tuple(s) for s in start} == {tuple(b) for b in before}


@pytest.mark.parametrize("name", ["complex", "depot", "cafe", "slanted"])
@pytest.mark.parametrize("shift", [(448211.25, 4411876.75), (448211.37, 4411876.91)])
@pytest.mark.parametrize("collision", ["swept", "endpoint"])
def test_a_map_far_from_the_origin_has_the_same_cells_and_steps(name, shift, collision):
    near = Workspace.load(bundled(name))
    rings = [ring + np.array(shift) for ring in (near.boundary, *near.obstacles)]
    far = Workspace(rings[0], rings[1:], near.robot_radius)
    side, directions = near.cell, near.directions
    cells, moved = (CellSpace.of(room, side, directions) for room in (near, far))
    assert np.array_equal(cells.free, moved.free)
    motion = Motion(collision=collision)
    steps = [free_steps(room, motion) for room in (cells, moved)]
    assert np.array_equal(*steps)


@pytest.mark.parametrize("transformed", [jax.jit, jax.vmap])
def test_centres_and_cells_are_the_same_in_a_compiled_program(transformed):
    rng = np.random.default_rng(0)
    cells = CellSpace.of_grid(rng.random((7, 9)) < 0.8, 12, cell=0.3, origin=(-1.1, 0.7))
    z = np.arange(cells.size)
    centres = cells.centre(z)
    for found, expected in zip(transformed(cells.centre)(z), centres, strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-14)
    x, y, theta = centres
    near = x + 0.1, y - 0.1, theta + 0.2
    np.testing.assert_array_equal(transformed(cells.index)(*near), z)
    far = x - 0.5, y + 9.0, theta
    np.testing.assert_array_equal(
        transformed(lambda *place: nearest_cell(cells, *place))(*far), nearest_cell(cells, *far)
    )


def test_traced_cells_that_do_not_exist_and_points_off_the_map_have_no_centre_and_no_cell():
    cells = CellSpace.of_grid(np.array([[1, 0, 1]], bool), 4)
    assert np.isnan(jax.jit(cells.centre)(np.array([-1, cells.size]))).all()
    off = jnp.array([1.5, -0.5, 3.5, jnp.nan, 0.5, 1e300])
    assert jax.vmap(lambda x: cells.index(x, 0.5))(off).tolist() == [-1, -1, -1, -1, 0, -1]
    assert jax.jit(lambda theta: cells.index(0.5, 0.5, theta))(jnp.nan) == -1
