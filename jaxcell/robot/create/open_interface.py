"""The commands of the Create 2 Open Interface, and the frames of its sensor stream, as bytes.

Both ends are here, the host's and the robot's, so that an emulator speaks the same code. Nothing
here does input or output. Source: *iRobot Create 2 Open Interface*, 2016.
"""

import functools
import operator
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from .packets import chosen, codes, members, size


BAUD = 115200
"""Bits per second of a Create 2 or Roomba 600, 8N1, no flow control."""

STREAM_PERIOD = 0.015
"""Seconds from one frame of the stream to the next; the sensors are read as often."""

MAX_SPEED = 500
"""Fastest wheel or body speed, mm/s."""

MAX_RADIUS = 2000
"""Largest radius of `drive`, mm."""

STRAIGHT = -0x8000
"""Radius of `drive` that means no turning."""

HEADER = 19
"""First byte of a frame of the stream."""

RESET = bytes([7])
"""Reboot the robot, which then prints its firmware version; ends in mode Off."""

START = bytes([128])
"""Open the interface. From any mode to Passive."""

SAFE = bytes([131])
"""To mode Safe: the host drives; a cliff, a dropped wheel or a charger takes it to Passive."""

FULL = bytes([132])
"""To mode Full: the host drives and nothing stops the wheels."""

STOP = bytes([173])
"""Close the interface: mode Off, no stream."""

# Bytes of data after each opcode that a robot knows; a string counts its own data (see below).
_DATA_BYTES = {
    **dict.fromkeys((7, 128, 130, 131, 132, 133, 134, 135, 136, 143, 173), 0),
    **dict.fromkeys((129, 138, 141, 142, 150, 165), 1),
    162: 2,
    **dict.fromkeys((139, 144, 168), 3),
    **dict.fromkeys((137, 145, 146, 163, 164), 4),
    167: 15,
}


def drive(velocity: int, radius: int = STRAIGHT) -> bytes:
    """Drive along an arc, with the body's centre at -500 to 500 mm/s.

    The radius, -2000 to 2000 mm, is positive to the left; 1 and -1 spin on the spot,
    counterclockwise and clockwise.

    **Raises:** `ValueError` for a value out of range.
    """
    _check("velocity", velocity, MAX_SPEED)
    if radius != STRAIGHT:
        _check("radius", radius, MAX_RADIUS)
    return struct.pack(">Bhh", 137, velocity, radius)


def drive_direct(*, right: int, left: int) -> bytes:
    """Set the speed of each wheel, -500 to 500 mm/s. The right one goes first on the wire.

    **Raises:** `ValueError` for a value out of range.
    """
    _check("right", right, MAX_SPEED)
    _check("left", left, MAX_SPEED)
    return struct.pack(">Bhh", 145, right, left)


def stream(ids: Sequence[int]) -> bytes:
    """Request a frame with these packets every 15 ms from now on.

    **Raises:** `ValueError` for an unknown number, for none, or for a frame of more than the 172
    bytes that the line carries in 15 ms.
    """
    _FrameLayout.of(tuple(ids))
    return bytes([148, len(ids), *ids])


def stream_frame(ids: Sequence[int], values: Mapping[str, int]) -> bytes:
    """Write a frame of the stream as the robot sends it."""
    layout = _FrameLayout.of(tuple(ids))
    known, free = layout.empty, layout.values.pack(*chosen(ids, values))
    frame = bytes(map(operator.or_, known, free))
    return frame[:-1] + bytes([-sum(frame) % 256])


class StreamParser:
    """Find the frames of a stream, which arrives in pieces and may be damaged.

    `ids` are packets and groups, as for `stream`. A frame is accepted if its header, its length,
    its packet numbers in the order of the request, and its checksum are right, and if all values
    are within the ranges of their packets. Otherwise the search continues at the next byte. No
    input raises an exception.

    The guarantee depends on the packets. For `jaxcell.robot.STREAM`: of three consecutive frames
    with a single byte that is changed, lost or doubled, at most two are lost, and only values that
    the robot sent are returned. This has two reasons. If a frame is read from a wrong position, at
    least two known bytes disagree. And the last packet has a byte that never equals the header;
    otherwise this byte could be lost and the next header be taken for the checksum.
    Greater damage may remain unnoticed: an eight-bit checksum accepts one in 256 damaged frames
    whose length and packet numbers are right.

    A byte of noise, and a frame with the two bytes of the encoders:

        >>> from jaxcell import robot
        >>> from jaxcell.robot.create.open_interface import stream_frame
        >>> frame = stream_frame([43, 44], {"left_encoder": 7, "right_encoder": 9})
        >>> parser = robot.StreamParser([43, 44])
        >>> parser.feed(bytes([5]) + frame), parser.skipped
        ([{'left_encoder': 7, 'right_encoder': 9}], 1)
    """

    skipped: int
    """Bytes so far that belong to no accepted frame."""

    def __init__(self, ids: Sequence[int]):
        self._layout = _FrameLayout.of(tuple(ids))
        self._packets = members(ids)
        self._buffer = bytearray()
        self.skipped = 0

    def feed(self, data: bytes) -> list[dict[str, int]]:
        """Take the next bytes of the line; return the values of each completed frame, by name."""
        frames = []
        buffer = self._buffer
        buffer += data
        start = 0
        while start < len(buffer):
            frame = buffer[start : start + self._layout.size]
            fits = self._layout.fits(frame)
            if fits and len(frame) < self._layout.size:
                break
            values = self._values(frame) if fits else None
            if values is None:
                start += 1
                self.skipped += 1
            else:
                frames.append(values)
                start += len(frame)
        del buffer[:start]
        return frames

    def _values(self, frame: bytearray) -> dict[str, int] | None:
        if sum(frame) % 256 != 0:
            return None
        values = {}
        for packet, value in zip(self._packets, self._layout.values.unpack(frame), strict=True):
            if not packet.low <= value <= packet.high:
                return None
            values[packet.name] = value
        return values


@dataclass(frozen=True)
class Command:
    """A command as the robot receives it.

    Drive straight at 200 mm/s:

        >>> from jaxcell import robot
        >>> from jaxcell.robot.create.open_interface import drive
        >>> robot.CommandParser().feed(drive(200))[0].words
        (200, -32768)
    """

    opcode: int
    "The number of the command."
    data: bytes = b""
    "The data. For a song, a stream or a query list they begin with the bytes for the length."

    @property
    def words(self) -> tuple[int, ...]:
        """The data as signed 16-bit numbers, for the three drive commands."""
        return struct.unpack(f">{len(self.data) // 2}h", self.data)


class CommandParser:
    """Split the bytes that a robot receives into commands.

    Like a robot, it waits for missing data bytes, so that a truncated command takes the bytes of
    the next one. A byte that is not an opcode is skipped.

    A command that arrives in two pieces:

        >>> from jaxcell import robot
        >>> from jaxcell.robot.create.open_interface import drive
        >>> parser, data = robot.CommandParser(), drive(200)
        >>> parser.feed(data[:2]), [command.opcode for command in parser.feed(data[2:])]
        ([], [137])
    """

    def __init__(self) -> None:
        self._buffer = bytearray()

    def feed(self, data: bytes) -> list[Command]:
        """Take the next bytes of the line; return the commands that they complete."""
        commands = []
        buffer = self._buffer
        buffer += data
        while buffer:
            if (needed := _command_size(buffer)) == 0:
                del buffer[0]
            elif needed is None or len(buffer) < needed:
                break
            else:
                commands.append(Command(buffer[0], bytes(buffer[1:needed])))
                del buffer[:needed]
        return commands


def _command_size(buffer: bytearray) -> int | None:
    """Count the bytes of the first command in `buffer`: 0 for none, `None` if not yet known."""
    opcode = buffer[0]
    if opcode in _DATA_BYTES:
        return 1 + _DATA_BYTES[opcode]
    if opcode in (148, 149):
        return 2 + buffer[1] if len(buffer) > 1 else None
    if opcode == 140:
        return 3 + 2 * buffer[2] if len(buffer) > 2 else None
    return 0


@dataclass(frozen=True)
class _FrameLayout:
    """The positions of the values in a frame of the stream, and the fixed bytes."""

    empty: bytes
    "A frame with the fixed bytes, and 0 for values and checksum."
    known: bytes
    "A mask: 255 for each fixed byte, and 0 for values and checksum."
    values: struct.Struct
    "The format of the values, which skips the fixed bytes."

    @classmethod
    @functools.lru_cache
    def of(cls, ids: tuple[int, ...]) -> "_FrameLayout":
        members(ids)
        sizes = [size([id_]) for id_ in ids]
        length = sum(sizes) + len(ids)
        if not 0 < length <= 169:
            raise ValueError(
                f"ids = {list(ids)}: a frame of {length} bytes and 3 around them; "
                "expected at least one packet and at most 172 bytes in all"
            )
        body = b"".join(bytes([id_, *[0] * n]) for id_, n in zip(ids, sizes, strict=True))
        known = b"".join(bytes([255, *[0] * n]) for n in sizes)
        values = "".join(f"x{codes([id_])}" for id_ in ids)
        return cls(
            bytes([HEADER, length]) + body + bytes(1),
            bytes([255, 255]) + known + bytes(1),
            struct.Struct(f">2x{values}x"),
        )

    @property
    def size(self) -> int:
        return len(self.empty)

    def fits(self, frame: bytearray) -> bool:
        """Check whether bytes may be the beginning of a frame."""
        return bytes(map(operator.and_, frame, self.known)) == self.empty[: len(frame)]


def _check(name: str, value: int, largest: int) -> None:
    if not -largest <= value <= largest:
        raise ValueError(f"{name} = {value}: expected -{largest} to {largest}")
