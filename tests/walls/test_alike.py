"""Poses that some angles cannot tell apart."""

import functools
import math
from fractions import Fraction

import numpy as np
import pytest
from oracles import rays

from experiments.chapter_2.file_rays import FileRays
from jaxcell import space, walls
from jaxcell.base.bundled import bundled
from jaxcell.study import LocalizeAnywhere


L_ROOM = space.Workspace([(0, 0), (6, 0), (6, 1), (4, 1), (4, 2), (0, 2)])
HOOK = [(0, 0), (7, 0), (7, 2.5), (3, 2.5), (3, 6), (0, 6)]
# An alcove to the left of each corner: the room looks the same after a turn by 90 degrees.
PINWHEEL = [(0, 0), (3, 0), (3, -1), (4, -1), (4, 3), (5, 3), (5, 4), (1, 4), (1, 5), (0, 5)]
PINWHEEL += [(0, 1), (-1, 1), (-1, 0)]
ROUND = [(math.cos(k * math.pi / 8), math.sin(k * math.pi / 8)) for k in range(16)]


@pytest.mark.parametrize(("y", "width"), [(0.3, 6.0), (1.4, 4.0)])
def test_a_robot_that_turns_round_cannot_tell_its_place_across(y, width):
    """Runs East and West have the width of the room at the height of the robot: 6 m or 4 m."""
    start = np.array([[1.0, y]]), np.array([0.0])
    alike = walls.alike_poses(walls.Boundary.of(L_ROOM), 2, [math.pi], *start)
    boundary = walls.Boundary.of(L_ROOM)
    ends = [boundary.point(alike.poses.wall, arc) for arc in (alike.poses.begin, alike.poses.end)]
    low, high = np.minimum(*ends), np.maximum(*ends)
    whole = (high - low).max(axis=1) > 0.1
    # East at the right wall and West at the left wall, from end to end of the part of this width.
    np.testing.assert_allclose(low[whole], [[width, y // 1], [0, y // 1]], atol=1e-6)
    np.testing.assert_allclose(high[whole], [[width, y // 1 + 1], [0, y // 1 + 1]], atol=1e-6)
    np.testing.assert_allclose(alike.extent, math.hypot(width, 1), atol=1e-6)


@pytest.mark.parametrize(("headings", "poses"), [(2, 2), (4, 4), (8, 4)])
def test_alike_poses_of_a_pinwheel_are_those_turned_about_its_centre(headings, poses):
    room = space.Workspace(PINWHEEL)
    rng = np.random.default_rng(3)
    start, centre = rays.anywhere(room.free_space, 8, rng), np.array([2.0, 2.0])
    heading = rng.integers(headings, size=8) * 2 * np.pi / headings
    boundary, angles = walls.Boundary.of(room), np.radians([100.0, 130.0])
    alike = walls.alike_poses(boundary, headings, angles.tolist(), start, heading)
    bumps = rays.drive(room.free_space, start, heading, []).point[0]
    for one in range(8):
        mine = alike.poses.take(alike.poses.robot == one)
        x, y = bumps[one] - centre
        turned = [(x, y), (-y, x), (-x, -y), (y, -x)][:: 4 // poses]
        found = boundary.point(mine.wall, (mine.begin + mine.end) / 2) - centre
        np.testing.assert_allclose(
            sorted(found.round(5).tolist()), sorted(np.round(turned, 5).tolist()), atol=2e-5
        )
    # The nearest wall to the centre is 2 m away, so that opposite places are 4 m apart.
    assert (alike.extent > 2.0).all()


def holds(boundary, poses, robot, slice_, point):
    """Check whether the class of a robot has a pose at a point, to 50 nanometres."""
    mine = poses.take((poses.robot == robot) & (poses.slice == slice_))
    along = ((point - boundary.begin[mine.wall]) * boundary.tangent[mine.wall]).sum(axis=1)
    nearest = boundary.point(mine.wall, np.clip(along, mine.begin, mine.end))
    return bool((np.linalg.norm(nearest - point, axis=1) < 5e-8).any())


def exact_bumps(corners):
    """List the bumps at odd sixteenths and at halves of a metre on walls.

    A bump is a point, a heading in eighths of a turn, and the square of the longest run to it.
    """
    room = rays.ExactRoom(space.Workspace(corners).free_space)
    for _, start, end in room.edges:
        span = max(abs(end[0] - start[0]), abs(end[1] - start[1]))
        for place in range(1, int(span * 16)):
            if place % 2 == 0 and place % 8:
                continue
            share = Fraction(place, 16) / span
            point = tuple(a + share * (b - a) for a, b in zip(start, end, strict=True))
            for heading, u in enumerate(rays.EIGHTHS):
                back, distance = room.run(point, (heading + 4) % 8)
                if back != point and not room.leaves(point, u):
                    yield point, heading, distance**2 * (u[0] ** 2 + u[1] ** 2)


def touches(point):
    return all(x * 2 % 1 == 0 for x in point)


def exact_classes(corners, bumps, turns, count):
    """Number bumps so that bumps of one number have equal runs after all `count` turns."""
    room = rays.ExactRoom(space.Workspace(corners).free_space)
    number = {}

    @functools.cache
    def number_of(point, heading, came, count):
        tree = []
        for turn in turns if count else ():
            after = (heading + turn) % 8
            end, distance = room.run(point, after, rays.EIGHTHS[came])
            u = rays.EIGHTHS[after]
            length = distance**2 * (u[0] ** 2 + u[1] ** 2)
            tree.append((length, number_of(end, after, after if length else came, count - 1)))
        return number.setdefault(tuple(tree), len(number))

    return [number_of(point, heading, heading, count) for point, heading, _ in bumps]


@pytest.mark.parametrize("turns", [(1,), (3,), (2,), (1, 3), (2, 4)])
@pytest.mark.parametrize("corners", [HOOK, PINWHEEL, [(0, 0), (4, 0), (4, 3), (0, 3)]])
def test_alike_poses_are_those_of_exact_arithmetic(corners, turns):
    """Robots slide along walls that are parallel to their headings, into the next corner.

    From halves of a metre robots touch corners and walls: such poses may be missing.
    """
    bumps = list(exact_bumps(corners))
    rng = np.random.default_rng(1)
    chosen = rng.choice(len(bumps), 25, replace=False)
    share = rng.choice([0.25, 0.5, 0.75], chosen.size)
    ways = np.array([math.sqrt(bumps[k][2]) for k in chosen]) * share
    heading = np.array([bumps[k][1] for k in chosen]) * math.pi / 4
    bump = np.array([[float(x) for x in bumps[k][0]] for k in chosen])
    start = bump - ways[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    boundary = walls.Boundary.of(space.Workspace(corners))
    angles = [turn * math.pi / 4 for turn in turns]
    alike = walls.alike_poses(boundary, 8, angles, start, heading)
    classes = exact_classes(corners, bumps, turns, alike.turns)
    for robot, own in enumerate(chosen):
        for k, (point, slice_, back) in enumerate(bumps):
            same = classes[k] == classes[own] and back >= Fraction(ways[robot]) ** 2
            at = np.array([float(x) for x in point])
            found = holds(boundary, alike.poses, robot, slice_, at)
            assert same if found else not same or touches(point), (robot, k)


@pytest.mark.parametrize(
    ("name", "bounces"),
    [
        ("arena", (130.0,)),
        ("arena", (70.0,)),
        ("slanted", (135.0,)),
        ("harbour", (135.0,)),
        ("complex", (135.0,)),
        ("depot", (135.0,)),
        ("depot", (90.0, 180.0)),
        ("lab_a", (135.0,)),
        ("lab_a", (45.0,)),
        ("lab_b", (45.0, 135.0)),
        ("cafe", (90.0,)),
    ],
)
def test_no_robot_is_localized_by_angles_that_cannot_localize_it(name, bounces):
    """Each set contains the alike poses, so it is at least as large as their box."""
    study = LocalizeAnywhere(
        map=bundled(name), bounce=bounces, measured=True, robots=40, bumps=25, seed=1
    )
    result = study.run()
    alike = result._alike
    np.testing.assert_array_equal(np.unique(alike.poses.robot), np.arange(40))
    assert np.isfinite(alike.extent).all()
    assert (alike.extent <= result.trial.extent.min(axis=1) + 1e-5).all()
    assert result.localized_share + result.alike_share <= 1


def test_alike_poses_of_a_disc_have_equal_runs_by_exact_arcs():
    """The room has no symmetry; the centre of the robot moves round the box on four arcs."""
    rings, radius = [np.array(HOOK, float), np.array([(1, 1), (1, 2), (2, 2), (2, 1)], float)], 0.2
    room, rng = FileRays(rings, radius), np.random.default_rng(6)
    boundary = walls.Boundary.of(space.Workspace(rings[0], rings[1:], robot_radius=radius))
    start, heading = room.anywhere(80, rng), rng.integers(8, size=80) * math.pi / 4
    angle, going = math.pi / 2, np.zeros(80, bool)
    poses = walls.alike_poses(boundary, 8, [angle], start, heading).poses
    several = np.bincount(poses.robot, minlength=80) > 1
    assert 0 < several.sum() < 80
    poses = poses.take(several[poses.robot])
    _, place = room.run(start, heading, going)
    there = boundary.point(poses.wall, (poses.begin + poses.end) / 2)
    toward, slides = poses.slice * math.pi / 4, np.zeros(len(poses.robot), bool)
    for _ in range(20):
        heading, toward = heading + angle, toward + angle
        run, place = room.run(place, heading, going)
        other, there = room.run(there, toward, slides)
        np.testing.assert_allclose(other, run[poses.robot], atol=1e-6)


def test_the_own_pose_of_a_robot_is_alike_where_rounding_errors_grow():
    """Each run between slanted walls multiplies an error of its start, to 1e9 times in 20 runs."""
    boundary, angle = walls.Boundary.of(space.Workspace(ROUND)), math.radians(130)
    rng = np.random.default_rng(2)
    start, heading = rng.uniform(-0.5, 0.5, (20, 2)), rng.integers(36, size=20) * math.pi / 18
    alike = walls.alike_poses(boundary, 36, [angle], start, heading)
    bumps = rays.drive(space.Workspace(ROUND).free_space, start, heading, []).point[0]
    for robot, bump in enumerate(bumps):
        slice_ = round(heading[robot] * 18 / math.pi)
        assert holds(boundary, alike.poses, robot, slice_, bump)
