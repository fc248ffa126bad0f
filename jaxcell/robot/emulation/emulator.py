import contextlib
import dataclasses
import math
import os
import select
import threading
import time
import tty
from collections import deque
from typing import Protocol, runtime_checkable

import numpy as np

from ..create.open_interface import MAX_SPEED, STREAM_PERIOD, Command, CommandParser, stream_frame
from ..create.packets import PACKETS, WHEEL_BASE, Contact, Mode, encode


BANNER = b"Roomba by iRobot!\r\nr3_robot/tags/release-3.5.x:emulated CLEAN\r\n"
"""The text that the emulated robot prints after a reset."""

# The capacity of the battery in mAh, and the currents of the robot at rest and of its motors in mA.
_CAPACITY, _STANDBY, _MOTORS = 2696, 200.0, 1000.0
_NOTHING = {packet.name: 0 for packet in PACKETS.values()}
_CLIFFS = ("cliff_left", "cliff_front_left", "cliff_front_right", "cliff_right")


@runtime_checkable
class Moving(Protocol):
    """The interface of a two-wheeled body, such as [`Body`][jaxcell.robot.emulation.body.Body]."""

    @property
    def pose(self) -> tuple[float, float, float]:
        """The x and y in metres, and the heading in radians, which may exceed a full turn."""

    @property
    def counts(self) -> tuple[int, int]:
        """The counts of the left and the right encoder, from 0 to 65535."""

    @property
    def bump_left(self) -> bool:
        """True if the left half of the bumper is pressed."""

    @property
    def bump_right(self) -> bool:
        """True if the right half of the bumper is pressed."""

    def advance(self, left: float, right: float, seconds: float) -> None:
        """Turn the left wheel at `left` m/s and the right wheel at `right` m/s for `seconds`."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Line:
    """The properties of the serial line to an emulated robot, and of the robot's clock."""

    latency: float = 0.0
    "The seconds from the arrival of a command to its effect."
    dropped: float = 0.0
    "The probability that a byte is lost, the same in both directions of the line."
    speedup: float = 1.0
    """The emulated seconds per real second. If it is above 1, the emulated time stands still until
    the host has read all bytes, so that a slow host misses no byte."""

    def __post_init__(self) -> None:
        if not (math.isfinite(self.latency) and self.latency >= 0):
            raise ValueError(f"latency: expected a finite number from 0, got {self.latency!r}")
        if not 0 <= self.dropped < 1:
            raise ValueError(f"dropped: expected a probability below 1, got {self.dropped!r}")
        if not (math.isfinite(self.speedup) and self.speedup > 0):
            raise ValueError(f"speedup: expected a finite number above 0, got {self.speedup!r}")


class Emulator:
    """An emulated Create 2 on a pseudo-terminal, whose body moves in a map.

    An emulator is a context manager. Within its block, a thread runs the robot, and `port` is the
    name of a device that a host can open as a serial line. Two runs with the same seed are similar
    but not equal, because the host depends on the real clock. To emulate a failure, change
    `contact`, `cliffs`, `charger`, `charge` or `overcurrent` during a run.

    The robot has the modes, the drive commands, the stream and the queries of a Create 2, and
    accepts the other commands without effect. Packets that are not emulated are 0, such as the
    odometry of the robot (19 and 20).
    """

    port: str
    "The name of the device that the host opens."
    contact: Contact
    "The bits of packet 7 for wheels that hang in the air; the body determines the other bits."
    cliffs: set[str]
    "The names of the cliff packets (`cliff_left`, ...) that sense no floor."
    charger: bool
    "True if the charger is plugged in."
    charge: float
    "The charge of the battery in mAh, which decreases with time."
    overcurrent: int
    "The bits of packet 14: 8 for the right wheel, 16 for the left wheel, 1 to 4 for the brushes."

    def __init__(
        self, body: Moving, *, line: Line | None = None, charge: float = 2000.0, seed: int = 0
    ) -> None:
        """Connect a body to a serial line, by default without faults and in real time.

        The charge of the battery is in mAh. With an empty battery the robot ignores all commands.
        The seed determines the lost bytes.
        """
        if not 0 < charge <= _CAPACITY:
            raise ValueError(f"charge: expected more than 0 and at most {_CAPACITY}, got {charge}")
        self.line = line or Line()
        self.contact, self.cliffs, self.charger = Contact(0), set(), False
        self.overcurrent = 0
        self.mode = Mode.OFF
        self.wheels = (0, 0)
        "The commanded speeds of the left and the right wheel, in mm/s."
        self.seconds = 0.0
        "The time of the robot since the beginning, in seconds."
        self.trace: list[tuple[float, float, float, float]] = []
        "The time in seconds and the pose at every tick of 15 ms."
        self.body, self.charge = body, charge
        self._rng = np.random.default_rng(seed)
        self._parser = CommandParser()
        self._pending: deque[tuple[float, Command]] = deque()
        self._frame_due, self._sent = STREAM_PERIOD, b""
        self._ids: tuple[int, ...] = ()
        self._streaming = False
        self._lock = threading.Lock()
        self._closing = threading.Event()
        self._failure: BaseException | None = None

    @property
    def pose(self) -> tuple[float, float, float]:
        """The pose of the body: x and y in metres, and the heading in radians."""
        with self._lock:
            return self.body.pose

    def __enter__(self) -> "Emulator":
        self._master, self._slave = os.openpty()
        # The line stays up without a host, because this end remains open.
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.port = os.ttyname(self._slave)
        self._thread = threading.Thread(target=self._play, name="emulated robot", daemon=True)
        self._thread.start()
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        self._closing.set()
        self._thread.join()
        os.close(self._master)
        os.close(self._slave)
        if self._failure is not None and error is None:
            raise self._failure

    def exchange(self, seconds: float, data: bytes = b"") -> bytes:
        """Advance the time by `seconds`, at most one period of frames, and then receive `data`.

        Returns the bytes that the robot has sent.
        """
        with self._lock:
            self._pass(seconds)
            due = self.seconds + self.line.latency
            self._pending += [(due, command) for command in self._parser.feed(self._lossy(data))]
            while self._pending and self._pending[0][0] <= self.seconds:
                self._do(self._pending.popleft()[1])
            self._keep_safe()
            if self.seconds >= self._frame_due:
                self._frame_due = max(self._frame_due + STREAM_PERIOD, self.seconds)
                self.trace.append((self.seconds, *self.body.pose))
                if self._streaming:
                    self._send(stream_frame(self._ids, self._values()))
            sent, self._sent = self._lossy(self._sent), b""
            return sent

    def _play(self) -> None:
        try:
            before = time.monotonic()
            while not self._closing.is_set():
                due = min([self._frame_due, *(when for when, _ in self._pending)])
                wait = max(due - self.seconds, 0.0) / self.line.speedup
                readable, _, _ = select.select([self._master], [], [], min(wait, 0.05))
                clock = time.monotonic()
                # No tick is longer than a frame: if this machine is slow, so is the robot.
                passed = min((clock - before) * self.line.speedup, STREAM_PERIOD)
                before = clock
                fast = self.line.speedup > 1 and not readable
                # The host still has bytes to read.
                if fast and select.select([self._slave], [], [], 0)[0]:
                    time.sleep(1e-4)
                    continue
                sent = self.exchange(passed, os.read(self._master, 4096) if readable else b"")
                # A host that does not read loses bytes, because the line has no flow control.
                with contextlib.suppress(BlockingIOError):
                    os.write(self._master, sent)
        except BaseException as error:
            self._failure = error

    def _pass(self, seconds: float) -> None:
        self.seconds += seconds
        left, right = self.wheels
        self.body.advance(left / 1000, right / 1000, seconds)
        self.charge += self._current() * seconds / 3600
        if self.charge <= 0:
            self.charge = 0.0
            self._close_interface()

    def _do(self, command: Command) -> None:
        if self.charge <= 0:
            return
        match command.opcode, command.data:
            case 7, _:
                self._close_interface()
                self._send(BANNER)
            case 128, _:
                self._to(Mode.PASSIVE)
            case _ if self.mode is Mode.OFF:
                pass
            case 173, _:
                self._close_interface()
            case 131, _:
                self._to(Mode.SAFE)
            case 132, _:
                self._to(Mode.FULL)
            case 133 | 134 | 135 | 136 | 143, _:
                self._to(Mode.PASSIVE)
            case 137 | 145 | 146, _ if self.mode is Mode.PASSIVE:
                pass
            case 137, _:
                self.wheels = _arc(*command.words)
            case 145, _:
                right, left = command.words
                self.wheels = _limited(left), _limited(right)
            case 146, _:
                right, left = command.words
                self.wheels = _limited(left * MAX_SPEED // 255), _limited(right * MAX_SPEED // 255)
            case 142, ids:
                self._answer(ids)
            case 149, data:
                self._answer(data[1:])
            case 148, data:
                self._ids = tuple(data[1:])
                self._streaming = self._can_stream(self._ids)
            case 150, data:
                self._streaming = bool(data[0]) and self._can_stream(self._ids)

    def _answer(self, ids: bytes) -> None:
        with contextlib.suppress(ValueError):
            self._send(encode(ids, self._values()))

    def _can_stream(self, ids: tuple[int, ...]) -> bool:
        """Check that the packets `ids` can be streamed; a lost byte may have made them invalid."""
        try:
            stream_frame(ids, self._values())
        except ValueError:
            return False
        return True

    def _to(self, mode: Mode) -> None:
        if mode is Mode.PASSIVE:
            self.wheels = (0, 0)
        self.mode = mode

    def _close_interface(self) -> None:
        self.mode, self.wheels, self._streaming = Mode.OFF, (0, 0), False

    def _keep_safe(self) -> None:
        forward = sum(self.wheels) > 0
        unsafe = self.contact & Contact.WHEEL_DROP or self.charger or (self.cliffs and forward)
        if self.mode is Mode.SAFE and unsafe:
            self._to(Mode.PASSIVE)

    def _values(self) -> dict[str, int]:
        body = self.body
        bump = Contact.BUMP_LEFT * body.bump_left | Contact.BUMP_RIGHT * body.bump_right
        left, right = self.wheels
        left_count, right_count = body.counts
        return {
            **_NOTHING,
            "contact": int(self.contact | bump),
            **{name: int(name in self.cliffs) for name in _CLIFFS},
            "overcurrent": self.overcurrent,
            "charging_state": 2 * self.charger,
            "voltage": int(12000 + 4500 * self.charge / _CAPACITY),
            "current": int(self._current()),
            "temperature": 25,
            "charge": int(self.charge),
            "capacity": _CAPACITY,
            "charger": int(self.charger),
            "mode": self.mode,
            "stream_packets": len(self._ids),
            "requested_left": left,
            "requested_right": right,
            "left_encoder": left_count,
            "right_encoder": right_count,
        }

    def _current(self) -> float:
        """Compute the current into the battery, in mA."""
        return -_STANDBY - _MOTORS * any(self.wheels)

    def _send(self, data: bytes) -> None:
        self._sent += data

    def _lossy(self, data: bytes) -> bytes:
        if not self.line.dropped:
            return data
        kept = self._rng.random(len(data)) >= self.line.dropped
        return bytes(np.frombuffer(data, np.uint8)[kept])


def _limited(speed: int) -> int:
    return max(-MAX_SPEED, min(MAX_SPEED, speed))


def _arc(velocity: int, radius: int) -> tuple[int, int]:
    """Compute the speeds of the left and the right wheel on an arc, in mm/s.

    `radius` is in mm. The radii -0x8000 and 0x7FFF mean a straight drive, and -1 and 1 a turn on
    the spot.
    """
    velocity = _limited(velocity)
    if radius in (-0x8000, 0x7FFF):
        return velocity, velocity
    if radius in (-1, 1):
        return -radius * velocity, radius * velocity
    ratio = WHEEL_BASE * 1000 / 2 / radius if radius else 0.0
    return _limited(round(velocity * (1 - ratio))), _limited(round(velocity * (1 + ratio)))
