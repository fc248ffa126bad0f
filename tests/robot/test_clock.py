import math

import pytest

from jaxcell.robot.create.clock import ByClock
from jaxcell.robot.emulation.body import Body
from jaxcell.robot.emulation.simulated import SimulatedCreate
from jaxcell.robot.walker import Walker
from jaxcell.space import Workspace


ROOM = Workspace([(0, 0), (4, 0), (4, 3), (0, 3)])


def clocked(pose=(1.0, 1.0, 0.0), **fields) -> tuple[ByClock, Body]:
    body = Body(ROOM, pose)
    robot = SimulatedCreate(body)
    clock = ByClock(robot, clock=lambda: robot.robot.seconds, sleep=robot.sleep, **fields)
    return clock, body


@pytest.mark.parametrize("speed", [0.18, 0.3])
def test_a_known_speed_for_a_known_time_is_a_distance(speed):
    robot, body = clocked(speed=speed)
    moved = robot.forward(0.6, tolerance=0.01)
    assert moved.distance == pytest.approx(0.6, abs=0.005)
    assert not moved.bumped
    assert body.x == pytest.approx(1 + moved.distance, abs=0.005)
    assert robot.forward(-0.2, tolerance=0.01).distance == pytest.approx(-0.2, abs=0.005)
    assert body.x == pytest.approx(1.4, abs=0.01)
    for angle in (math.pi / 2, -2.0):
        before = body.theta
        assert robot.turn(angle, tolerance=0.01).angle == pytest.approx(angle, abs=0.01)
        assert body.theta - before == pytest.approx(angle, abs=0.01)


def test_a_bump_ends_a_timed_motion_with_its_distance():
    robot, body = clocked((3.0, 1.0, 0.0))
    moved = robot.forward(2.0, tolerance=0.01)
    assert moved.bumped
    # The wall is 1 m ahead, and the bumper is pushed in by 2 cm.
    assert moved.distance == pytest.approx(1.02, abs=0.005)
    assert robot.forward(-moved.distance, tolerance=0.01).bumped is False
    assert body.x == pytest.approx(3.0, abs=0.01)


def test_a_walker_walks_by_the_clock():
    robot, body = clocked((0.5, 0.5, 0.0), speed=0.3, turning=2.0)
    walker = Walker(robot, 1.0)
    bumps = []
    for _ in range(7):
        bumps.append(walker.step())
        if bumps[-1]:
            walker.rotate(math.pi / 2)
    assert "".join(str(int(bump)) for bump in bumps) == "0001001"
    assert (body.x, body.y) == pytest.approx((3.5, 2.5), abs=0.05)


def test_bad_speeds_of_a_clock_are_refused():
    for fields in ({"speed": 0.0}, {"speed": 0.6}, {"turning": -1.0}, {"turning": math.nan}):
        name = next(iter(fields))
        with pytest.raises(ValueError, match=f"{name}: expected more than 0 and at most"):
            clocked(**fields)
