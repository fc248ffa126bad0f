import errno
import os
import pty

import pytest
import serial

from jaxcell.robot.create.driver import RobotStopped
from jaxcell.robot.create.line import open_line
from jaxcell.robot.create.packets import PACKETS
from jaxcell.robot.create.reading import Reading
from jaxcell.robot.create.strain import Strain
from jaxcell.robot.emulation.body import Body
from jaxcell.robot.emulation.simulated import SimulatedCreate
from jaxcell.space import Workspace


ROOM = Workspace([(0, 0), (3, 0), (3, 1), (0, 1)])
NOTHING = {packet.name: 0 for packet in PACKETS.values()}


def frames(strain, wheels, *, left=(), right=(), overcurrent=()):
    """Find the first frame with a reason for a stop, and the reason."""
    for i in range(max(map(len, (left, right, overcurrent)))):
        values = NOTHING | {
            "left_encoder": left[i] % 65536 if left else 20 * i,
            "right_encoder": right[i] % 65536 if right else 20 * i,
            "overcurrent": overcurrent[i] if overcurrent else 0,
        }
        reason = strain.observe(wheels, Reading.of(values, time=0.015 * i, previous=None))
        if reason:
            return i, reason
    return None


def test_a_wheel_that_does_not_turn_as_commanded_is_blocked():
    i, reason = frames(Strain(), (100, 100), left=[65535] * 100)
    assert reason == "the left wheel is blocked: it does not turn"
    assert 0.9 < i * 0.015 < 1.1
    assert "right wheel" in frames(Strain(), (-100, 100), right=[7] * 100)[1]
    # The least speed of a motor, 0.03 m/s, is one count per frame; here are half a count.
    assert frames(Strain(), (30, 30), left=[65500 + i // 2 for i in range(200)]) is None
    assert frames(Strain(), (-30, -30), right=[-(i // 2) for i in range(200)]) is None
    assert frames(Strain(), (0, 0), left=[5] * 200, right=[5] * 200) is None
    assert frames(Strain(), (100, 0), right=list(range(0, 2000, 10)), left=[5] * 200) is None


def test_a_motor_that_strains_for_longer_than_a_bump_is_blocked():
    for bits in (8, 16):
        i, reason = frames(Strain(), (100, 100), overcurrent=[bits] * 40)
        assert reason == "a wheel is blocked: its motor draws too much current"
        assert 0.2 < i * 0.015 < 0.4
    assert frames(Strain(), (100, 100), overcurrent=([8] * 15 + [0]) * 5) is None
    assert frames(Strain(), (100, 100), overcurrent=[1 | 2 | 4] * 100) is None, "the brushes"
    assert frames(Strain(), (0, 0), overcurrent=[8] * 100) is None


def test_the_driver_stops_a_robot_that_is_held():
    # The bumper faces forward, so that the robot does not feel the wall behind it.
    create = SimulatedCreate(Body(ROOM, (0.3, 0.5, 0.0)))
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
