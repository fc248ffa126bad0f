"""Sets of robots from a start region, compared with robots that are simulated in shapely."""

import math

import numpy as np
import pytest
import shapely

from jaxcell import space, walls
from jaxcell.base.bundled import bundled


ERRORS = walls.Errors(run=0.02, distance=0.03, turn=math.radians(1), heading=math.radians(2))


def ray(free, x, y, heading):
    """The length of the free way from a place, or 0 if a robot at a wall faces it."""
    far = (x + 100 * math.cos(heading), y + 100 * math.sin(heading))
    inside = shapely.LineString([(x, y), far]) & free
    parts = [part for part in shapely.get_parts(inside) if part.length > 1e-9]
    near = [part for part in parts if part.distance(shapely.Point(x, y)) < 1e-7]
    return near[0].length if near else 0.0


def drive_from(free, place, radius, heading, errors, bumps, angle, rng):
    """Drive one robot from a disc with errors at their bounds: headings, places, and lengths."""
    while True:
        x, y = np.array(place) + radius * rng.uniform(-1, 1, 2)
        if math.dist((x, y), place) <= radius and free.covers(shapely.Point(x, y)):
            break
    heading += rng.choice([-1, 1]) * errors.heading * 0.9999
    rows = []
    for _ in range(bumps):
        run = ray(free, x, y, heading)
        x, y = x + run * math.cos(heading), y + run * math.sin(heading)
        measured = run * (1 + rng.choice([-1, 1]) * errors.run)
        measured += rng.choice([-1, 1]) * errors.distance
        rows.append((heading, x, y, max(measured, 0.0)))
        heading += angle + rng.choice([-1, 1]) * errors.turn * 0.9999
    return np.array(rows)


def covered(larger, smaller):
    """Check that each stretch of a set lies in a stretch of a larger set."""
    for robot, slice_, wall, begin, end in zip(*smaller, strict=True):
        same = (larger.robot == robot) & (larger.slice == slice_) & (larger.wall == wall)
        if not (same & (larger.begin <= begin + 1e-6) & (larger.end >= end - 1e-6)).any():
            return False
    return True


@pytest.mark.parametrize(
    ("name", "place", "radius"),
    [("lab_b", (1.0, 1.0), 0.1), ("complex", (2.0, 1.5), 0.0), ("arena", (0.5, 0.5), 0.2)],
)
@pytest.mark.parametrize("heading", [math.radians(93), None])
def test_set_from_a_dock_holds_its_robots_and_is_not_larger_than_from_anywhere(
    name, place, radius, heading
):
    room, angle, robots = space.Workspace.load(bundled(name)), math.radians(136), 12
    rng = np.random.default_rng(1)
    region = walls.StartRegion(place, heading, radius)
    dock = walls.WallFilter.of(room, slices=180, errors=ERRORS, start=region)
    anywhere = walls.WallFilter(dock.chords, ERRORS, np.ones(180, bool), 0.0)
    facing = rng.uniform(0, math.tau, robots) if heading is None else [heading] * robots
    driven = [
        drive_from(room.free_space, place, radius, one, ERRORS, 8, angle, rng) for one in facing
    ]
    own = wide = None
    for bump in np.stack(driven, axis=1):
        own, wide = dock.observe(own, bump[:, 3]), anywhere.observe(wide, bump[:, 3])
        assert walls.contains(dock.boundary, own, dock.slice_of(bump[:, 0]), bump[:, 1:3]).all()
        assert covered(wide, own)
        assert (dock.extent(own, robots) <= anywhere.extent(wide, robots) + 1e-6).all()
        own, wide = dock.turn(own, angle), anywhere.turn(wide, angle)


@pytest.mark.parametrize("degrees", range(0, 360, 45))
def test_a_dock_at_a_wall_holds_a_robot_of_each_known_heading(degrees):
    room = space.Workspace([(0, 0), (5, 0), (5, 2), (2, 2), (2, 4), (0, 4)])
    heading = math.radians(degrees)
    region = walls.StartRegion((0.0, 2.0), heading)
    filter = walls.WallFilter.of(room, headings=8, start=region)
    run = ray(room.free_space, 0.0, 2.0, heading)
    state = filter.observe(None, run)
    end = np.array([[run * math.cos(heading), 2 + run * math.sin(heading)]])
    assert walls.contains(filter.boundary, state, filter.slice_of([heading]), end).all()
    assert filter.extent(state, 1) < 1e-6


def test_longer_runs_and_other_starts_are_refused():
    room = space.Workspace([(0, 0), (5, 0), (5, 2), (2, 2), (2, 4), (0, 4)])
    filter = walls.WallFilter.of(room, headings=8, start=walls.StartRegion((1.0, 1.0), 0.0))
    assert filter.refuted(filter.observe(None, [4.0, 3.9, 40.0]), 3).tolist() == [False, True, True]
    for region, message in (
        (walls.StartRegion((3.0, 3.0)), "not in the free space"),
        (walls.StartRegion((1.0, 1.0), 0.0, -1.0), "radius: expected"),
        (walls.StartRegion((1.0, 1.0), 0.1), "one of the headings"),
    ):
        with pytest.raises(ValueError, match=message):
            walls.WallFilter.of(room, headings=8, start=region)
