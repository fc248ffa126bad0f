"""The map of cells and offsets, compared with robots off the centre and with rays."""

import math

import numpy as np
import pytest
from oracles.rays import INSIDE, Rays

from jaxcell.base.bundled import bundled
from jaxcell.bounce import localization_filter
from jaxcell.bounce.localization.off_centre import OffCentre
from jaxcell.bounce.localization.offsets import Offsets
from jaxcell.space import CellSpace, stride_legs


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
    with pytest.raises(ValueError, match=r"do not run along the edges.*--anywhere"):
        Offsets.of(CellSpace.load(bundled("cafe")))
    with pytest.raises(ValueError, match=r"at least 4 classes.*--anywhere"):
        Offsets.of(CellSpace.load(bundled("lab_a")), limit=3)
