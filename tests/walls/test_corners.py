"""Runs past corners and along walls, compared with a robot in fractions on the same map, turned."""

import itertools
import math
from fractions import Fraction

import numpy as np
import pytest
import shapely
from oracles.rays import ExactRoom

from jaxcell import space, walls


LAB_A = [
    [(0, 0), (8, 0), (8, 4), (0, 4)],
    [(1, 1), (3, 1), (3, 3), (1, 3)],
    [(4, 0), (7, 0), (7, 3), (4, 3)],
]
# Two boxes that meet in a point, and one whose corner is beside an alcove.
BOXES = [
    [(0, 0), (8, 0), (8, 6), (4, 6), (4, 7), (2, 7), (2, 6), (0, 6)],
    [(1, 1), (3, 1), (3, 3), (1, 3)],
    [(3, 3), (5, 3), (5, 5), (3, 5)],
    [(6, 1), (7, 2), (6, 3), (5, 2)],
]
# A turn by 45 degrees also stretches the map by the root of 2, so that numbers stay whole.
TURNS = {
    "as it is": lambda x, y: (x, y),
    "mirrored": lambda x, y: (-x, y),
    "by 90": lambda x, y: (-y, x),
    "by 45": lambda x, y: (x - y, x + y),
    "by 45, mirrored": lambda x, y: (y - x, x + y),
}


@pytest.mark.parametrize("turn", TURNS)
@pytest.mark.parametrize("rings", [LAB_A, BOXES], ids=["lab_a", "boxes"])
def test_runs_past_corners_are_those_of_exact_arithmetic(rings, turn):
    boundary, *obstacles = [[TURNS[turn](*corner) for corner in ring] for ring in rings]
    exact = shapely.Polygon(boundary).difference(
        shapely.union_all([*map(shapely.Polygon, obstacles)])
    )
    room = ExactRoom(exact)
    free = walls.Boundary.of(space.Workspace(boundary, obstacles))
    inside = [
        point
        for point in (TURNS[turn](x / 2, y / 2) for x, y in itertools.product(range(17), range(15)))
        if exact.covers(shapely.Point(point))
    ]
    # Where two boxes meet, a robot would be on one side of both.
    between = TURNS[turn](3, 3) if rings is BOXES else None
    starts = [start for start in itertools.product(inside, range(8)) if start[0] != between]
    expected = []
    for (x, y), heading in starts:
        end, distance = room.run((Fraction(x), Fraction(y)), heading)
        expected.append((*map(float, end), room.length(heading, distance)))
    place, heading = np.array([point for point, _ in starts]), np.array([k for _, k in starts])
    wall, arc, run = walls.run_to_wall(free, place, heading * math.tau / 8)
    found = np.column_stack([free.point(wall, arc), run])
    np.testing.assert_allclose(found, expected, atol=1e-7)


def test_robot_goes_on_along_the_wall_line_behind_a_gap():
    free = walls.Boundary.of(space.Workspace(LAB_A[0], LAB_A[1:]))
    wall, arc, run = walls.run_to_wall(free, np.array([[3.0, 3.0]]), np.zeros(1))
    assert (free.point(wall, arc).tolist(), run.tolist()) == ([[8.0, 3.0]], [5.0])
