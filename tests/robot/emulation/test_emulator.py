import itertools
import math
import os
import select
import struct
import time
import tty

import pytest
import serial
from waiting import wait_until as until

from jaxcell.robot.create import open_interface as oi
from jaxcell.robot.create.line import firmware
from jaxcell.robot.create.packets import Contact, Mode, layout, members
from jaxcell.robot.emulation.body import Body
from jaxcell.robot.emulation.emulator import BANNER, Emulator, Line
from jaxcell.space import Workspace


ROOM = Workspace([(0, 0), (4, 0), (4, 3), (0, 3)])
IDS = (7, 35, 43, 44)
FULL = bytes([132])


def emulated(pose=(1.0, 1.5, 0.0), **fields) -> Emulator:
    return Emulator(Body(ROOM, pose), **fields)


def send(robot: Emulator, *commands: bytes, seconds: float = 0.0) -> bytes:
    """Send commands to a robot, wait some seconds of its time, and return what it has sent."""
    sent = robot.exchange(0.0, b"".join(commands))
    return sent + b"".join(
        robot.exchange(oi.STREAM_PERIOD) for _ in range(round(seconds / oi.STREAM_PERIOD))
    )


def ask(robot: Emulator, *ids: int) -> dict[str, int]:
    answer = send(robot, bytes([149, len(ids), *ids]))
    names = (packet.name for packet in members(ids))
    return dict(zip(names, layout(ids).unpack(answer), strict=True))


def rolling(speed: int) -> bytes:
    return oi.drive_direct(right=speed, left=speed)


def arc(velocity: int, radius: int) -> bytes:
    return struct.pack(">Bhh", 137, velocity, radius)


def test_commands_change_the_mode():
    robot = emulated()
    # Only Start is heard in mode Off.
    send(robot, oi.SAFE, rolling(100), oi.START)
    assert ask(robot, 35)["mode"] == Mode.PASSIVE
    assert robot.wheels == (0, 0)
    for command, mode in [(oi.SAFE, 2), (FULL, 3), (bytes([143]), 1), (oi.SAFE, 2)]:
        send(robot, command)
        assert ask(robot, 35)["mode"] == mode
    send(robot, oi.STOP)
    assert robot.mode is Mode.OFF


@pytest.mark.parametrize(
    ("command", "wheels"),
    [
        (oi.drive_direct(right=300, left=-100), (-100, 300)),
        (arc(-200, -0x8000), (-200, -200)),
        (arc(100, 1), (-100, 100)),
        (arc(100, -1), (100, -100)),
        # The radius is twice the base, so that the wheels are at 3/4 and 5/4 of the speed.
        (arc(200, 470), (150, 250)),
        (bytes([146, 0, 255, 0xFF, 0x01]), (-500, 500)),
    ],
)
def test_drive_commands_set_the_wheels_in_mode_safe(command, wheels):
    robot = emulated()
    send(robot, oi.START, command, oi.SAFE)
    assert robot.mode is Mode.SAFE
    assert robot.wheels == (0, 0)
    send(robot, command)
    assert robot.wheels == wheels


def test_a_wall_presses_the_bumper():
    robot = emulated((3.0, 1.5, math.radians(-40)))
    sent = send(robot, oi.START, oi.stream(IDS), oi.SAFE, rolling(200), seconds=9.0)
    assert oi.StreamParser(IDS).feed(sent)[-1]["contact"] == Contact.BUMP_LEFT
    assert robot.pose[0] == pytest.approx(4.02, abs=1e-6)


def test_frames_come_every_15_ms_of_its_time_until_paused():
    robot, parser = emulated(), oi.StreamParser(IDS)
    frames = parser.feed(send(robot, oi.START, oi.stream(IDS), seconds=0.75))
    assert [frame["mode"] for frame in frames] == [Mode.PASSIVE] * 50
    times = [t for t, *_ in robot.trace]
    assert [b - a for a, b in itertools.pairwise(times)] == pytest.approx([0.015] * 49)
    assert send(robot, bytes([150, False]), seconds=0.15) == b""
    assert len(parser.feed(send(robot, bytes([150, True]), seconds=0.15))) == 10


@pytest.mark.parametrize(
    ("field", "danger", "packet"),
    [
        ("contact", Contact.WHEEL_DROP_LEFT, 7),
        ("cliffs", {"cliff_right"}, 12),
        ("charger", True, 34),
    ],
)
def test_danger_ends_mode_safe(field, danger, packet):
    robot = emulated()
    send(robot, oi.START, oi.SAFE, rolling(50))
    setattr(robot, field, danger)
    assert all(ask(robot, packet).values())
    assert (robot.mode, robot.wheels) == (Mode.PASSIVE, (0, 0))


@pytest.mark.parametrize(
    ("mode", "speed"), [(FULL, 50), (oi.SAFE, -50)], ids=["mode full", "a cliff behind"]
)
def test_danger_is_ignored_in_mode_full_and_a_cliff_in_a_backward_drive(mode, speed):
    robot = emulated()
    robot.cliffs.add("cliff_left")
    robot.charger = mode == FULL
    send(robot, oi.START, mode, rolling(speed), seconds=0.3)
    assert robot.wheels == (speed, speed)
    assert robot.mode is (Mode.FULL if mode == FULL else Mode.SAFE)


def test_the_battery_drains_and_dies():
    robot = emulated(charge=0.1)
    send(robot, oi.START)
    assert ask(robot, 23)["current"] == -200
    # 0.1 mAh at 200 mA last 1.8 s.
    send(robot, seconds=1.78)
    assert robot.mode is Mode.PASSIVE
    send(robot, seconds=0.04)
    assert robot.mode is Mode.OFF
    send(robot, oi.START, oi.SAFE, seconds=0.1)
    assert robot.mode is Mode.OFF


def test_latency_delays_a_command_in_its_own_time():
    robot = emulated(line=Line(latency=0.2))
    send(robot, oi.START, oi.SAFE, rolling(100), seconds=0.18)
    assert robot.wheels == (0, 0)
    send(robot, seconds=0.03)
    assert robot.wheels == (100, 100)


def test_bytes_are_lost_both_ways():
    robot, heard = emulated(line=Line(dropped=0.05), seed=3), []
    for _ in range(100):
        send(robot, oi.START)
        heard.append(robot.mode is Mode.PASSIVE)
        # One byte of several is enough to stop the robot.
        send(robot, oi.STOP * 5)
    assert 80 < sum(heard) < 100
    parser, frames = oi.StreamParser(IDS), []
    while not frames:
        # The zeros complete a request that was cut short.
        frames = parser.feed(send(robot, bytes(8), oi.START, oi.stream(IDS), seconds=1.5))
    assert 30 < len(frames) < 90
    assert parser.skipped > 30


def test_time_waits_for_a_host_that_does_not_read():
    with emulated(line=Line(speedup=1000.0)) as robot:
        host = os.open(robot.port, os.O_RDWR | os.O_NOCTTY)
        tty.setraw(host)
        os.write(host, oi.START + oi.stream(IDS))
        until(lambda: select.select([host], [], [], 0)[0])
        time.sleep(0.3)
        # 0.3 s of the clock would be 300 s of the robot.
        assert robot.seconds < 30
        # A frame has three bytes, the numbers of its packets and their data.
        size = 3 + len(IDS) + layout(IDS).size
        assert len(os.read(host, 4096)) == size
        parser, frames = oi.StreamParser(IDS), []
        while len(frames) < 200:
            frames += parser.feed(os.read(host, 4096))
        os.close(host)


def test_a_reset_prints_the_firmware():
    with (
        emulated(line=Line(speedup=20.0)) as robot,
        serial.serial_for_url(robot.port, 115200) as line,
    ):
        assert firmware(line).encode() == BANNER.replace(b"\r", b"").strip()
        assert robot.mode is Mode.OFF


def test_wrong_settings_of_an_emulator_are_refused():
    with pytest.raises(ValueError, match="dropped: expected a probability below 1, got 1"):
        Line(dropped=1.0)
    with pytest.raises(ValueError, match="speedup: expected a finite number above 0"):
        Line(speedup=0.0)
    with pytest.raises(ValueError, match="charge: expected more than 0"):
        Emulator(Body(ROOM, (1.0, 1.0, 0.0)), charge=0.0)
