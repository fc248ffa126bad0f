import contextlib
import math
import os
import pty
import select
import signal
import socket
import subprocess
import sys
import threading
import time
import tty
from pathlib import Path

import pytest
from waiting import wait_until as eventually

import jaxcell
from jaxcell.robot import Create, RobotStopped
from jaxcell.robot.create.open_interface import Command, CommandParser, stream_frame
from jaxcell.robot.create.packets import METRES_PER_COUNT, PACKETS, Contact
from jaxcell.robot.create.watchdog import Watchdog


# Long enough for a machine that has other things to do.
PATIENCE = 10.0
LONG = 120.0


class FakeRobot:
    """A robot on a free floor at the other end of a line: obeys, streams, and remembers."""

    def __init__(self, line, first_mode=0):
        self.line = line
        self.parser = CommandParser()
        self.first_mode = first_mode
        self.values = {packet.name: 0 for packet in PACKETS.values()}
        self.values |= {"charge": 2000, "capacity": 2696}
        self.mode, self.wheels, self.ids = 0, (0, 0), ()
        self.counts = [0.0, 65500.0]
        self.commands = []
        self.deaf = self.mute = False
        self.on_tick = lambda: None
        self.closing = threading.Event()
        self.thread = threading.Thread(target=self.run)

    def run(self):
        before = time.monotonic()
        while not self.closing.is_set():
            if select.select([self.line], [], [], 0.01)[0] and not self.deaf:
                with contextlib.suppress(OSError):
                    for command in self.parser.feed(os.read(self.line, 4096)):
                        self.obey(command)
            now = time.monotonic()
            if now - before > 0.01:
                # A busy machine makes the robot late, not fast.
                self.tick(min(now - before, 0.02))
                before = now

    def obey(self, command):
        self.commands.append(command)
        if command.opcode == 128:
            self.mode, self.wheels = 1, (0, 0)
        elif command.opcode == 173:
            self.mode, self.wheels, self.ids = 0, (0, 0), ()
        elif command.opcode == 131 and self.mode:
            self.mode = 2
        elif command.opcode == 145 and self.mode == 2:
            self.wheels = command.words
        elif command.opcode == 148:
            self.ids = tuple(command.data[1:])

    def tick(self, seconds):
        right, left = self.wheels
        self.counts[0] += left / 1000 * seconds / METRES_PER_COUNT
        self.counts[1] += right / 1000 * seconds / METRES_PER_COUNT
        self.on_tick()
        if self.ids and not self.mute:
            values = self.values | {
                "left_encoder": int(self.counts[0]) % 65536,
                "right_encoder": int(self.counts[1]) % 65536,
                "mode": self.mode + self.first_mode,
            }
            with contextlib.suppress(OSError):
                os.write(self.line, stream_frame(self.ids, values))

    def __enter__(self):
        self.thread.start()
        return self

    def __exit__(self, *_):
        self.closing.set()
        self.thread.join()


@contextlib.contextmanager
def on_a_terminal(**options):
    """A fake robot, and the name of the line to it."""
    master, slave = pty.openpty()
    tty.setraw(slave)
    os.set_blocking(master, False)
    try:
        with FakeRobot(master, **options) as robot:
            yield robot, os.ttyname(slave)
    finally:
        os.close(slave)
        os.close(master)


@pytest.fixture
def terminal():
    with on_a_terminal() as robot_and_name:
        yield robot_and_name


@contextlib.contextmanager
def driving(terminal, patience=PATIENCE):
    """A robot that drives at 0.2 m/s, and its driver."""
    robot, name = terminal
    with Create.open(name, patience=patience) as create:
        create.arm()
        create.drive(right=0.2, left=0.2)
        eventually(lambda: robot.wheels == (200, 200))
        yield robot, create


def keep_driving(create):
    while True:
        create.drive(right=0.2, left=0.2)
        time.sleep(0.05)


def test_forward_and_turn_by_the_encoders(terminal):
    robot, name = terminal
    with Create.open(name, patience=PATIENCE) as create:
        create.arm()
        start = create.sensors()
        moved = create.forward(0.15, speed=0.4)
        assert moved.distance == pytest.approx(0.15, abs=0.005)
        assert not moved.bumped
        moved = create.forward(-0.1)
        assert moved.distance == pytest.approx(-0.1, abs=0.005)
        moved = create.turn(-math.pi / 2, speed=2.0)
        assert moved.angle == pytest.approx(-math.pi / 2, abs=math.radians(1.001))
        end = create.sensors()
        assert end.distance - start.distance == pytest.approx(0.05, abs=0.02)
        assert end.heading - start.heading == pytest.approx(-math.pi / 2, abs=0.1)
    eventually(lambda: robot.mode == 0)
    assert robot.counts[1] < 65536 or robot.counts[0] < 0, "a counter went through its wrap"


def test_start_then_stop_are_the_last_words(terminal):
    with driving(terminal) as (robot, create):
        pass
    eventually(lambda: robot.commands[-2:] == [Command(128), Command(173)])
    assert robot.wheels == (0, 0)
    assert Command(132) not in robot.commands, "mode Full"
    with pytest.raises(RobotStopped, match="closed"):
        create.drive(right=0.1, left=0.1)


def test_an_exception_stops_the_wheels(terminal):
    with pytest.raises(ZeroDivisionError), driving(terminal):
        raise ZeroDivisionError
    eventually(lambda: terminal[0].mode == 0)


def test_an_unarmed_robot_does_not_drive(terminal):
    robot, name = terminal
    with Create.open(name, patience=PATIENCE) as create:
        with pytest.raises(RobotStopped, match="not armed"):
            create.forward(0.1)
        assert robot.mode == 1


def test_a_bump_stops_the_wheels_before_the_caller_does(terminal):
    robot, name = terminal
    with Create.open(name, patience=PATIENCE) as create:
        create.arm()
        assert create.drive(right=0.2, left=0.2, stop_on_bump=True)
        eventually(lambda: robot.wheels == (200, 200))
        robot.values["contact"] = int(Contact.BUMP_LEFT)
        eventually(lambda: robot.wheels == (0, 0))
        robot.values["contact"] = 0
        eventually(lambda: not create.sensors().bump)
        assert not create.drive(right=0.2, left=0.2, stop_on_bump=True), "still after a short bump"
        assert robot.wheels == (0, 0)
        create.stop()
        assert create.drive(right=0.2, left=0.2, stop_on_bump=True)


def test_forward_ends_at_a_bump_and_turn_does_not(terminal):
    robot, name = terminal

    def wall():
        if robot.counts[0] * METRES_PER_COUNT > 0.1:
            robot.values["contact"] = int(Contact.BUMP)

    with Create.open(name, patience=PATIENCE) as create:
        create.arm()
        robot.on_tick = wall
        moved = create.forward(1.0)
        assert moved.bumped
        assert 0.09 < moved.distance < 0.5
        assert not create.turn(0.3).bumped
        again = create.forward(0.2)
        assert again.bumped
        assert abs(again.distance) < 0.1


@pytest.mark.parametrize(
    ("values", "named"),
    [
        ({"contact": int(Contact.WHEEL_DROP_RIGHT)}, "wheel"),
        ({"cliff_front_left": 1}, "cliff"),
        ({"charger": 1}, "charger"),
        ({"charge": 100}, "battery"),
    ],
)
def test_danger_stops_the_wheels_until_armed_again(terminal, values, named):
    with driving(terminal) as (robot, create):
        safe = dict(robot.values)
        robot.values |= values
        eventually(lambda: robot.wheels == (0, 0) and robot.mode == 1)
        with pytest.raises(RobotStopped, match=named):
            create.drive(right=0.2, left=0.2)
        with pytest.raises(RobotStopped, match=named):
            create.arm()
        robot.values = safe
        eventually(lambda: create.sensors().danger is None)
        with pytest.raises(RobotStopped, match=named):
            create.drive(right=0.2, left=0.2)
        assert robot.mode == 1, "only the caller arms"
        create.arm()
        create.drive(right=0.2, left=0.2)


def test_a_robot_that_leaves_mode_safe_is_not_armed_in_a_loop(terminal):
    robot, name = terminal
    with Create.open(name, patience=PATIENCE) as create:
        create.arm()
        robot.mode = 1
        with pytest.raises(RobotStopped, match="from mode Safe to Passive"):
            keep_driving(create)
        assert robot.commands.count(Command(131)) == 1


def test_a_robot_that_counts_its_modes_from_one():
    with on_a_terminal(first_mode=1) as (robot, name), Create.open(name, patience=PATIENCE) as c:
        c.arm()
        assert robot.mode == 2
        assert c.forward(0.05).distance == pytest.approx(0.05, abs=0.005)


def test_a_caller_that_sleeps_stops_the_wheels(terminal):
    with driving(terminal, 0.5) as (robot, _):
        eventually(lambda: robot.wheels == (0, 0))


def test_a_silent_robot_gets_the_command_to_stop(terminal):
    with driving(terminal, 0.5) as (robot, create):
        robot.mute = True
        with pytest.raises(RobotStopped, match="no reading"):
            keep_driving(create)
        eventually(lambda: robot.wheels == (0, 0) and robot.mode == 1)


def test_a_command_cut_short_does_not_swallow_the_halt(terminal):
    with driving(terminal) as (robot, _):
        robot.parser.feed(bytes([145, 1, 44]))
    eventually(lambda: robot.mode == 0 and robot.wheels == (0, 0))


def test_a_line_that_ends_stops_the_driver():
    master, slave = pty.openpty()
    tty.setraw(slave)
    os.set_blocking(master, False)
    with FakeRobot(master) as robot, contextlib.closing(Create.open(os.ttyname(slave))) as create:
        create.__enter__()
        create.arm()
        os.close(slave)
        robot.closing.set()
        robot.thread.join()
        os.close(master)
        with pytest.raises(RobotStopped, match=r"line is lost|no reading"):
            keep_driving(create)


def test_a_line_without_a_robot_is_refused():
    master, slave = pty.openpty()
    tty.setraw(slave)
    try:
        with pytest.raises(ConnectionError, match="no readings"), Create.open(os.ttyname(slave)):
            pass
    finally:
        os.close(slave)
        os.close(master)


def test_a_robot_drives_over_a_network_socket():
    with socket.create_server(("127.0.0.1", 0)) as server:
        create = Create.open(f"socket://127.0.0.1:{server.getsockname()[1]}", patience=PATIENCE)
        with server.accept()[0] as line:
            line.setblocking(False)
            with FakeRobot(line.fileno()) as robot:
                with create:
                    create.arm()
                    assert create.forward(0.05).distance == pytest.approx(0.05, abs=0.005)
                eventually(lambda: robot.commands[-2:] == [Command(128), Command(173)])


def test_a_line_in_use_is_refused(terminal):
    _, name = terminal
    with (
        Create.open(name, patience=PATIENCE),
        pytest.raises(OSError, match="exclusively lock"),
    ):
        Create.open(name)


def test_a_watchdog_that_dies_stops_the_wheels(terminal):
    with driving(terminal) as (robot, create):
        os.kill(create._watchdog.pid, signal.SIGKILL)
        with pytest.raises(RobotStopped, match="watchdog"):
            keep_driving(create)
        eventually(lambda: robot.wheels == (0, 0))


def test_a_watchdog_that_does_not_start_leaves_no_line_open():
    before = sorted(os.listdir("/dev/fd"))
    for command in (["/no/such/program"], ["false"]):
        with pytest.raises(OSError, match=r"No such file|did not start"):
            Watchdog(command)
    assert sorted(os.listdir("/dev/fd")) == before


def test_bad_speeds_and_distances_are_refused(terminal):
    with Create.open(terminal[1], patience=PATIENCE) as create:
        create.arm()
        for call, named in [
            (lambda: create.drive(right=0.6, left=0.0), "right = 0.6"),
            (lambda: create.drive(right=0.0, left=math.nan), "left = nan"),
            (lambda: create.forward(math.inf), "finite"),
            (lambda: create.forward(0.1, speed=0.0), "speed = 0.0"),
            (lambda: create.turn(0.1, speed=5.0), "speed = 5.0"),
            (lambda: create.turn(0.1, tolerance=0.0), "tolerance = 0.0"),
            (lambda: Create(create._port, patience=0.1), "patience = 0.1"),
        ]:
            with pytest.raises(ValueError, match=named):
                call()


def test_a_jammed_wheel_ends_a_motion(terminal):
    robot, name = terminal

    def jam():
        robot.counts = [0.0, 0.0]

    with Create.open(name, patience=PATIENCE) as create:
        create.arm()
        robot.on_tick = jam
        with pytest.raises(RobotStopped, match="are left after"):
            create.forward(0.5, timeout=0.2)
        eventually(lambda: robot.wheels == (0, 0))


# A shell that starts these tests in the background has signals ignored that a terminal would not.
DRIVING = """
import signal, sys, time
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)
signal.signal(signal.SIGTERM, signal.SIG_DFL)
from jaxcell.robot import Create
with Create.open(sys.argv[1], patience=2.0) as robot:
    robot.arm()
    while True:
        robot.drive(right=0.2, left=0.2)
        time.sleep(0.05)
"""


@contextlib.contextmanager
def another_process(robot, name):
    """A process that drives the robot, in the group of its own that a terminal would give it."""
    environment = os.environ | {"PYTHONPATH": str(Path(jaxcell.__file__).parents[1])}
    process = subprocess.Popen(
        [sys.executable, "-c", DRIVING, name],
        env=environment,
        start_new_session=True,
        stderr=subprocess.DEVNULL,
    )
    try:
        eventually(lambda: robot.wheels == (200, 200) or process.poll() is not None)
        assert process.poll() is None
        yield process
    finally:
        process.kill()
        process.wait()


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGHUP, signal.SIGINT])
def test_a_process_that_is_ended_stops_the_robot(terminal, number):
    robot, name = terminal
    with another_process(robot, name) as process:
        os.killpg(process.pid, number)
        process.wait(LONG)
        eventually(lambda: robot.mode == 0 and robot.wheels == (0, 0))
        eventually(lambda: robot.commands[-2:] == [Command(128), Command(173)])


def test_a_process_that_hangs_stops_the_robot(terminal):
    robot, name = terminal
    with another_process(robot, name) as process:
        os.kill(process.pid, signal.SIGSTOP)
        eventually(lambda: robot.mode == 1 and robot.wheels == (0, 0))
