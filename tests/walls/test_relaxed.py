"""Sets that tolerate bumps that are not on the map, with robots of an own simulation."""

import math

import numpy as np
import pytest
import shapely
from oracles import rays

from jaxcell import space, walls
from jaxcell.base.bundled import bundled


ANGLE = math.radians(135)


def drive(free, robots, errors, bumps, chairs, headings, seed, dock=None):
    """Drive robots; the bump with the number `chairs` of each is not on the map, if not negative.

    Returns the heading, x, y and measured run of each bump and robot.
    """
    rng = np.random.default_rng(seed)
    place, at = rays.anywhere(free, robots, rng), np.full(robots, rays.INSIDE)
    heading = rng.uniform(0, math.tau, robots)
    if headings is not None:
        heading = rng.integers(headings, size=robots) * math.tau / headings
    if dock is not None:
        place, heading = np.tile(dock.place, (robots, 1)), np.full(robots, dock.heading)
    room, rows = rays.Rays(free), []
    for bump in range(bumps):
        ahead = np.stack([np.cos(heading), np.sin(heading)], axis=1)
        run, wall, met = room.run(place, at, heading)
        short = run * rng.uniform(0.1, 0.9, robots)
        stop = place + short[:, None] * ahead
        # A robot that drives along a wall stays at it, and meets no thing inside the room.
        stops = (chairs == bump) & (shapely.distance(free.boundary, shapely.points(stop)) > 1e-6)
        run = np.where(stops, short, run)
        place = np.where(stops[:, None], stop, wall)
        at = np.where(stops, rays.INSIDE, met)
        signs = rng.choice([-1, 1], (3, robots))
        measured = run * (1 + signs[0] * errors.run) + signs[1] * errors.distance
        rows.append(np.column_stack([heading, place, np.maximum(measured, 0.0)]))
        heading = heading + ANGLE + signs[2] * errors.turn * 0.9999
    return np.array(rows)


def follow(filter, driven, bumps):
    """Follow robots by a filter: whether sets contain them, extents, and disbelieved bumps."""
    state, rows = None, []
    for bump in range(bumps):
        heading, place, run = driven[bump, :, 0], driven[bump, :, 1:3], driven[bump, :, 3]
        state = filter.observe(state, run)
        held = filter.contains(state, filter.filter.slice_of(heading), place)
        extent = filter.extent(state, len(run))
        rows.append((held, extent, filter.disbelieved(state, len(run))))
        state = filter.turn(state, ANGLE)
    return [np.array(part) for part in zip(*rows, strict=True)]


@pytest.mark.parametrize("name", ["lab_b", "complex", "arena"])
def test_no_robot_is_lost_by_one_bump_that_is_not_on_the_map(name):
    room, rng = space.Workspace.load(bundled(name)), np.random.default_rng(2)
    errors, bumps, robots = walls.Errors(run=0.01, distance=0.02), 20, 100
    free, plain = room.free_space, walls.WallFilter.of(room, headings=8, errors=errors)
    chairs = rng.integers(0, bumps, robots)
    driven = drive(free, robots, errors, bumps, chairs, 8, 1)
    held, extent, disbelieved = follow(walls.RelaxedFilter(plain, outliers=1), driven, bumps)
    assert held.all()
    assert (disbelieved <= (chairs <= np.arange(bumps)[:, None])).all()
    assert disbelieved[-1].mean() > 0.5

    state, without = None, drive(free, robots, errors, bumps, np.full(robots, -1), 8, 1)
    for run in without[:, :, 3]:
        state = plain.observe(state, run)
        known = plain.extent(state, robots)
        state = plain.turn(state, ANGLE)
    # With exact headings both are nanometres, to which discs add the tolerance of the map.
    assert np.median(extent[-1]) < 2 * np.median(known) + 1e-7


@pytest.mark.parametrize("dock", [None, walls.StartRegion((1.5, 2.0), math.pi / 2, 0.1)])
def test_robots_with_errors_of_turns_are_not_lost_by_such_a_bump(dock):
    room, bumps, robots = space.Workspace.load(bundled("lab_b")), 8, 6
    errors = walls.Errors(run=0.01, distance=0.02, turn=math.radians(1))
    plain = walls.WallFilter.of(room, slices=72, errors=errors, start=dock)
    relaxed = walls.RelaxedFilter(plain, outliers=1)
    chairs = np.array([0, 1, 2, 3, 5, 7])
    driven = drive(room.free_space, robots, errors, bumps, chairs, None, 3, dock)
    held, extent, disbelieved = follow(relaxed, driven, bumps)
    state, runs = None, drive(room.free_space, robots, errors, bumps, chairs * 0 - 1, None, 3, dock)
    for run in runs[:, :, 3]:
        state = plain.observe(state, run)
        known = plain.extent(state, robots)
        state = plain.turn(state, ANGLE)
    assert held.all()
    assert (disbelieved <= 1).all()
    if dock is not None:
        assert np.median(extent[-1]) < 2 * np.median(known)


def test_a_filter_without_outliers_is_refused():
    plain = walls.WallFilter.of(space.Workspace.load(bundled("lab_b")), headings=8)
    with pytest.raises(ValueError, match="outliers: expected at least 1"):
        walls.RelaxedFilter(plain, outliers=0)


@pytest.mark.parametrize("outliers", [1, 2])
def test_a_trial_holds_robots_with_random_bumps_that_are_not_on_the_map(outliers):
    room = space.Workspace.load(bundled("lab_b"))
    plain = walls.WallFilter.of(room, headings=8, errors=walls.Errors(run=0.01, distance=0.02))
    goal = walls.Homing(plain, (3.0, 4.5), 1.0, (math.radians(45), ANGLE))
    trial = walls.drive_anywhere(
        room, plain, goal.angles, robots=40, bumps=20, headings=8, goal=goal, outliers=outliers
    )
    assert trial.held.all()
    assert (np.diff(trial.disbelieved, axis=1) >= 0).all()
    assert set(trial.disbelieved[:, -1]) == set(range(outliers + 1))
    away = np.hypot(*(trial.place - goal.goal).transpose(2, 0, 1))
    assert trial.arrived.any()
    assert (away[trial.arrived] <= goal.radius).all()


def test_the_likeliest_places_disbelieve_the_fewest_bumps():
    room = space.Workspace.load(bundled("lab_b"))
    plain = walls.WallFilter.of(room, headings=8, errors=walls.Errors(distance=0.02))
    relaxed = walls.RelaxedFilter(plain, outliers=1)
    state, sets = None, None
    for run in (1.0, 2.0, 1.5):
        state, sets = relaxed.observe(state, run), plain.observe(sets, run)
        likely = walls.likeliest(state, 1)
        if sets.wall.size:
            assert all(map(np.array_equal, likely, sets))
        else:
            assert relaxed.disbelieved(state, 1)[0] > 0
        state, sets = relaxed.turn(state, ANGLE), plain.turn(sets, ANGLE)
