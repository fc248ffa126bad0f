import functools
import inspect
import math
import signal
from types import SimpleNamespace

import numpy as np
import pytest

from jaxcell.robot.create.clock import ByClock
from jaxcell.robot.create.driver import RobotStopped
from jaxcell.robot.create.open_interface import wheel_speeds
from jaxcell.robot.create.packets import METRES_PER_COUNT, WHEEL_BASE
from jaxcell.robot.emulation.body import Body, Noise
from jaxcell.robot.emulation.direct import DirectBody
from jaxcell.robot.emulation.emulator import Emulator, Line
from jaxcell.robot.emulation.simulated import SimulatedCreate
from jaxcell.robot.walker import Walker
from jaxcell.space import Workspace


ROOM = Workspace([(0, 0), (4, 0), (4, 3), (0, 3)])
HALL = Workspace([(-99, -99), (99, -99), (99, 99), (-99, 99)])


def by_clock(body: Body, **speeds: float) -> ByClock:
    robot = SimulatedCreate(body)
    return ByClock(robot, clock=lambda: robot.robot.seconds, sleep=robot.sleep, **speeds)


@pytest.mark.parametrize(
    ("driver", "error"),
    [
        (DirectBody, 1e-6),
        (SimulatedCreate, 1e-3),
        (by_clock, 5e-3),
        (functools.partial(by_clock, speed=0.3), 5e-3),
    ],
    ids=["direct", "encoders", "clock", "fast clock"],
)
def test_a_robot_goes_as_far_as_commanded(driver, error):
    body = Body(ROOM, (1.0, 1.5, 0.0))
    robot = driver(body)
    for distance in (0.537, -0.3):
        x = body.x
        moved = robot.forward(distance, tolerance=1e-3)
        assert moved == pytest.approx((distance, 0, False, 0), abs=error)
        assert body.x - x == pytest.approx(moved.distance, abs=error)
    for angle in (-1.2, 1.2):
        heading = body.theta
        moved = robot.turn(angle, tolerance=5e-3)
        assert moved == pytest.approx((0, angle, False, 0), abs=5e-3)
        assert body.theta - heading == pytest.approx(angle, abs=1e-2)
    # The bumper is pushed in by 2 cm.
    ahead, moved = 4.02 - body.x, robot.forward(5.0, tolerance=1e-3)
    assert (moved.distance, moved.bumped) == (pytest.approx(ahead, abs=error), True)
    # The bumper is still pressed.
    assert robot.forward(0.1, tolerance=1e-3) == pytest.approx((0, 0, True, 0), abs=error)
    assert not robot.turn(0.1, tolerance=5e-3).bumped
    assert robot.forward(-0.3, tolerance=1e-3).bumped is False


def test_a_motion_that_takes_too_long_stops_the_robot():
    robot = SimulatedCreate(Body(ROOM, (3.5, 1.5, 0.0)))
    began = robot.robot.seconds
    with pytest.raises(RobotStopped, match=r"-1 are left|are left after"):
        robot.forward(-2.5, timeout=3.0)
    assert 3 < robot.robot.seconds - began < 4


def test_the_driver_stops_a_robot_that_is_held():
    # The bumper faces forward, so that the robot does not feel the wall behind it.
    create = SimulatedCreate(Body(ROOM, (0.3, 1.5, 0.0)))
    with pytest.raises(RobotStopped, match="wheel is blocked: it does not turn"):
        create.forward(-1.0)
    assert create.robot.wheels == (0, 0)
    assert create.robot.seconds < 5
    with pytest.raises(RobotStopped, match="blocked"):
        create.forward(0.1)
    create.arm()
    assert create.forward(0.1).distance == pytest.approx(0.1, abs=0.01)
    create.robot.overcurrent = 16
    with pytest.raises(RobotStopped, match="a wheel is blocked: its motor"):
        create.forward(0.5)


def test_the_simulated_robot_is_no_faster_than_its_line(monkeypatch):
    clock = [5.0]

    def sleep(seconds):
        clock[0] += seconds

    time = SimpleNamespace(monotonic=lambda: clock[0], sleep=sleep)
    monkeypatch.setattr("jaxcell.robot.emulation.simulated.time", time)
    robot = SimulatedCreate(Emulator(Body(ROOM, (1.0, 1.5, 0.0)), line=Line(speedup=4.0)))
    robot.forward(0.5)
    robot.sleep(0.1234)
    assert clock[0] - 5 == pytest.approx(robot.robot.seconds / 4)
    began = robot.robot.seconds
    robot.sleep(0.1234)
    assert robot.robot.seconds - began == pytest.approx(0.1234)


def test_a_signal_that_ends_the_block_stops_the_wheels():
    robot = SimulatedCreate(Body(ROOM, (1.0, 1.5, 0.0)))

    def ended():
        with robot:
            robot.drive(right=0.1, left=0.1)
            signal.raise_signal(signal.SIGTERM)

    with pytest.raises(SystemExit):
        ended()
    assert robot.robot.wheels == (0, 0)
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL


def test_a_walker_walks_by_the_clock():
    body = Body(ROOM, (0.5, 0.5, 0.0))
    walker = Walker(by_clock(body, speed=0.3, turning=2.0), 1.0)
    for _ in range(7):
        if walker.step():
            walker.rotate(math.pi / 2)
    assert walker.observations == "0001001"
    assert (body.x, body.y) == pytest.approx((3.5, 2.5), abs=0.05)


def test_the_default_speeds_of_the_clock_are_sent_unchanged():
    defaults = {
        name: parameter.default
        for name, parameter in inspect.signature(ByClock.__init__).parameters.items()
    }
    wheel = defaults["turning"] * WHEEL_BASE / 2
    for right, left in [(defaults["speed"],) * 2, (wheel, -wheel), (-wheel, wheel)]:
        pair = wheel_speeds(right=right, left=left)
        assert [speed / 1000 for speed in pair] == pytest.approx([right, left], abs=1e-3)


@pytest.mark.parametrize(
    ("field", "value"), [("speed", 0.0), ("speed", 0.6), ("turning", -1.0), ("turning", math.nan)]
)
def test_bad_speeds_of_a_clock_are_refused(field, value):
    with pytest.raises(ValueError, match=f"{field}: expected more than 0 and at most"):
        by_clock(Body(ROOM, (1.0, 1.0, 0.0)), **{field: value})


@pytest.mark.parametrize("speed", [0.72, 1.0, 2.15, 4.0])
def test_a_turn_does_not_move_the_centre(speed):
    body = Body(HALL, (0.0, 0.0, 0.3))
    robot = SimulatedCreate(body)
    for angle in np.radians([3, -45, 180]):
        before, heading = complex(body.x, body.y), body.theta
        moved = robot.turn(angle, speed=speed)
        assert abs(complex(body.x, body.y) - before) < 1e-3
        assert math.hypot(moved.distance, moved.left) < 1e-3
        assert moved.angle == pytest.approx(angle, abs=math.radians(1.01))
        assert body.theta - heading == pytest.approx(moved.angle, abs=math.radians(0.22))


def test_the_odometry_agrees_with_the_true_pose():
    rng = np.random.default_rng(0)
    body = Body(HALL, (0.0, 0.0, 0.0))
    robot = SimulatedCreate(body)
    walker = Walker(robot, 0.3)
    for _ in range(40):
        walker.rotate(rng.uniform(-math.pi, math.pi))
        walker.step()
        x, y, angle = walker.estimate
        assert math.hypot(x - body.x, y - body.y) < 1e-3
        off = abs(math.remainder(angle - body.theta, 2 * math.pi))
        # The encoders measure an angle to one count, 0.108 degrees.
        assert off < METRES_PER_COUNT / WHEEL_BASE
    assert off < math.radians(0.1)


def test_the_odometry_of_an_arc_agrees_with_the_true_place():
    """Half a circle with a radius of one metre takes half a minute."""
    body = Body(HALL, (0.0, 0.0, 0.0))
    robot = SimulatedCreate(body)
    for _ in range(2100):
        robot.drive(right=0.11175, left=0.08825)
        robot._after(robot.sensors())
    robot.stop()
    place = robot.sensors().place
    assert abs(place - complex(body.x, body.y)) < 2e-3
    assert body.y == pytest.approx(2, abs=0.1)


def test_the_slips_of_two_motions_are_independent():
    rng = np.random.default_rng(0)
    ratios = []
    for _ in range(40):
        body = Body(ROOM, (1.0, 1.5, 0.0), noise=Noise(distance=0.2), rng=rng)
        robot = SimulatedCreate(body)
        ways = []
        for _ in range(2):
            x = body.x
            gone = robot.forward(0.1, tolerance=1e-3).distance
            ways.append((body.x - x) / gone - 1)
        ratios.append(ways)
    first, second = np.array(ratios).T
    assert first.std() == pytest.approx(0.2, rel=0.35)
    assert second.std() == pytest.approx(0.2, rel=0.35)
    assert abs(np.corrcoef(first, second)[0, 1]) < 0.45
