import itertools
import math

import numpy as np
import pytest
import shapely
from hypothesis import given, reject, strategies as st
from random_rooms import HUNDREDTHS, cells_of, slanted_rooms
from shapely import box

from jaxcell.space import Workspace
from jaxcell.space.view import visibility_polygon


ROOM = box(0, 0, 6, 6)
WALLED = Workspace(ROOM, [box(2, 2, 4, 4)])
POINTS = st.tuples(HUNDREDTHS, HUNDREDTHS)


def visible_from(room, point, *reach):
    """The visible polygon, and the environment; points in obstacles are rejected."""
    workspace = cells_of(room, 1.0).workspace
    try:
        return visibility_polygon(workspace, point, *reach), workspace.environment
    except ValueError:
        reject()


def shadow(here, start, end):
    """Make the shadow of a wall, longer than any map."""
    middle = (start + end) / 2
    far = [here + 200 * (p - here) / np.hypot(*(p - here)) for p in (end, middle, start)]
    return shapely.Polygon([start, end, *far]).buffer(0)


@given(slanted_rooms(), POINTS, st.floats(0.3, 9))
def test_the_polygon_is_the_environment_without_the_shadows_of_walls(room, point, reach):
    polygon, environment = visible_from(room, point, reach)
    assert polygon.is_valid
    here = np.array(point)
    if environment.boundary.distance(shapely.Point(here)) < 1e-6:
        return
    rings = map(shapely.get_coordinates, shapely.get_rings(shapely.get_parts(environment)))
    walls = [wall for ring in rings for wall in itertools.pairwise(ring)]
    expected = environment.intersection(shapely.Point(here).buffer(reach))
    # Where the circle touches a wall from outside, the intersection has points and lines, too.
    expected = shapely.union_all([p for p in shapely.get_parts(expected) if p.area > 0])
    for wall in walls:
        expected = shapely.difference(expected, shadow(here, *wall), grid_size=1e-11)
    assert polygon.symmetric_difference(expected).area < 1e-6


def test_polygons_have_known_areas():
    empty = Workspace(ROOM)
    assert visibility_polygon(empty, (3, 3)).equals(ROOM)
    assert visibility_polygon(empty, (0, 0)).area == pytest.approx(36)
    # A polygon of 64 chords in a circle, and quarters of it.
    whole = 64 * math.sin(math.tau / 64) / 2 * 4
    for point, share in (((3, 3), 1), ((0, 3), 1 / 2), ((6, 6), 1 / 4)):
        assert visibility_polygon(empty, point, 2).area == pytest.approx(share * whole)
    assert 1 - whole / (4 * math.pi) < 0.0017
    # A square wall of side 2, seen from (1, 3), leaves the left third and two triangles.
    assert visibility_polygon(WALLED, (1, 3)).area == pytest.approx(12 + 2 * 2)


def test_the_polygon_has_two_pieces_in_a_point_of_two_obstacles():
    pair = Workspace(ROOM, [box(2, 1, 3, 2), box(1, 2, 2, 3)])
    polygon = visibility_polygon(pair, (2, 2), 1.0)
    assert polygon.is_valid
    assert len(shapely.get_parts(polygon)) == 2
    assert polygon.area == pytest.approx(math.pi / 2, rel=0.002)
    # Nor does sight slip between them.
    across = visibility_polygon(pair, (1.5, 1.5))
    assert across.intersection(box(2, 2, 6, 6)).area == 0


def test_from_a_wall_the_free_side_is_visible():
    assert visibility_polygon(WALLED, (2, 3)).area == pytest.approx(12)
    assert visibility_polygon(WALLED, (2, 2)).area == pytest.approx(36 - 16)


def test_the_radius_of_the_robot_is_no_wall():
    assert visibility_polygon(Workspace(ROOM, robot_radius=1.0), (0.5, 0.5)).area == 36


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"point": (3.0, 3.0)}, r"point: \(3, 3\) lies in an obstacle or outside the boundary"),
        ({"point": (7.0, 3.0)}, "lies in an obstacle or outside"),
        ({"point": (math.nan, 3.0)}, "point: expected two finite numbers"),
        ({"point": (1.0, 2.0, 3.0)}, "point: expected two finite numbers"),
        ({"reach": 0.0}, "reach: expected more than 0 m, got 0.0"),
        ({"reach": math.nan}, "reach: expected more than 0 m, got nan"),
    ],
)
def test_points_and_numbers_out_of_range_are_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        visibility_polygon(**{"workspace": WALLED, "point": (1.0, 1.0)} | changes)
