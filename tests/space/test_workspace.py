import math
import pickle
import re

import numpy as np
import pytest
import shapely
from hypothesis import example, given, reject, strategies as st

from jaxcell.space import Workspace


ROOM = [(0, 0), (6, 0), (6, 5), (0, 5)]


def box(xmin, ymin, xmax, ymax):
    return [(xmin, ymin), (xmax, ymin), (xmax, ymax), (xmin, ymax)]


def test_fields_are_normalised():
    room = Workspace([*ROOM, (0, 0)], [box(1, 1, 2, 2)], cell=1, name="room", directions=8)
    assert room.boundary.dtype == np.float64
    assert room.boundary.tolist() == [[0, 0], [6, 0], [6, 5], [0, 5]]
    assert room.obstacles[0].tolist() == [[1, 1], [2, 1], [2, 2], [1, 2]]
    assert (room.robot_radius, room.cell, room.directions) == (0.0, 1.0, 8)
    assert room.free_space.equals(shapely.Polygon(ROOM, [box(1, 1, 2, 2)]))
    with pytest.raises(ValueError, match="read-only"):
        room.boundary[0] = 1


def test_shapely_polygons_are_taken():
    room = Workspace(shapely.Polygon(ROOM), [shapely.Point(3, 3).buffer(1)])
    assert len(room.boundary) == 4
    assert room.free_space.area == pytest.approx(30 - shapely.Point(3, 3).buffer(1).area)


def test_a_map_survives_pickling():
    room = pickle.loads(pickle.dumps(Workspace(ROOM, [box(1, 1, 2, 2)], robot_radius=0.1)))
    assert room.free_space.equals(Workspace(ROOM, [box(1, 1, 2, 2)], robot_radius=0.1).free_space)


@pytest.mark.parametrize(
    ("obstacles", "area", "pieces"),
    [
        ([], 30, 1),
        ([box(2, 0, 3, 2)], 28, 1),  # touches the boundary
        ([box(2, -1, 3, 2)], 28, 1),  # reaches over it
        ([box(1, 1, 3, 3), box(2, 2, 4, 4)], 23, 1),  # overlap
        ([box(1, 1, 2, 2), box(2, 1, 3, 2)], 28, 1),  # share a side
        ([box(2, -1, 3, 6)], 25, 2),
        ([box(0, 2, 6, 3), box(2, 0, 3, 5)], 20, 4),
        ([box(-1, -1, 3, 2), box(3, 2, 7, 6)], 30 - 15, 2),  # meet in one point
        ([box(1, 1, 4, 2), box(1, 3, 4, 4), box(1, 1, 2, 4), box(3, 1, 4, 4)], 22, 2),  # a ring
        ([box(1, 1, 2, 2)] * 3, 29, 1),
    ],
)
def test_obstacles_count_as_their_union(obstacles, area, pieces):
    room = Workspace(ROOM, obstacles)
    assert room.free_space.area == area
    assert room.pieces == pieces
    assert room.free_space.is_valid


def test_the_margin_of_a_disc_robot():
    r = 0.5
    room = Workspace(ROOM, [box(2, 2, 3, 3)], robot_radius=r)
    # Convex corners of the room stay sharp; round the obstacle the margin is rounded.
    exact = 5 * 4 - (1 + 4 * r + math.pi * r**2)
    assert exact <= room.free_space.area <= exact + 0.002 * math.pi * r**2
    assert room.environment.area == 29


@given(st.floats(0, 2 * np.pi), st.floats(0.05, 1.2))
def test_the_margin_leaves_room_for_the_disc(angle, radius):
    """Every point of the free space's edge is a radius away from the walls, within a chord."""
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    room = Workspace(
        np.array(ROOM) @ turn.T, [np.array(box(2, 2, 3, 3)) @ turn.T], robot_radius=radius
    )
    walls = room.environment.boundary
    for part in shapely.get_parts(room.free_space.boundary):
        for along in np.linspace(0, 1, 50):
            gap = shapely.distance(part.interpolate(along, normalized=True), walls)
            assert 0.9987 * radius <= gap <= radius * (1 + 1e-9)


def test_a_margin_may_cut_the_free_space():
    boundary = [(0, 0), (2, 0), (2, 1), (3, 1), (3, 0), (5, 0), (5, 2), (0, 2)]
    boundary = [(x, y + (0.2 if (x, y) in [(2, 1), (3, 1)] else 0)) for x, y in boundary]
    assert Workspace(boundary, robot_radius=0.39).pieces == 1
    cut = Workspace(boundary, robot_radius=0.41)
    assert cut.pieces == 2
    assert 2 * 1.18**2 < cut.free_space.area < 2 * 1.18 * 1.59
    assert "in 2 pieces" in cut.describe()


def test_a_map_is_described_in_one_line():
    room = Workspace(ROOM, [box(1, 1, 2, 2)], robot_radius=0.25, name="Den")
    assert room.describe() == (
        "Den: 6 x 5 m, 1 obstacle, robot of radius 0.25 m, free space 22.554 m² in one piece"
    )
    assert Workspace(ROOM).describe() == "6 x 5 m, no obstacles, free space 30 m² in one piece"


@given(
    st.integers(1, 99),
    st.integers(1, 99),
    st.lists(st.sampled_from([0.1, 0.7, 1 / 3, 0.05]), min_size=1, max_size=6),
)
def test_sides_that_differ_by_a_rounding_meet(top, end, steps):
    """A wall of two obstacles whose common side was computed in two ways has no gap."""
    once = 1.0 + sum(steps)
    twice = math.fsum(steps) + 1.0
    width = once + end
    room = Workspace(
        box(0, 0, width, 2 * top),
        [box(0.5, top, once, top + 0.5), box(twice, top, width - 0.1, top + 0.5)],
    )
    assert len(shapely.get_parts(room.free_space)) == 1
    assert len(shapely.get_rings(room.free_space)) == 2


@pytest.mark.parametrize("degrees", range(0, 360, 7))
def test_slanted_sides_meet(degrees):
    """Two wedges that stand on slanted walls and meet at their tips part the room."""
    a = math.radians(degrees)
    turn = np.array([[math.cos(a), -math.sin(a)], [math.sin(a), math.cos(a)]])
    room = Workspace(
        np.array(ROOM) @ turn.T + 0.3,
        [
            np.array([(1.3, 0), (2.1, 0), (3.7, 2.3)]) @ turn.T + 0.3,
            np.array([(1.3, 5), (3.7, 2.3), (2.1, 5)]) @ turn.T + 0.3,
        ],
    )
    assert room.pieces == 2


def test_decimals_are_kept():
    boundary = [(0.1, -0.7), (12.345678901, -0.7), (12.345678901, 199.95), (0.1, 199.95)]
    corners = shapely.get_coordinates(Workspace(boundary).free_space)
    assert {tuple(corner) for corner in corners.tolist()} == set(boundary)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e6])
def test_maps_of_any_scale_have_the_right_area(scale):
    room = Workspace(np.array(ROOM) * scale, [np.array(box(2, 0, 3, 2)) * scale])
    assert room.free_space.area == pytest.approx(28 * scale**2)
    assert room.pieces == 1


BAD_RINGS = [
    ([(0, 0), (2, 2), (2, 0), (0, 2)], "self-intersection at (1, 1)"),
    ([(0, 0), (4, 0), (4, 4), (2, 0), (0, 4)], "self-intersection at (2, 0)"),
    ([(0, 0), (1, 1)], "it has 2 distinct vertices; at least 3 are needed"),
    ([(0, 0), (1, 1), (0, 0), (1, 1), (0, 0)], "it has 2 distinct vertices"),
    ([(1, 1), (1, 1), (1, 1), (1, 1)], "it has 1 distinct vertices"),
    ([], "it has no vertices"),
    ([(0, 0), (1, 0), (math.nan, 1)], "vertex 2 is (nan, 1); expected finite numbers"),
    ([(0, 0), (1, -math.inf), (1, 1)], "vertex 1 is (1, -inf)"),
    ([(0, 0), (1, 0), (1, 1e300)], "vertex 2 is (1, 1e+300)"),
    ([(0, 0), (1, 1), (3, 3)], "zero area; all its vertices lie on one line"),
    ([(0, 0), (0.1, 0.1), (0.3, 0.3), (0.7, 0.7)], "zero area"),
    ([(0, 0, 0), (1, 0, 0), (1, 1, 0)], "expected pairs of numbers [x, y]"),
    ([0, 1, 2], "expected pairs of numbers [x, y]"),
    ([(0, 0), (1, 0), (1,)], "expected pairs of numbers [x, y]"),
    ([("a", 0), (1, 0), (1, 1)], "expected pairs of numbers [x, y]"),
    (
        shapely.Polygon(ROOM, [box(1, 1, 2, 2), box(3, 3, 4, 4)]),
        "expected a polygon without holes, got one with 2",
    ),
    (shapely.Polygon(), "it has no vertices"),
]


@pytest.mark.parametrize(("ring", "message"), BAD_RINGS)
def test_bad_rings_are_refused(ring, message):
    with pytest.raises(ValueError, match="^" + re.escape(f"boundary: {message}")):
        Workspace(ring)
    with pytest.raises(ValueError, match="^" + re.escape(f"obstacles[1]: {message}")):
        Workspace(box(0, 0, 9, 9), [box(0, 0, 1, 1), ring])


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"obstacles": [box(1, 1, 2, 2), box(7, 7, 8, 8)]}, "obstacles[1]: it lies wholly outside"),
        ({"obstacles": [box(6, 0, 8, 5)]}, "obstacles[0]: it lies wholly outside"),
        ({"obstacles": [ROOM]}, "obstacles: they cover the whole boundary"),
        ({"obstacles": [box(-1, -1, 3, 6), box(2, -1, 7, 6)]}, "obstacles: they cover the whole"),
        ({"robot_radius": 2.5}, "robot_radius: a robot of radius 2.5 m fits nowhere in the map"),
        ({"robot_radius": -0.1}, "robot_radius: expected 0 m or more, got -0.1"),
        ({"robot_radius": math.nan}, "robot_radius: expected a finite number, got nan"),
        ({"robot_radius": math.inf}, "robot_radius: expected a finite number, got inf"),
        ({"cell": 0.0}, "cell: expected more than 0 m, got 0"),
        ({"cell": -1}, "cell: expected more than 0 m, got -1"),
        ({"cell": math.inf}, "cell: expected a finite number, got inf"),
        ({"directions": 0}, "directions: expected a whole number from 1, got 0"),
        ({"directions": True}, "directions: expected a whole number from 1, got True"),
        ({"name": "two\nlines"}, "name: expected printable text on one line"),
    ],
)
def test_bad_fields_are_refused(fields, message):
    with pytest.raises(ValueError, match="^" + re.escape(message)):
        Workspace(ROOM, **fields)


points = st.tuples(st.integers(-3, 3), st.integers(-3, 3))


def simple(ring):
    return len(set(ring)) >= 3 and shapely.Polygon(ring).is_valid


@given(st.lists(points, min_size=3, max_size=8))
def test_any_ring_gives_a_map_or_a_reason(ring):
    if simple(ring):
        assert Workspace(ring).free_space.equals(shapely.Polygon(ring))
    else:
        with pytest.raises(ValueError, match=r"^boundary: "):
            Workspace(ring)


HALL = box(-2, -2, 2.5, 2.5)
obstacles_of_the_hall = (
    st.lists(points, min_size=3, max_size=6)
    .filter(simple)
    .filter(lambda ring: shapely.Polygon(ring).intersection(shapely.Polygon(HALL)).area > 0)
)


@given(st.lists(obstacles_of_the_hall, max_size=4), st.floats(0, 0.6))
@example(
    [
        [(0, 3), (-1, 3), (-2, 1)],
        [(-1, -2), (-2, 1), (-2, -1)],
        [(0, 1), (3, -3), (0, 3), (-3, -2)],
        [(0, 1), (3, -3), (0, 3), (-3, -2)],
    ],
    0.25,
)
def test_membership_is_that_of_the_parts(obstacles, radius):
    """A point is free just where it is in the boundary, and a radius away from every wall."""
    try:
        room = Workspace(HALL, obstacles, robot_radius=radius)
    except ValueError:  # nothing is left free
        reject()
    boundary = shapely.Polygon(room.boundary)
    solids = [shapely.Polygon(ring) for ring in room.obstacles]
    for x, y in np.random.default_rng(0).uniform(-2.2, 2.7, (60, 2)):
        point = shapely.Point(x, y)
        gap = min([boundary.exterior.distance(point), *(s.distance(point) for s in solids)])
        if abs(gap - radius) > 0.002 * radius + 1e-9:
            free = boundary.contains(point) and gap > radius
            assert room.free_space.contains(point) == free
