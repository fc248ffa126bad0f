import contextlib
import errno
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
from pathlib import Path

import pytest
import serial
from recording_robot import RecordingRobot
from waiting import wait_until as eventually

import jaxcell
from jaxcell.robot import Create, RobotStopped
from jaxcell.robot.create.line import open_line
from jaxcell.robot.create.packets import Contact, Mode
from jaxcell.robot.create.watchdog import Watchdog
from jaxcell.robot.emulation.body import Body
from jaxcell.space import Workspace


HALL = Workspace([(-9, -9), (9, -9), (9, 9), (-9, 9)])
# These times in seconds are long enough for a busy machine.
PATIENCE = 10.0
LONG = 120.0


@pytest.fixture
def robot():
    with RecordingRobot(Body(HALL, (0.0, 0.0, 0.0))) as robot:
        yield robot


@contextlib.contextmanager
def armed(robot, patience=PATIENCE):
    with Create.open(robot.port, patience=patience) as create:
        create.arm()
        yield create


@contextlib.contextmanager
def driving(robot, patience=PATIENCE):
    """Drive a robot at 0.2 m/s."""
    with armed(robot, patience) as create:
        create.drive(right=0.2, left=0.2)
        eventually(lambda: robot.wheels == (200, 200))
        yield create


def keep_driving(create):
    while True:
        create.drive(right=0.2, left=0.2)
        time.sleep(0.05)


def test_start_and_stop_are_the_last_commands(robot):
    with driving(robot) as create:
        pass
    eventually(lambda: robot.last_opcodes == [128, 173])
    assert robot.wheels == (0, 0)
    assert 132 not in {command.opcode for _, command in robot.commands}, "mode Full"
    with pytest.raises(RobotStopped, match="closed"):
        create.drive(right=0.1, left=0.1)


def test_an_exception_stops_the_wheels(robot):
    with pytest.raises(ZeroDivisionError), driving(robot):
        raise ZeroDivisionError
    eventually(lambda: robot.mode is Mode.OFF)


def test_an_unarmed_robot_does_not_drive(robot):
    with Create.open(robot.port, patience=PATIENCE) as create:
        with pytest.raises(RobotStopped, match="not armed"):
            create.forward(0.1)
        assert robot.mode is Mode.PASSIVE


def test_a_bump_stops_the_wheels_before_the_caller_does(robot):
    with armed(robot) as create:
        assert create.drive(right=0.2, left=0.2, stop_on_bump=True)
        eventually(lambda: robot.wheels == (200, 200))
        robot.contact = Contact.BUMP_LEFT
        eventually(lambda: robot.wheels == (0, 0))
        robot.contact = Contact(0)
        eventually(lambda: not create.sensors().bump)
        assert not create.drive(right=0.2, left=0.2, stop_on_bump=True), "still after a short bump"
        assert robot.wheels == (0, 0)
        create.stop()
        assert create.drive(right=0.2, left=0.2, stop_on_bump=True)


@pytest.mark.parametrize(
    ("field", "danger", "safe", "named"),
    [
        ("contact", Contact.WHEEL_DROP_RIGHT, Contact(0), "wheel"),
        ("cliffs", {"cliff_front_left"}, set(), "cliff"),
        ("charger", True, False, "charger"),
        ("charge", 100.0, 2000.0, "battery"),
    ],
)
def test_danger_stops_the_wheels_until_armed_again(robot, field, danger, safe, named):
    with driving(robot) as create:
        setattr(robot, field, danger)
        eventually(lambda: create.sensors().danger)
        eventually(lambda: robot.wheels == (0, 0) and robot.mode is Mode.PASSIVE)
        with pytest.raises(RobotStopped, match=named):
            create.drive(right=0.2, left=0.2)
        with pytest.raises(RobotStopped, match=named):
            create.arm()
        setattr(robot, field, safe)
        eventually(lambda: create.sensors().danger is None)
        with pytest.raises(RobotStopped, match=named):
            create.drive(right=0.2, left=0.2)
        assert robot.mode is Mode.PASSIVE, "only the caller arms"
        create.arm()
        create.drive(right=0.2, left=0.2)


def test_a_robot_that_leaves_mode_safe_is_not_armed_in_a_loop(robot):
    with armed(robot) as create:
        robot.mode = Mode.PASSIVE
        with pytest.raises(RobotStopped, match="from mode Safe to Passive"):
            keep_driving(create)
        assert [command.opcode for _, command in robot.commands].count(131) == 1


def test_a_robot_may_count_its_modes_from_one(robot):
    robot.first_mode = 1
    with armed(robot) as create:
        assert robot.mode is Mode.SAFE
        assert create.forward(0.05).distance == pytest.approx(0.05, abs=0.005)


def test_a_caller_that_sleeps_stops_the_wheels(robot):
    with driving(robot, 0.5):
        eventually(lambda: robot.wheels == (0, 0))


def test_a_silent_robot_gets_the_command_to_stop(robot):
    with driving(robot, 0.5) as create:
        robot.mute = True
        with pytest.raises(RobotStopped, match="no reading"):
            keep_driving(create)
        eventually(lambda: robot.wheels == (0, 0) and robot.mode is Mode.PASSIVE)


def test_the_halt_works_after_a_truncated_command(robot):
    with driving(robot), open(robot.port, "wb", buffering=0) as line:
        line.write(bytes([145, 1, 44]))
    eventually(lambda: robot.mode is Mode.OFF and robot.wheels == (0, 0))


def test_a_line_that_ends_stops_the_driver():
    with RecordingRobot(Body(HALL, (0.0, 0.0, 0.0))) as robot:
        create = Create.open(robot.port)
        create.__enter__()
        create.arm()
    with contextlib.closing(create), pytest.raises(RobotStopped, match=r"line is lost|no reading"):
        keep_driving(create)


def test_a_line_without_a_robot_is_refused(robot):
    robot.deaf = True
    with (
        pytest.raises(ConnectionError, match="no readings"),
        Create.open(robot.port, patience=PATIENCE),
    ):
        pass


def test_a_robot_drives_over_a_network_socket():
    robot = RecordingRobot(Body(HALL, (0.0, 0.0, 0.0)))
    closing = threading.Event()

    def serve(line):
        while not closing.wait(0.005):
            readable = select.select([line], [], [], 0)[0]
            with contextlib.suppress(OSError):
                line.sendall(robot.exchange(0.005, line.recv(4096) if readable else b""))

    with socket.create_server(("127.0.0.1", 0)) as server:
        create = Create.open(f"socket://127.0.0.1:{server.getsockname()[1]}", patience=PATIENCE)
        with server.accept()[0] as line:
            thread = threading.Thread(target=serve, args=(line,))
            thread.start()
            with create:
                create.arm()
                assert create.forward(0.05).distance == pytest.approx(0.05, abs=0.005)
            eventually(lambda: robot.last_opcodes == [128, 173])
            closing.set()
            thread.join()


def test_a_line_in_use_is_refused(robot):
    with (
        Create.open(robot.port, patience=PATIENCE),
        pytest.raises(OSError, match="exclusively lock"),
    ):
        Create.open(robot.port)


def test_a_watchdog_that_dies_stops_the_wheels(robot):
    with driving(robot) as create:
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


def test_wrong_speeds_and_distances_are_refused(robot):
    with armed(robot) as create:
        for call, named in [
            (lambda: create.forward(math.inf), "finite"),
            (lambda: create.forward(0.1, speed=0.0), "speed = 0.0"),
            (lambda: create.turn(0.1, speed=5.0), "speed = 5.0"),
            (lambda: create.turn(0.1, tolerance=0.0), "tolerance = 0.0"),
            (lambda: Create(create._port, patience=0.1), "patience = 0.1"),
        ]:
            with pytest.raises(ValueError, match=named):
                call()


def test_a_line_without_permission_names_the_group(monkeypatch):
    def refuse(url, **_):
        # The error of pySerial.
        raise serial.SerialException(errno.EACCES, f"could not open port {url}: [Errno 13] Denied")

    monkeypatch.setattr(serial, "serial_for_url", refuse)
    with pytest.raises(OSError, match=r"^/dev/ttyUSB7: could not open .* in the group dialout: "):
        open_line("/dev/ttyUSB7")


def test_a_line_has_low_latency_where_it_can(monkeypatch):
    modes = []
    monkeypatch.setattr(
        serial.Serial, "set_low_latency_mode", lambda _, on: modes.append(on), raising=False
    )
    master, slave = pty.openpty()
    try:
        open_line(os.ttyname(slave)).close()
        assert modes == [True]
        monkeypatch.undo()
        # A pseudo-terminal refuses the mode.
        open_line(os.ttyname(slave)).close()
        open_line("loop://").close()
    finally:
        os.close(master)
        os.close(slave)


# A shell ignores signals in processes that it starts in the background, unlike a terminal.
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
def another_process(robot):
    """Run a process that drives the robot, in its own group as in a terminal."""
    environment = os.environ | {"PYTHONPATH": str(Path(jaxcell.__file__).parents[1])}
    process = subprocess.Popen(
        [sys.executable, "-c", DRIVING, robot.port],
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
def test_a_process_that_is_ended_stops_the_robot(robot, number):
    with another_process(robot) as process:
        os.killpg(process.pid, number)
        process.wait(LONG)
        eventually(lambda: robot.mode is Mode.OFF and robot.wheels == (0, 0))
        eventually(lambda: robot.last_opcodes == [128, 173])


def test_a_process_that_hangs_stops_the_robot(robot):
    with another_process(robot) as process:
        os.kill(process.pid, signal.SIGSTOP)
        eventually(lambda: robot.mode is Mode.PASSIVE and robot.wheels == (0, 0))
