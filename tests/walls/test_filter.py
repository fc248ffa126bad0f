"""The filter of robots that start anywhere, compared with rays that share no code with it."""

import dataclasses
import math
import re

import numpy as np
import pytest
import shapely
from oracles import rays

from jaxcell import space, walls
from jaxcell.base.bundled import bundled


NO_ERRORS = walls.Errors()
NOISE = walls.Errors(run=0.02, distance=0.05, turn=np.radians(1))


def load(name):
    return space.Workspace.load(bundled(name))


def followed(filter, runs, bounce, observed):
    """Follow robots, and check at each bump that the sets contain them. Returns the sets."""
    states, state = [], None
    for bump, (heading, place) in enumerate(zip(runs.heading, runs.point, strict=True)):
        state = filter.observe(state, observed[bump])
        inside = walls.contains(filter.boundary, state, filter.slice_of(heading), place)
        assert inside.all(), f"bump {bump}: robots {np.flatnonzero(~inside)} are lost"
        states.append(state)
        state = filter.turn(state, bounce)
    return states


def drive(workspace, robots, bumps, bounce, seed, headings=None, errors=NO_ERRORS):
    rng = np.random.default_rng(seed)
    place = rays.anywhere(workspace.free_space, robots, rng)
    heading = rng.uniform(0, 2 * np.pi, robots)
    if headings is not None:
        heading = np.floor(heading * headings / (2 * np.pi)) * 2 * np.pi / headings
        heading += errors.heading * rng.choice([-1, 1], robots) * 0.9999
    bounds = {"relative": errors.run, "absolute": errors.distance, "turn": errors.turn}
    turns = [bounce] * (bumps - 1)
    return rays.drive(workspace.free_space, place, heading, turns, signs=rng, **bounds)


@pytest.mark.parametrize(
    ("name", "bounce", "headings", "step"),
    [
        ("lab_a", 45, 8, 1.0),
        ("lab_a", 135, 8, 0.05),
        ("lab_b", 135, 8, 1.0),
        ("complex", 135, 8, 0.05),
        ("depot", 90, 8, 1.0),
        ("cafe", 112.5, 16, 0.25),
        ("arena", 100, 36, 0.1),
    ],
)
def test_a_robot_of_known_heading_is_never_lost(name, bounce, headings, step):
    workspace, angle = load(name), np.radians(bounce)
    runs = drive(workspace, 200, 12, angle, seed=1, headings=headings)
    filter = walls.WallFilter.of(workspace, headings=headings, step=step)
    followed(filter, runs, angle, np.floor(runs.length / step) * step)


@pytest.mark.parametrize("name", ["lab_b", "complex"])
@pytest.mark.parametrize(
    ("bounce", "headings", "errors", "extent"),
    [
        (135, None, NOISE, 2.0),
        (100, None, walls.Errors(distance=0.05), 1.0),
        (135, None, dataclasses.replace(NOISE, displacement=0.03), np.inf),
        (135, 8, walls.Errors(late=0.04), np.inf),
        (135, 8, walls.Errors(heading=np.radians(3)), np.inf),
    ],
)
def test_robots_with_errors_at_their_bounds_are_localized_and_never_lost(
    name, bounce, headings, errors, extent
):
    workspace, angle = load(name), np.radians(bounce)
    runs = drive(workspace, 15, 15, angle, seed=3, headings=headings, errors=errors)
    filter = walls.WallFilter.of(workspace, headings=headings, errors=errors)
    late = np.random.default_rng(5).choice([0.0, errors.late], runs.observed.shape)
    states = followed(filter, runs, angle, runs.observed + late)
    assert np.median(filter.extent(states[-1], 15)) < extent
    if errors.heading:
        assert filter.first.sum() == 8 * 8


def drive_on(filter, seed, *, back=0.0, bump_turn=0.0):
    """Drive robots of unknown heading, and check at each bump which sets contain the robot.

    Robots that back off before they turn start the next run there. Bumps turn robots by up to
    `bump_turn` toward the wall.
    """
    workspace, angle = load("complex"), np.radians(135)
    rng = np.random.default_rng(seed)
    place = rays.anywhere(workspace.free_space, 20, rng)
    heading = rng.uniform(0, 2 * np.pi, 20)
    room, at = rays.Rays(workspace.free_space), np.full(20, rays.INSIDE)
    state, inside = None, []
    for _ in range(12):
        length, bump, met = room.run(place, at, heading)
        state = filter.observe(state, length)
        inside.append(walls.contains(filter.boundary, state, filter.slice_of(heading), bump))
        ahead = np.stack([np.cos(heading), np.sin(heading)], axis=1)
        place = bump - np.minimum(back, length)[:, None] * ahead
        at = np.where(length > back, rays.INSIDE, at) if back else met
        tangent, normal = (vectors[met % room.walls] for vectors in (room.along, room.normal))
        # A heading to the left of the normal of the wall turns to the right, and vice versa.
        sine, cosine = (ahead * tangent).sum(axis=1), -(ahead * normal).sum(axis=1)
        gain = -bump_turn * 2 * sine * cosine
        heading, state = heading + gain + angle, filter.turn(state, angle)
    return np.array(inside)


def test_a_run_that_begins_beside_the_wall_loses_no_robot():
    filter = walls.WallFilter.of(load("complex"), errors=walls.Errors(displacement=0.03))
    assert drive_on(filter, seed=4, back=0.03).all()


def test_a_known_turn_by_bumps_loses_no_robot_and_an_unknown_one_does():
    workspace, bump_turn = load("complex"), np.radians(4)
    filter = walls.WallFilter.of(workspace, errors=walls.Errors(bump_turn=bump_turn))
    assert drive_on(filter, seed=8, bump_turn=bump_turn).all()
    ignorant = walls.WallFilter.of(workspace)
    assert not drive_on(ignorant, seed=8, bump_turn=bump_turn).all()


def test_the_turn_by_a_bump_is_that_of_a_robot_that_slips():
    room = space.Workspace([(0, 0), (4, 0), (4, 3), (0, 3)])
    boundary, bump_turn = walls.Boundary.of(room), 0.05
    heading = np.linspace(0.01, 2 * np.pi, 40)
    place = np.tile([2.0, 1.5], (40, 1))
    pose, leg = np.c_[place, heading], np.tile([5.0, 0.0, 0.0], (40, 1))
    slip = space.Slip(bump_turn=bump_turn)
    after, bumped = space.slipping_step(
        pose, leg, 0.0, np.zeros((40, 9)), space.felt_walls(room, 0.0), slip
    )
    wall, _, _ = walls.run_to_wall(boundary, place, heading)
    gain, largest = walls.bump_gains(boundary, wall, heading, bump_turn)
    assert bumped.all()
    np.testing.assert_allclose(after[:, 2] - heading, gain, atol=1e-6)
    np.testing.assert_allclose(largest, gain)


def test_a_bump_turns_a_grazing_robot_by_any_part_of_its_largest_turn():
    room = space.Workspace([(0, 0), (4, 0), (4, 3), (0, 3)])
    boundary = walls.Boundary.of(room)
    # Along the bottom wall, toward it.
    heading = np.radians([-5.0, 185.0])
    wall, _, _ = walls.run_to_wall(boundary, np.array([[2.0, 0.1], [2.0, 0.1]]), heading)
    gain, largest = walls.bump_gains(boundary, wall, heading, 0.1)
    np.testing.assert_allclose(gain, [-0.1 * np.sin(np.radians(10)), 0.1 * np.sin(np.radians(10))])
    np.testing.assert_allclose(largest, [-0.1, 0.1])


def follow_exactly(workspace, points, turns, rng):
    """Follow robots in exact arithmetic; `turns` counts eighths of a circle."""
    exact = rays.ExactRoom(workspace.free_space.simplify(0))
    filter = walls.WallFilter.of(workspace, headings=8)
    for point in points:
        heading, state = int(rng.integers(8)), None
        runs = exact.drive(list(point), heading, turns)
        for (now, distance, place), turn in zip(runs, [*turns, 0], strict=True):
            state = filter.observe(state, exact.length(now, distance))
            at = np.array([[float(place[0]), float(place[1])]])
            assert walls.contains(filter.boundary, state, np.array([now]), at).all()
            state = filter.turn(state, turn * np.pi / 4)


def test_a_ray_that_touches_two_corners_loses_no_robot():
    """From (5, 5) only the exact diagonal leads past the corners (4, 4) and (2, 2) to (0, 0)."""
    room = [(0, 0), (0, 3), (1, 3), (1, 4), (0, 4), (0, 5), (3, 5), (3, 4), (4, 4), (4, 5)]
    workspace = space.Workspace([*room, (5, 5), (5, 2), (2, 2), (2, 0)])
    filter = walls.WallFilter.of(workspace, headings=8)
    state = filter.turn(filter.observe(None, math.sqrt(0.5)), math.pi)
    state = filter.observe(state, 5 * math.sqrt(2))
    assert walls.contains(filter.boundary, state, np.array([5]), np.zeros((1, 2))).all()


@pytest.mark.parametrize("seed", range(8))
def test_robots_of_exact_arithmetic_are_held_among_aligned_corners(seed):
    """From the lattice of the corners, rays graze corners and run along walls."""
    rng = np.random.default_rng(seed)
    while True:
        low = rng.integers(0, 7, (4, 2))
        boxes = shapely.box(*low.T, *(low + rng.integers(1, 4, (4, 2))).T)
        free = shapely.box(0, 0, 8, 8) - shapely.union_all(boxes)
        corners = [tuple(at) for ring in rays.rings_of(free) for at in ring.tolist()]
        if free.geom_type == "Polygon" and len(set(corners)) == len(corners):
            break
    workspace = space.Workspace(
        free.exterior.coords[:-1], [ring.coords[:-1] for ring in free.interiors]
    )
    places = [(x / 2, y / 2) for x in range(1, 16) for y in range(1, 16)]
    inside = [place for place in places if free.contains(shapely.Point(place))]
    points = [inside[k] for k in rng.integers(len(inside), size=10)]
    follow_exactly(workspace, points, rng.integers(8, size=12).tolist(), rng)


def test_every_stretch_of_a_set_contains_a_robot():
    """The sets are not too large: of many robots with equal observations, some are everywhere."""
    workspace, angle = load("complex"), np.radians(135)
    runs = drive(workspace, 200_000, 3, angle, seed=8, headings=8)
    steps = np.floor(runs.length)
    alike = np.flatnonzero((steps == steps[:, :1]).all(axis=0))
    filter = walls.WallFilter.of(workspace, headings=8, step=1.0)
    state = None
    for bump in range(3):
        state = filter.observe(state, steps[bump, :1])
        state = filter.turn(state, angle) if bump < 2 else state
    empty = [
        (wall, begin, end)
        for _, slice_, wall, begin, end in zip(*state, strict=True)
        if end - begin > 0.1
        and not (
            (runs.wall[-1, alike] == wall)
            & (filter.slice_of(runs.heading[-1, alike]) == slice_)
            & (runs.arc[-1, alike] >= begin)
            & (runs.arc[-1, alike] <= end)
        ).any()
    ]
    assert not empty


def test_robots_that_are_followed_together_have_the_sets_of_single_robots():
    workspace, angle = load("lab_b"), np.radians(135)
    runs = drive(workspace, 5, 6, angle, seed=9, headings=8)
    filter = walls.WallFilter.of(workspace, headings=8, errors=walls.Errors(distance=0.1))
    together = followed(filter, runs, angle, runs.length)[-1]
    for robot in range(5):
        state = filter.observe(None, runs.length[0, robot])
        for length in runs.length[1:, robot]:
            state = filter.observe(filter.turn(state, angle), length)
        expected = together.take(together.robot == robot)
        assert all(map(np.array_equal, state[1:], expected[1:]))


def test_a_run_longer_than_the_room_refutes_the_map():
    filter = walls.WallFilter.of(load("lab_a"), headings=8)
    state = filter.turn(filter.observe(None, 1.0), np.radians(45))
    assert filter.refuted(filter.observe(state, 50.0), 1).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"headings": 7}, "headings: expected an even number from 2, got 7"),
        ({"slices": 0}, "slices: expected an even number from 4, got 0"),
        (
            {"headings": 16, "errors": walls.Errors(turn=0.01)},
            "slices: expected a multiple of 16 headings, got 360",
        ),
        (
            {"errors": walls.Errors(distance=9.0)},
            "errors: distance: expected at most 8.94 m, the diameter of the room, got 9 m: no two "
            "runs would differ",
        ),
    ],
)
def test_wrong_settings_of_a_filter_are_refused(change, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        walls.WallFilter.of(load("lab_a"), **change)


def test_an_angle_that_is_not_a_whole_number_of_slices_is_refused():
    filter = walls.WallFilter.of(load("lab_a"), headings=8)
    state = filter.observe(None, 1.0)
    with pytest.raises(ValueError, match="expected a multiple of 45 degrees"):
        filter.turn(state, np.radians(30))


@pytest.mark.parametrize("field", ["run", "distance", "late", "turn", "heading", "displacement"])
def test_errors_below_zero_are_refused(field):
    with pytest.raises(ValueError, match=f"errors: {field}: expected"):
        walls.Errors(**{field: -0.1})
