"""The sensor packets of the Create 2 Open Interface: their names and their encoding."""

import enum
import functools
import math
import struct
from collections.abc import Iterable, Mapping
from dataclasses import dataclass


WHEEL_BASE = 0.235
"""The distance between the wheels, in metres."""

METRES_PER_COUNT = math.pi * 0.072 / 508.8
"""The distance in metres that a wheel with a diameter of 72 mm rolls per encoder count."""

WHEEL_OVERCURRENT = 0b11000
"""The bits of packet 14 (overcurrent) for the wheels; its other bits are for the brushes."""


class Mode(enum.IntEnum):
    """The modes of the Open Interface, as packet 35 numbers them."""

    OFF = 0
    PASSIVE = 1
    SAFE = 2
    FULL = 3


class Contact(enum.IntFlag):
    """The bits of packet 7: pressed bumpers, and dropped wheels, which hang in the air."""

    BUMP_RIGHT = 1
    BUMP_LEFT = 2
    WHEEL_DROP_RIGHT = 4
    WHEEL_DROP_LEFT = 8

    BUMP = BUMP_RIGHT | BUMP_LEFT
    WHEEL_DROP = WHEEL_DROP_RIGHT | WHEEL_DROP_LEFT


@dataclass(frozen=True)
class Packet:
    """A sensor packet: a big-endian integer of one or two bytes."""

    id: int
    "The number by which a host requests the packet."
    name: str
    "The name of the packet, which is the key of its value in a decoded frame."
    size: int
    "The number of bytes of the packet."
    low: int
    "The smallest valid value. If it is negative, the packet is in two's complement."
    high: int
    "The largest valid value."
    unit: str = ""
    "The unit of the value; empty for flags, states and raw signals."

    @property
    def code(self) -> str:
        """The format character of the packet for the module `struct`."""
        code = {1: "b", 2: "h"}[self.size]
        return code if self.low < 0 else code.upper()


_I16 = (2, -(2**15), 2**15 - 1)
_U16 = (2, 0, 2**16 - 1)
_U8 = (1, 0, 255)

_TABLE = (
    Packet(7, "contact", 1, 0, 15),
    Packet(8, "wall", 1, 0, 1),
    Packet(9, "cliff_left", 1, 0, 1),
    Packet(10, "cliff_front_left", 1, 0, 1),
    Packet(11, "cliff_front_right", 1, 0, 1),
    Packet(12, "cliff_right", 1, 0, 1),
    Packet(13, "virtual_wall", 1, 0, 1),
    Packet(14, "overcurrent", 1, 0, 31),
    Packet(15, "dirt", *_U8),
    Packet(16, "unused_16", *_U8),
    Packet(17, "infrared_omni", *_U8),
    Packet(18, "buttons", *_U8),
    # The odometry of the robot, which is wrong in most firmware; the encoders are 43 and 44.
    Packet(19, "distance", *_I16, "mm"),
    Packet(20, "angle", *_I16, "degree"),
    Packet(21, "charging_state", 1, 0, 5),
    Packet(22, "voltage", *_U16, "mV"),
    Packet(23, "current", *_I16, "mA"),
    Packet(24, "temperature", 1, -128, 127, "degree Celsius"),
    Packet(25, "charge", *_U16, "mAh"),
    Packet(26, "capacity", *_U16, "mAh"),
    Packet(27, "wall_signal", 2, 0, 1023),
    Packet(28, "cliff_left_signal", 2, 0, 4095),
    Packet(29, "cliff_front_left_signal", 2, 0, 4095),
    Packet(30, "cliff_front_right_signal", 2, 0, 4095),
    Packet(31, "cliff_right_signal", 2, 0, 4095),
    Packet(32, "unused_32", *_U8),
    Packet(33, "unused_33", *_U16),
    Packet(34, "charger", 1, 0, 3),
    # At most 3 in the specification. Some robots count from 1, so that 4 is Full.
    Packet(35, "mode", 1, 0, 4),
    Packet(36, "song", 1, 0, 15),
    Packet(37, "song_playing", 1, 0, 1),
    Packet(38, "stream_packets", 1, 0, 108),
    Packet(39, "requested_velocity", 2, -500, 500, "mm/s"),
    Packet(40, "requested_radius", *_I16, "mm"),
    Packet(41, "requested_right", 2, -500, 500, "mm/s"),
    Packet(42, "requested_left", 2, -500, 500, "mm/s"),
    Packet(43, "left_encoder", *_U16, "count"),
    Packet(44, "right_encoder", *_U16, "count"),
    Packet(45, "light_bumper", 1, 0, 127),
    Packet(46, "light_bump_left", 2, 0, 4095),
    Packet(47, "light_bump_front_left", 2, 0, 4095),
    Packet(48, "light_bump_centre_left", 2, 0, 4095),
    Packet(49, "light_bump_centre_right", 2, 0, 4095),
    Packet(50, "light_bump_front_right", 2, 0, 4095),
    Packet(51, "light_bump_right", 2, 0, 4095),
    Packet(52, "infrared_left", *_U8),
    Packet(53, "infrared_right", *_U8),
    Packet(54, "left_current", *_I16, "mA"),
    Packet(55, "right_current", *_I16, "mA"),
    Packet(56, "main_brush_current", *_I16, "mA"),
    Packet(57, "side_brush_current", *_I16, "mA"),
    Packet(58, "stasis", 1, 0, 3),
)

PACKETS: Mapping[int, Packet] = {packet.id: packet for packet in _TABLE}
"""The sensor packets by their numbers."""

GROUPS: Mapping[int, range] = {
    0: range(7, 27),
    1: range(7, 17),
    2: range(17, 21),
    3: range(21, 27),
    4: range(27, 35),
    5: range(35, 43),
    6: range(7, 43),
    100: range(7, 59),
    101: range(43, 59),
    106: range(46, 52),
    107: range(54, 59),
}
"""A dictionary from the number of each group to the numbers of its packets."""


@functools.lru_cache
def members(ids: tuple[int, ...]) -> tuple[Packet, ...]:
    """List the requested packets in order; `ids` are the numbers of packets and of groups."""
    packets: list[Packet] = []
    for index, id_ in enumerate(ids):
        if id_ not in PACKETS and id_ not in GROUPS:
            raise ValueError(
                f"ids[{index}] = {id_}: expected a packet (7 to 58) or a group {list(GROUPS)}"
            )
        packets.extend(PACKETS[member] for member in GROUPS.get(id_, (id_,)))
    return tuple(packets)


def layout(ids: Iterable[int]) -> struct.Struct:
    """Return the `struct` format of the values that a robot sends for packets and groups `ids`."""
    return struct.Struct(">" + "".join(packet.code for packet in members(tuple(ids))))


def encode(ids: Iterable[int], values: Mapping[str, int]) -> bytes:
    """Encode the values that the robot sends for the packets and groups `ids`.

    `values` maps the names of packets to their values; values of other packets are ignored.

    **Raises:** `ValueError` for an unknown number, a missing value, or a value out of range.
    """
    ids = tuple(ids)
    return layout(ids).pack(*requested_values(ids, values))


def requested_values(ids: Iterable[int], values: Mapping[str, int]) -> list[int]:
    """List the values of the packets in order. Raises `ValueError` for a missing or wrong value."""
    numbers = []
    for packet in members(tuple(ids)):
        if packet.name not in values:
            raise ValueError(f"values: packet {packet.id} needs {packet.name!r}, which is missing")
        value = int(values[packet.name])
        if not packet.low <= value <= packet.high:
            raise ValueError(
                f"{packet.name} = {value}: packet {packet.id} holds {packet.low} to {packet.high}"
            )
        numbers.append(value)
    return numbers


def encoder_difference(before: int, after: int) -> int:
    """Compute `after - before` for two encoder counts, which wrap at 16 bits.

    The difference is signed, and correct for motions of less than 2**15 counts (14 m).
    """
    return (after - before + 2**15) % 2**16 - 2**15
