import contextlib
import itertools
import math
import os
import select
import struct
import time
import tty

import pytest
from waiting import wait_until as until

from jaxcell.robot.create import open_interface as oi
from jaxcell.robot.create.packets import METRES_PER_COUNT, Contact, Mode, layout, members
from jaxcell.robot.emulation.body import Body
from jaxcell.robot.emulation.emulator import Emulator, Line
from jaxcell.space import Workspace


ROOM = Workspace([(0, 0), (4, 0), (4, 3), (0, 3)])
IDS = (7, 35, 43, 44)
FULL = bytes([132])


def query(*ids: int) -> bytes:
    return bytes([149, len(ids), *ids])


def arc(velocity: int, radius: int) -> bytes:
    return struct.pack(">Bhh", 137, velocity, radius)


class Host:
    """A host that exchanges bytes with an emulated robot, without the driver."""

    def __init__(self, port: str) -> None:
        self.line = os.open(port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        tty.setraw(self.line)

    def send(self, *commands: bytes) -> None:
        os.write(self.line, b"".join(commands))

    def read(self) -> bytes:
        with contextlib.suppress(BlockingIOError):
            return os.read(self.line, 4096)
        return b""

    def ask(self, *ids: int) -> dict[str, int]:
        self.send(query(*ids))
        answer = b""

        def whole() -> bool:
            nonlocal answer
            answer += self.read()
            return len(answer) >= layout(ids).size

        until(whole)
        names = (packet.name for packet in members(ids))
        return dict(zip(names, layout(ids).unpack(answer), strict=True))

    def frames(self, count: int) -> list[dict[str, int]]:
        parser, frames = oi.StreamParser(IDS), []

        def enough() -> bool:
            frames.extend(parser.feed(self.read()))
            return len(frames) >= count

        until(enough)
        return frames


@contextlib.contextmanager
def emulated(pose=(1.0, 1.5, 0.0), **fields):
    line = fields.pop("line", Line(speedup=20.0))
    with Emulator(Body(ROOM, pose), line=line, **fields) as robot:
        host = Host(robot.port)
        try:
            yield robot, host
        finally:
            os.close(host.line)


def test_commands_change_the_mode():
    with emulated() as (robot, host):
        host.send(oi.SAFE, oi.drive_direct(right=100, left=100))
        # Only Start is heard in mode Off.
        host.send(oi.START)
        assert host.ask(35)["mode"] == Mode.PASSIVE
        assert robot.wheels == (0, 0)
        for command, mode in [(oi.SAFE, 2), (FULL, 3), (bytes([143]), 1), (oi.SAFE, 2)]:
            host.send(command)
            assert host.ask(35)["mode"] == mode
        host.send(oi.STOP)
        until(lambda: robot.mode is Mode.OFF)


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
    with emulated() as (robot, host):
        host.send(oi.START, command, oi.SAFE)
        assert host.ask(35)["mode"] == Mode.SAFE
        assert robot.wheels == (0, 0)
        host.send(command)
        until(lambda: robot.wheels == wheels)


def test_the_emulated_robot_drives_as_far_as_its_encoders_count():
    with emulated() as (robot, host):
        host.send(oi.START, oi.SAFE, oi.drive_direct(right=200, left=200))
        until(lambda: robot.pose[0] > 2)
        host.send(oi.drive_direct(right=0, left=0))
        until(lambda: robot.wheels == (0, 0))
        values = host.ask(43, 44)
        went = robot.pose[0] - 1
        for name in ("left_encoder", "right_encoder"):
            assert values[name] * METRES_PER_COUNT == pytest.approx(went, abs=METRES_PER_COUNT)
        # In the time of the robot, its speed is 0.2 m/s.
        (first, x), *_, (last, end) = [(t, x) for t, x, *_ in robot.trace if 1.001 < x < 1.999]
        assert (last - first) * 0.2 == pytest.approx(end - x)


def test_a_wall_presses_the_bumper():
    with emulated(pose=(3.0, 1.5, math.radians(-40))) as (robot, host):
        host.send(oi.START, oi.stream(IDS), oi.SAFE, oi.drive_direct(right=200, left=200))
        until(lambda: host.frames(1)[-1]["contact"] == Contact.BUMP_LEFT)
        assert robot.pose[0] == pytest.approx(4.02, abs=1e-6)


def test_frames_come_every_15_ms_of_its_time_until_paused():
    with emulated() as (robot, host):
        host.send(oi.START, oi.stream(IDS))
        assert {frame["mode"] for frame in host.frames(50)} == {Mode.PASSIVE}
        times = [t for t, *_ in robot.trace]
        assert min(b - a for a, b in itertools.pairwise(times)) > 0.01
        assert 0.0149 < (times[-1] - times[0]) / (len(times) - 1) < 0.03
        # The query is answered after the pause, so that nothing comes after its answer.
        host.send(bytes([150, False]), query(35))
        until(lambda: host.read().endswith(b"\x01"))
        ticks = len(robot.trace)
        until(lambda: len(robot.trace) > ticks + 5)
        assert host.read() == b""
        host.send(bytes([150, True]))
        assert host.frames(3)


@pytest.mark.parametrize("danger", ["contact", "cliff_right", "charger"])
def test_danger_ends_mode_safe(danger):
    with emulated() as (robot, host):
        host.send(oi.START, oi.SAFE, oi.drive_direct(right=50, left=50))
        until(lambda: robot.wheels == (50, 50))
        if danger == "contact":
            robot.contact = Contact.WHEEL_DROP_LEFT
        elif danger == "charger":
            robot.charger = True
        else:
            robot.cliffs.add(danger)
        until(lambda: robot.mode is Mode.PASSIVE)
        assert robot.wheels == (0, 0)
        assert host.ask(7, 12, 34)[danger]


@pytest.mark.parametrize(
    ("mode", "speed"), [(FULL, 50), (oi.SAFE, -50)], ids=["mode full", "a cliff behind"]
)
def test_danger_is_ignored_in_mode_full_and_a_cliff_in_a_backward_drive(mode, speed):
    with emulated() as (robot, host):
        robot.cliffs.add("cliff_left")
        robot.charger = mode == FULL
        host.send(oi.START, mode, oi.drive_direct(right=speed, left=speed))
        until(lambda: abs(robot.pose[0] - 1) > 0.01)
        assert robot.mode is (Mode.FULL if mode == FULL else Mode.SAFE)


def test_the_battery_drains_and_dies():
    with emulated(charge=0.1) as (robot, host):
        host.send(oi.START)
        assert host.ask(23)["current"] == -200
        until(lambda: robot.mode is Mode.OFF)
        # 0.1 mAh at 200 mA last 1.8 s.
        assert robot.seconds > 1.7
        host.send(oi.START, oi.SAFE)
        tick = len(robot.trace)
        until(lambda: len(robot.trace) > tick + 5)
        assert robot.mode is Mode.OFF


def test_latency_delays_a_command_in_its_own_time():
    with emulated(line=Line(latency=0.2, speedup=5.0)) as (robot, host):
        began = robot.seconds
        host.send(oi.START, oi.SAFE, oi.drive_direct(right=100, left=100))
        until(lambda: robot.wheels == (100, 100))
        assert robot.seconds - began >= 0.2


def test_bytes_are_lost_both_ways():
    with emulated(line=Line(dropped=0.05, speedup=20.0), seed=3) as (robot, host):
        heard = []
        for _ in range(100):
            host.send(oi.START)
            tick = len(robot.trace)
            until(lambda tick=tick: len(robot.trace) > tick + 1)
            heard.append(robot.mode is Mode.PASSIVE)
            # One byte of several is enough to stop the robot.
            host.send(oi.STOP * 5)
            until(lambda: robot.mode is Mode.OFF)
        assert 80 < sum(heard) < 100
        parser, frames = oi.StreamParser(IDS), []

        def some_are_damaged() -> bool:
            if not frames:
                # The zeros complete a request that was cut short.
                host.send(bytes(8), oi.START, oi.stream(IDS))
                time.sleep(0.01)
            frames.extend(parser.feed(host.read()))
            return len(frames) > 30 and parser.skipped > 30

        until(some_are_damaged)


def test_time_waits_for_a_host_that_does_not_read():
    with emulated(line=Line(speedup=1000.0)) as (robot, host):
        host.send(oi.START, oi.stream(IDS))
        until(lambda: select.select([host.line], [], [], 0)[0])
        time.sleep(0.3)
        # 0.3 s of the clock would be 300 s of the robot.
        assert robot.seconds < 30
        # A frame has three bytes, the numbers of its packets and their data.
        assert len(host.read()) == 3 + len(IDS) + layout(IDS).size
        assert host.frames(200)


def test_wrong_settings_of_an_emulator_are_refused():
    with pytest.raises(ValueError, match="dropped: expected a probability below 1, got 1"):
        Line(dropped=1.0)
    with pytest.raises(ValueError, match="speedup: expected a finite number above 0"):
        Line(speedup=0.0)
    with pytest.raises(ValueError, match="charge: expected above 0"):
        Emulator(Body(ROOM, (1.0, 1.0, 0.0)), charge=0.0)
