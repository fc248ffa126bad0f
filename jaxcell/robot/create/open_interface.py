"""The commands of the Create 2 Open Interface, and the frames of its sensor stream, as bytes.

This module encodes and decodes for both sides, the host and the robot, so that an emulator can use
it. It does not access a serial line. Source: *iRobot Create 2 Open Interface*, 2016.
"""

import functools
import operator
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ...base.shown import Shown
from .packets import layout, members, requested_values


BAUD = 115200
"""The baud rate of a Create 2 or Roomba 600, whose line has 8N1 framing and no flow control."""

STREAM_PERIOD = 0.015
"""The period of the frames in seconds. The robot reads its sensors once per period."""

MAX_SPEED = 500
"""The largest speed of a wheel, in mm/s."""

HEADER = 19
"""The first byte of a frame of the stream."""

RESET = bytes([7])
"""The command that reboots the robot. It prints its firmware version, and is then in mode Off."""

START = bytes([128])
"""The command that opens the interface, and switches from any mode to Passive."""

SAFE = bytes([131])
"""The command that switches to Safe mode."""

STOP = bytes([173])
"""The command that closes the interface, switches to mode Off, and ends the stream."""

# The bytes of data after each opcode. Opcodes with a variable length are in `_command_size`.
_DATA_BYTES = {
    **dict.fromkeys((7, 128, 130, 131, 132, 133, 134, 135, 136, 143, 173), 0),
    **dict.fromkeys((129, 138, 141, 142, 150, 165), 1),
    162: 2,
    **dict.fromkeys((139, 144, 168), 3),
    **dict.fromkeys((137, 145, 146, 163, 164), 4),
    167: 15,
}


def drive_direct(*, right: int, left: int) -> bytes:
    """Encode the command that sets the speed of each wheel, from -500 to 500 mm/s."""
    for name, speed in (("right", right), ("left", left)):
        if not -MAX_SPEED <= speed <= MAX_SPEED:
            raise ValueError(f"{name} = {speed}: expected -{MAX_SPEED} to {MAX_SPEED}")
    return struct.pack(">Bhh", 145, right, left)


def wheel_speeds(*, right: float, left: float) -> tuple[int, int]:
    """Convert speeds in m/s, from -0.5 to 0.5, to speeds in mm/s that are safe to send.

    If the line loses the opcode of a drive command, the robot reads speeds as commands, and might
    clean, dock, switch off or reset. Therefore, if a byte of a pair of speeds is an opcode, the
    pair is replaced by the next slower pair on the same arc. A straight drive remains straight, and
    a turn on the spot stays on the spot. On other arcs, rounding to mm/s slightly changes the
    radius.
    """
    return _pair(_millimetres("right", right), _millimetres("left", left))


@functools.lru_cache(1024)
def _pair(right: int, left: int) -> tuple[int, int]:
    fastest = max(abs(right), abs(left))
    for most in range(fastest, 0, -1):
        pair = round(right * most / fastest), round(left * most / fastest)
        if all(map(_harmless, pair)):
            return pair
    return 0, 0


def _millimetres(name: str, speed: float) -> int:
    if not abs(speed) <= MAX_SPEED / 1000:
        raise ValueError(f"{name} = {speed}: expected -0.5 to 0.5 m/s")
    return round(1000 * speed)


def _harmless(speed: int) -> bool:
    """Check that the low byte of a speed is not an opcode. The high byte is never an opcode."""
    low = speed & 0xFF
    return low != RESET[0] and not START[0] <= low <= STOP[0]


def stream(ids: Sequence[int]) -> bytes:
    """Encode the command that requests a frame with the packets `ids` every 15 ms.

    **Raises:** `ValueError` for an unknown packet, an empty list, or a frame of more than 172
    bytes, which the line cannot carry in 15 ms.
    """
    _FrameLayout.of(tuple(ids))
    return bytes([148, len(ids), *ids])


def stream_frame(ids: Sequence[int], values: Mapping[str, int]) -> bytes:
    """Encode the frame with the packets `ids`; `values` maps the names of packets to numbers."""
    layout = _FrameLayout.of(tuple(ids))
    known, free = layout.empty, layout.values.pack(*requested_values(ids, values))
    frame = bytes(map(operator.or_, known, free))
    return frame[:-1] + bytes([-sum(frame) % 256])


class StreamParser:
    """A parser of the stream of frames, which arrives in pieces and may be damaged.

    `ids` are the numbers of packets and groups, as for `stream`. A frame is accepted if its header,
    its length, its packet numbers in the order of the request, and its checksum are right, and if
    all values are within the ranges of their packets. Otherwise the search continues at the next
    byte. No input raises an exception.

    The protection depends on the packets. For `jaxcell.robot.STREAM`, if a single byte of three
    consecutive frames is changed, lost or doubled, at most two of these frames are lost, and only
    values that the robot sent are returned. There are two reasons. If a frame is read from a wrong
    position, at least two fixed bytes disagree. And the last value never equals the header; if it
    did and were lost, the checksum would be read as the value, and the next header as the checksum.
    Greater damage may remain unnoticed, because an eight-bit checksum accepts one in 256 damaged
    frames whose length and packet numbers are right.

    One byte of noise, and a frame with the counts of the encoders:

        >>> from jaxcell import robot
        >>> from jaxcell.robot.create.open_interface import stream_frame
        >>> frame = stream_frame([43, 44], {"left_encoder": 7, "right_encoder": 9})
        >>> parser = robot.StreamParser([43, 44])
        >>> parser.feed(bytes([5]) + frame), parser.skipped
        ([{'left_encoder': 7, 'right_encoder': 9}], 1)
    """

    skipped: int
    "The number of bytes so far that were not part of an accepted frame."

    def __init__(self, ids: Sequence[int]):
        self._layout = _FrameLayout.of(tuple(ids))
        self._packets = members(tuple(ids))
        self._buffer = bytearray()
        self.skipped = 0

    def feed(self, data: bytes) -> list[dict[str, int]]:
        """Parse the next bytes from the line, and return the values of each completed frame."""
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
class Command(Shown):
    """A command as the robot receives it."""

    opcode: int
    "The number of the command."
    data: bytes = b""
    "The bytes after the opcode, including the length byte of a song, a stream or a query list."

    @property
    def words(self) -> tuple[int, ...]:
        """The data of a drive command as signed 16-bit numbers."""
        return struct.unpack(f">{len(self.data) // 2}h", self.data)


class CommandParser:
    """A parser of the commands that a robot receives.

    Like the robot, it waits for missing bytes of data, so a truncated command consumes the first
    bytes of the next command. A byte that is not an opcode is skipped.
    """

    def __init__(self) -> None:
        self._buffer = bytearray()

    def feed(self, data: bytes) -> list[Command]:
        """Parse the next bytes from the line, and return the completed commands."""
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
    """Count the bytes of the command at the beginning of a buffer.

    Returns 0 if the first byte is not an opcode, and `None` if the length has not arrived yet.
    """
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
    """The fixed bytes of a frame of the stream, and the positions of the values."""

    empty: bytes
    "A frame with the fixed bytes, and 0 for the values and the checksum."
    mask: bytes
    "A mask with 255 for each fixed byte, and 0 for the values and the checksum."
    values: struct.Struct
    "The format that unpacks the values and skips the fixed bytes."

    @classmethod
    @functools.lru_cache
    def of(cls, ids: tuple[int, ...]) -> "_FrameLayout":
        members(ids)
        layouts = [layout([id_]) for id_ in ids]
        sizes = [each.size for each in layouts]
        length = sum(sizes) + len(ids)
        if not 0 < length <= 169:
            raise ValueError(
                f"ids = {list(ids)}: a frame of {length} bytes and 3 around them; "
                "expected at least one packet and at most 172 bytes in all"
            )
        body = b"".join(bytes([id_, *[0] * n]) for id_, n in zip(ids, sizes, strict=True))
        mask = b"".join(bytes([255, *[0] * n]) for n in sizes)
        values = "".join(f"x{each.format[1:]}" for each in layouts)
        return cls(
            bytes([HEADER, length]) + body + bytes(1),
            bytes([255, 255]) + mask + bytes(1),
            struct.Struct(f">2x{values}x"),
        )

    @property
    def size(self) -> int:
        return len(self.empty)

    def fits(self, frame: bytearray) -> bool:
        """Check whether a frame, whose end may be missing, has the right fixed bytes."""
        return bytes(map(operator.and_, frame, self.mask)) == self.empty[: len(frame)]
