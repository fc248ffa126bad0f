"""The motion of a Create 2 in the physics engine, alone and by the driver."""

import math

import mujoco
import numpy as np
import pytest
import shapely

from jaxcell.robot.create.packets import METRES_PER_COUNT
from jaxcell.robot.emulation.emulator import Emulator, Line
from jaxcell.robot.emulation.simulated import SimulatedCreate
from jaxcell.robot.physics import LATENCY, RADIUS, Physics, PhysicsBody
from jaxcell.robot.physics.model import WHEEL, robot_model
from jaxcell.space import Workspace


HALL = Workspace([(-6, -6), (6, -6), (6, 6), (-6, 6)])
DISC = Workspace(shapely.Point(0, 0).buffer(3.0))
SLANTED = Workspace([(-6, -6), (6, -6), (6, 6)])


def at_rest(place=(0.0, 0.0, 0.0), workspace=HALL, **fields) -> PhysicsBody:
    body = PhysicsBody(workspace, place, Physics(**fields))
    body.advance(0.0, 0.0, 0.3)
    return body


def toward_the_north_wall(incidence: float, distance: float) -> tuple[float, float, float]:
    """The pose from which the shell meets a wall after `distance` metres; angles in radians."""
    heading = math.pi / 2 - incidence
    x, y = -distance * math.cos(heading), 6 - RADIUS - distance * math.sin(heading)
    return x, y, heading


def bump(incidence: float, speed: float = 0.2, **fields) -> float:
    """The turn toward the wall, in radians, of a robot that drives until shortly after a bump."""
    distance = 0.2
    start = toward_the_north_wall(incidence, distance)
    body = PhysicsBody(HALL, start, Physics(**fields))
    body.advance(speed, speed, distance / speed + speed / 2 / body.physics.acceleration + 0.05)
    body.advance(0.0, 0.0, 0.5)
    return body.pose[2] - start[2]


def driven(body: PhysicsBody) -> SimulatedCreate:
    return SimulatedCreate(Emulator(body, line=Line(latency=LATENCY, speedup=1e9)))


def test_a_robot_above_the_floor_falls_freely():
    model = mujoco.MjModel.from_xml_string(robot_model(HALL, Physics(), (0.0, 0.0, 0.0)))
    data = mujoco.MjData(model)
    data.qpos[2] += 1.0
    mujoco.mj_step(model, data, 400)
    fallen = 1.0 + WHEEL - data.qpos[2]
    assert fallen == pytest.approx(9.81 * 0.4**2 / 2, rel=0.005)


def test_a_metre_straight_is_exact_within_a_thousandth():
    body = at_rest()
    before = body.counts[0]
    body.advance(0.2, 0.2, 5.0)
    body.advance(0.0, 0.0, 0.5)
    x, y, heading = body.pose
    by_encoder = (body.counts[0] - before) % 65536 * METRES_PER_COUNT
    assert x == pytest.approx(by_encoder, abs=0.001)
    assert x == pytest.approx(1.0, abs=0.001)
    assert (y, heading) == pytest.approx((0.0, 0.0), abs=1e-6)


@pytest.mark.parametrize("side", [1, -1])
def test_a_whole_turn_is_exact_within_half_a_percent(side):
    body = at_rest()
    wheel = side * 0.235 / 2
    body.advance(-wheel, wheel, 2 * math.pi)
    body.advance(0.0, 0.0, 0.5)
    assert body.pose[2] == pytest.approx(side * 2 * math.pi, rel=0.005)
    assert body.pose[:2] == pytest.approx((0.0, 0.0), abs=0.001)


@pytest.mark.parametrize("degrees", [0, 30, 45, 60, 75])
def test_half_the_time_step_changes_a_bounce_by_less_than_a_tenth_of_a_degree(degrees):
    whole, half = (bump(math.radians(degrees), time_step=step) for step in (0.001, 0.0005))
    assert abs(whole - half) < math.radians(0.1)


def test_bumps_on_both_sides_turn_the_robot_equally_toward_the_wall():
    assert abs(bump(0.0)) < math.radians(0.01)
    left, right = bump(math.radians(45)), bump(math.radians(-45))
    assert math.radians(0.5) < left < math.radians(3)
    assert right == pytest.approx(-left, abs=math.radians(0.1))


def test_a_faster_bump_turns_the_robot_more():
    assert bump(math.radians(45), speed=0.4) > 2 * bump(math.radians(45), speed=0.2)


@pytest.mark.parametrize(
    ("degrees", "pressed"), [(0, (True, True)), (60, (True, False)), (-60, (False, True))]
)
def test_the_half_of_the_bumper_on_the_side_of_the_wall_is_pressed(degrees, pressed):
    body = PhysicsBody(HALL, toward_the_north_wall(math.radians(degrees), 0.05))
    felt = (False, False)
    for _ in range(60):
        body.advance(0.2, 0.2, 0.015)
        felt = felt[0] or body.bump_left, felt[1] or body.bump_right
        if any(felt):
            break
    assert (body.bump_left, body.bump_right) == pressed
    seconds, x, y = body.touches[0]
    assert 0 < seconds <= 60 * 0.015
    assert y == pytest.approx(6.0, abs=0.005)
    assert math.dist((x, y), body.pose[:2]) == pytest.approx(RADIUS, abs=0.01)


def test_a_robot_slides_along_a_smooth_wall_before_a_grazing_bump_is_felt():
    start = toward_the_north_wall(math.radians(87), 0.2)
    rough, smooth = (
        driven(PhysicsBody(HALL, start, Physics(wall=wall))).forward(1.2, speed=0.1)
        for wall in (0.5, 0.1)
    )
    assert rough.bumped
    assert rough.distance < 0.35
    assert smooth.distance > 0.5


@pytest.mark.parametrize(
    ("workspace", "start"),
    [
        (HALL, (5.0, 0.0, 0.0)),
        (DISC, (2.0, 0.0, 0.0)),
        (SLANTED, (1.0, -2.0, math.radians(135))),
    ],
)
def test_the_shell_stops_at_straight_round_and_slanted_walls(workspace, start):
    robot = driven(PhysicsBody(workspace, start))
    assert robot.forward(4.0).bumped
    gap = workspace.environment.boundary.distance(shapely.Point(robot.robot.pose[:2]))
    assert gap == pytest.approx(RADIUS, abs=0.01)


def test_a_robot_that_backs_into_a_wall_has_no_bump():
    body = at_rest((0.0, 5.7, -math.pi / 2))
    for _ in range(100):
        body.advance(-0.2, -0.2, 0.015)
        assert (body.bump_left, body.bump_right) == (False, False)
    assert body.pose[1] == pytest.approx(6 - RADIUS, abs=0.01)


def test_runs_are_the_same_with_a_seed_and_differ_with_another():
    def ends(seed: int) -> tuple[float, float, float]:
        rng = np.random.default_rng(seed)
        body = PhysicsBody(HALL, (4.5, 0.0, 0.4), Physics(wheels=0.01), rng=rng)
        robot = driven(body)
        assert robot.forward(3.0).bumped
        robot.turn(2.0)
        return body.pose

    assert ends(1) == ends(1)
    assert ends(1) != ends(2)


def test_ticks_of_any_length_make_the_same_run():
    poses = []
    for tick in (0.004, 0.0152):
        body = at_rest()
        for _ in range(round(1.52 / tick)):
            body.advance(0.2, 0.1, tick)
        poses.append(body.pose)
    assert poses[0] == pytest.approx(poses[1], abs=1e-9)


@pytest.mark.parametrize(
    ("field", "value"),
    [("floor", 0.0), ("wall", -1.0), ("acceleration", math.nan), ("time_step", 0.1)],
)
def test_a_wrong_assumption_is_refused(field, value):
    with pytest.raises(ValueError, match=f"{field}: expected"):
        Physics(**{field: value})


@pytest.mark.parametrize("place", [(5.9, 0.0), (9.0, 0.0), (math.nan, 0.0)])
def test_a_start_in_a_wall_is_refused(place):
    with pytest.raises(ValueError, match=r"pose: a Create 2, of radius 0\.17425 m"):
        PhysicsBody(HALL, (*place, 0.0))


@pytest.mark.parametrize("degrees", [0, 30, -45, 60])
def test_wheels_skid_at_a_bump_by_the_squared_cosine_of_the_incidence(degrees):
    start = toward_the_north_wall(math.radians(degrees), 0.3)
    robot = driven(PhysicsBody(HALL, start))
    there = robot.forward(1.0, tolerance=0.003)
    back = robot.forward(-there.distance, tolerance=0.003)
    x, y, _ = robot.robot.pose
    along = (x - start[0]) * math.cos(start[2]) + (y - start[1]) * math.sin(start[2])
    expected = 0.012 * math.cos(math.radians(degrees)) ** 2
    assert there.distance + back.distance - along == pytest.approx(expected, abs=0.003)
