"""The oracle of straight runs against shapely, against fractions, and on runs done by hand."""

import math
from fractions import Fraction

import numpy as np
import pytest
import shapely
from oracles.rays import INSIDE, ExactRoom, Rays, anywhere, drive

from jaxcell.base.bundled import bundled
from jaxcell.space import Workspace


LAB = Workspace.load(bundled("lab_a"))


@pytest.mark.parametrize("name", ["lab_a", "slanted", "cafe"])
def test_runs_end_where_the_ray_leaves_the_polygon(name):
    free = Workspace.load(bundled(name)).free_space
    rng = np.random.default_rng(0)
    points = anywhere(free, 300, rng)
    # No multiple of an angle between walls: a ray along a wall is no matter for shapely.
    heading = rng.uniform(0, math.tau, 300)
    runs = drive(free, points, heading, [2.3] * 8)
    begin = points
    for heading, length, end in zip(runs.heading, runs.length, runs.point, strict=True):
        u = np.stack([np.cos(heading), np.sin(heading)], axis=1)
        np.testing.assert_allclose(begin + length[:, None] * u, end, atol=1e-12)
        # A micrometre off the wall where it starts, so that rounding does not cut the line short.
        off = begin + 1e-6 * u
        ran = length > 0
        lines = shapely.linestrings(np.stack([off, off + 100 * u], axis=1))
        for line, start, expected in zip(lines[ran], off[ran], length[ran], strict=True):
            parts = shapely.get_parts(shapely.intersection(line, free))
            first = next(part for part in parts if part.distance(shapely.Point(start)) < 1e-9)
            assert first.length + 1e-6 == pytest.approx(expected, abs=1e-9)
        assert not shapely.contains_xy(free, *(begin + 1e-6 * u)[~ran].T).any()
        begin = end


@pytest.mark.parametrize("turn", [1, 2, 3, 5])
def test_floats_and_fractions_run_alike_along_walls_and_into_corners(turn):
    exact = ExactRoom(LAB.free_space)
    rng = np.random.default_rng(turn)
    starts = np.round(anywhere(LAB.free_space, 40, rng), 2)
    heading = rng.integers(8, size=40)
    runs = drive(LAB.free_space, starts, heading * math.pi / 4, [turn * math.pi / 4] * 40)
    along = 0
    for i, (point, way) in enumerate(zip(starts.tolist(), heading.tolist(), strict=True)):
        expected = exact.drive(point, way, [turn] * 40)
        lengths = [exact.length(way, distance) for way, distance, _ in expected]
        np.testing.assert_allclose(runs.length[:, i], lengths, atol=1e-9)
        bumps = [[float(x) for x in bump] for _, _, bump in expected]
        np.testing.assert_allclose(runs.point[:, i], bumps, atol=1e-9)
        along += np.count_nonzero(runs.wall[1:, i] == INSIDE)
    # Robots that turn by 90 degrees or 45 in a room with square corners drive along its walls.
    assert along > 0 or turn not in (1, 2)


def test_a_robot_turns_on_where_its_heading_points_into_the_wall():
    # Onto the lower wall; 0; along it into the corner of an obstacle; 0; and along the obstacle,
    # past its corner.
    start, half = (Fraction(7, 2), Fraction(2)), Fraction(1, 2)
    found = ExactRoom(LAB.free_space).drive(start, 6, [1] * 4)
    assert [distance for _, distance, _ in found] == [2, 0, half, 0, 4]
    assert [bump for *_, bump in found[1:]] == [(3 + half, 0), (4, 0), (4, 0), (4, 4)]


CORNERS = shapely.box(0, 0, 4, 4) - shapely.box(1, 0, 2, 1)
POINT = CORNERS - shapely.box(2, 1, 3, 2)


@pytest.mark.parametrize(
    ("free", "start", "heading", "end"),
    [
        (CORNERS, (0, 2), 7, (1, 1)),
        (CORNERS, (0, 0), 1, (4, 4)),
        (CORNERS, (1, 2), 7, (3, 0)),
        (CORNERS, (0, 1), 0, (4, 1)),
        (POINT, (1, 2), 7, (2, 1)),
        (POINT, (0, 1), 0, (2, 1)),
        (POINT, (2, 0), 2, (2, 1)),
    ],
)
def test_a_ray_grazes_a_corner_but_does_not_slip_between_two_that_meet(free, start, heading, end):
    bump, _ = ExactRoom(free).run(start, heading)
    assert bump == end
    point, at = np.array([start], float), np.array([INSIDE])
    _, found, _ = Rays(free).run(point, at, np.array([heading * math.pi / 4]))
    np.testing.assert_allclose(found, [end], atol=1e-12)


def test_errors_are_at_their_bounds():
    rng = np.random.default_rng(1)
    points, bounds = anywhere(LAB.free_space, 50, rng), {"relative": 0.02, "absolute": 0.05}
    heading = np.full(50, 0.1)
    runs = drive(LAB.free_space, points, heading, [2.0] * 5, **bounds, turn=0.01, signs=rng)
    turned = np.diff(runs.heading, axis=0) - 2.0
    np.testing.assert_allclose(np.abs(turned), 0.01)
    off = runs.observed - runs.length
    bounds = np.stack([s * 0.02 * runs.length + t * 0.05 for s in (-1, 1) for t in (-1, 1)])
    at_bound = np.isclose(off, bounds).any(axis=0) | (runs.observed == 0)
    assert at_bound.all()
    assert all((turned * sign > 0).any() for sign in (-1, 1))
