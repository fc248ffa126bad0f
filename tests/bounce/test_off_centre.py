"""Robots off the centres of cells, and maps of cells and offsets, compared with rays."""

import dataclasses
import math

import numpy as np
import pytest
import shapely
from oracles.rays import INSIDE, Rays

from jaxcell.base.bundled import bundled
from jaxcell.bounce import bounce_map, localization_filter, localization_policy
from jaxcell.bounce.joint_image import squares_of
from jaxcell.bounce.localization import off_centre
from jaxcell.bounce.localization.off_centre import OffCentre, filter_shares, policy_shares
from jaxcell.bounce.localization.offsets import Offsets
from jaxcell.space import CELL_BY_CELL, ENDPOINT, CellSpace, cell_strides, stride_legs


def at_centres(cells, index, **motion):
    """Place robots at the centres of the cells `index`."""
    drawn = OffCentre.drawn(cells, index.size, 0, **motion)
    direction, position = np.divmod(index, cells.positions)
    square = squares_of(cells).T[position]
    offset = np.full((index.size, 2), 0.5)
    return dataclasses.replace(drawn, offset=offset, square=square, direction=direction)


@pytest.mark.parametrize("motion", [CELL_BY_CELL, ENDPOINT])
@pytest.mark.parametrize("name", ["lab_a", "cafe", "slanted"])
def test_robots_at_centres_move_as_the_cells_do(name, motion):
    cells = CellSpace.load(bundled(name))
    mapped = bounce_map(cells, math.pi / 2, motion=motion)
    robots = at_centres(cells, np.arange(cells.size), motion=motion)
    bumped = robots.advance()
    robots.turn(bumped * cells.directions // 4)
    np.testing.assert_array_equal(bumped, mapped.bumped)
    np.testing.assert_array_equal(robots.cell, mapped.image)


@pytest.mark.parametrize("motion", [CELL_BY_CELL, ENDPOINT])
@pytest.mark.parametrize("name", ["lab_b", "cafe", "slanted"])
def test_robots_off_the_centre_bump_where_rays_do(name, motion):
    cells = CellSpace.load(bundled(name))
    free = cells.workspace.free_space
    room = Rays(free)
    forward, left = cell_strides(cells.directions, cells.cell, cells.cell).T
    robots = OffCentre.drawn(cells, 500, 1, motion=motion)
    point = (robots.offset + robots.square) * cells.cell + cells.origin
    assert shapely.contains_xy(free, point).all()
    for _ in range(12):
        heading = robots.direction * math.tau / cells.directions
        u = np.stack([np.cos(heading), np.sin(heading)], axis=1)
        across = np.stack([-u[:, 1], u[:, 0]], axis=1)
        f, s = forward[robots.direction, None], left[robots.direction, None]
        end = point + f * u + s * across
        if motion == CELL_BY_CELL:
            able = room.run(point, np.full(500, INSIDE), heading)[0] >= cells.cell
        else:
            able = shapely.contains_xy(free, point + cells.cell * u)
        able &= shapely.contains_xy(free, end)
        point = np.where(able[:, None], end, point)
        bumped = robots.advance()
        np.testing.assert_array_equal(bumped, ~able)
        np.testing.assert_allclose(
            (robots.offset + robots.square) * cells.cell + cells.origin, point, atol=1e-7
        )
        robots.turn(3 * bumped)


def test_a_filter_loses_no_robot_that_starts_at_a_centre(monkeypatch):
    cells = CellSpace.load(bundled("cafe"))
    filter = localization_filter(bounce_map(cells, math.radians(90)))
    policy = localization_policy(cells, np.radians([90.0, 135.0]))
    # Of robots that start anywhere, the filter loses most, and places some wrongly.
    lost, wrong = filter_shares(filter, cells, 4)
    assert lost > 0.5
    assert wrong > 0.01
    assert min(policy_shares(policy.policy, cells, np.array([4, 6]), CELL_BY_CELL)) > 0.01

    class AtCentres(OffCentre):
        @classmethod
        def drawn(cls, cells, count, seed, **motion):
            index = np.random.default_rng(seed).integers(cells.size, size=count)
            return at_centres(cells, index, **motion)

    monkeypatch.setattr(off_centre, "OffCentre", AtCentres)
    assert filter_shares(filter, cells, 4) == (0, 0)
    assert filter_shares(filter.with_trap(), cells, 4) == (0, 0)
    assert policy_shares(policy.policy, cells, np.array([4, 6]), CELL_BY_CELL) == (0, 0)


def test_a_grid_of_squares_loses_no_robot_along_the_axes():
    free = np.ones((3, 4), bool)
    free[1, 1] = False
    cells = CellSpace.of_grid(free, 4)
    filter = localization_filter(bounce_map(cells, math.pi / 2))
    assert filter_shares(filter, cells, 1) == (0, 0)


def held(filter, size, state, cell):
    return [
        one in filter.cells(at) % size
        for at, one in zip(state.tolist(), cell.tolist(), strict=True)
    ]


@pytest.mark.parametrize(
    ("name", "degrees", "directions"),
    [("lab_a", 135, 8), ("lab_b", 135, 8), ("depot", 90, 8), ("lab_a", 90, 12)],
)
def test_filter_loses_no_robot_from_anywhere(name, degrees, directions):
    cells = CellSpace.load(bundled(name), directions=directions)
    filter = localization_filter(Offsets.of(cells).bounce_map(math.radians(degrees)))
    robots = OffCentre.drawn(cells, 1000, 3, walker=True)
    state = np.zeros(1000, int)
    for _ in range(60):
        bumped = robots.advance()
        robots.turn(degrees * directions // 360 * bumped)
        state = filter.transition[state, bumped.astype(int)]
        assert (state >= 0).all()
    assert all(held(filter, cells.size, state, robots.cell))


@pytest.mark.parametrize("name", ["lab_b", "depot"])
def test_filter_holds_robots_that_rays_stop(name):
    cells = CellSpace.load(bundled(name))
    room = Rays(cells.workspace.free_space)
    legs = stride_legs(8, cells.cell, cells.cell)
    assert not legs[:, 1:].any()
    filter = localization_filter(Offsets.of(cells).bounce_map(math.radians(135)))
    drawn = OffCentre.drawn(cells, 200, 5)
    point = (drawn.offset + drawn.square) * cells.cell + cells.origin
    direction, state = drawn.direction, np.zeros(200, int)
    for _ in range(40):
        heading, length = direction * math.tau / 8, legs[direction, 0]
        able = room.run(point, np.full(200, INSIDE), heading)[0] >= length
        u = np.stack([np.cos(heading), np.sin(heading)], axis=1)
        point = np.where(able[:, None], point + length[:, None] * u, point)
        direction = np.where(able, direction, (direction + 3) % 8)
        state = filter.transition[state, (~able).astype(int)]
        assert (state >= 0).all()
    cell = cells.index(*point.T, direction * math.tau / 8)
    assert all(held(filter, cells.size, state, cell))


def test_eight_directions_have_four_classes_between_the_diagonals():
    offsets = Offsets.of(CellSpace.load(bundled("lab_a"))).offset
    x, y = offsets.T
    assert {(a, b) for a, b in zip(x < y, x + y < 1, strict=True)} == {
        (a, b) for a in (False, True) for b in (False, True)
    }
    assert len(offsets) == 4


def test_maps_with_many_classes_are_refused():
    with pytest.raises(ValueError, match=r"do not run along the edges.*localize anywhere"):
        Offsets.of(CellSpace.load(bundled("cafe")))
    with pytest.raises(ValueError, match=r"at least 4 classes.*localize anywhere"):
        Offsets.of(CellSpace.load(bundled("lab_a")), limit=3)
