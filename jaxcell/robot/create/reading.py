"""The sensor packets that the driver requests, their readings, and the dangers that they show."""

import cmath
import math
from collections.abc import Mapping
from dataclasses import dataclass

from ...base.shown import Shown
from .packets import (
    METRES_PER_COUNT,
    WHEEL_BASE,
    WHEEL_OVERCURRENT,
    Contact,
    Mode,
    encoder_difference,
)


STREAM = (7, 9, 10, 11, 12, 14, 43, 44, 21, 22, 25, 26, 34, 35)
"""The numbers of the streamed packets. `StreamParser` explains why 35, the mode, is last."""

LOW_BATTERY = 0.1
"""The battery is low if its charge is below this fraction of its capacity."""

# The numbers of frames, one per 15 ms, after which a bump or a start cannot be the cause.
_STALL, _OVERCURRENT = 67, 20
# The encoder counts by which a blocked wheel may move, 2 mm.
_PLAY = 4


@dataclass(frozen=True)
class Reading(Shown):
    """The content of one frame of the stream, with distances in metres."""

    time: float
    "The time at which the frame was complete, in seconds on the clock of the driver."
    left: float
    "The distance that the left wheel has rolled since the driver connected, in metres."
    right: float
    "The distance that the right wheel has rolled since the driver connected, in metres."
    contact: Contact
    "The pressed bumpers, and the wheels that hang in the air."
    cliff: tuple[bool, bool, bool, bool]
    "True for each sensor that has no floor under it: left, front left, front right and right."
    overcurrent: bool
    "True if the motor of a wheel draws too much current."
    mode: Mode
    "The mode of the Open Interface."
    charger: bool
    "True if a charger is plugged in or the robot stands on its dock."
    charging_state: int
    "The charging state: 0 off, 1 reconditioning, 2 full charging, 3 trickle, 4 waiting, 5 fault."
    voltage: float
    "The voltage of the battery, in volts."
    charge: float
    "The charge of the battery, in ampere hours."
    capacity: float
    "The capacity of the battery, in ampere hours; 0 if the robot does not know it."
    encoders: tuple[int, int]
    "The counts of the left and the right encoder, from 0 to 65535."
    place: complex
    """The position of the centre of the body, in metres from its position when the driver
    connected. The real part is ahead, and the imaginary part to the left."""

    @classmethod
    def of(
        cls,
        values: Mapping[str, int],
        *,
        time: float,
        previous: "Reading | None",
        first_mode: int = 0,
    ) -> "Reading":
        """Create a reading; `values` maps the names of the packets in `STREAM` to their values.

        Distances are computed from the encoders, because the odometry of the robot (packets 19 and
        20) is wrong in most firmware. The encoders do not sense the direction in which a wheel
        turns, so the robot counts in the last commanded direction. If it is pushed by hand against
        this direction, the counts have the wrong sign. The robot must have moved less than 14 m
        since the reading `previous`. `first_mode` is the number that the robot reports for mode
        Off: 0, or 1 for robots that number their modes from 1.
        """
        encoders = values["left_encoder"], values["right_encoder"]
        left = right = 0.0
        place = 0j
        if previous is not None:
            rolled = [
                METRES_PER_COUNT * encoder_difference(before, now)
                for before, now in zip(previous.encoders, encoders, strict=True)
            ]
            left, right = previous.left + rolled[0], previous.right + rolled[1]
            turned = (rolled[1] - rolled[0]) / WHEEL_BASE
            # The length of the chord of the arc.
            way = sum(rolled) / 2 * (math.sin(turned / 2) / (turned / 2) if turned else 1.0)
            place = previous.place + cmath.rect(way, previous.heading + turned / 2)
        return cls(
            time=time,
            left=left,
            right=right,
            contact=Contact(values["contact"]),
            cliff=(
                bool(values["cliff_left"]),
                bool(values["cliff_front_left"]),
                bool(values["cliff_front_right"]),
                bool(values["cliff_right"]),
            ),
            overcurrent=bool(values["overcurrent"] & WHEEL_OVERCURRENT),
            mode=Mode(min(max(values["mode"] - first_mode, 0), 3)),
            charger=bool(values["charger"]),
            charging_state=values["charging_state"],
            voltage=values["voltage"] / 1000,
            charge=values["charge"] / 1000,
            capacity=values["capacity"] / 1000,
            encoders=encoders,
            place=place,
        )

    @property
    def distance(self) -> float:
        """The net distance driven forward since the driver connected, in metres."""
        return (self.left + self.right) / 2

    @property
    def heading(self) -> float:
        """The turn of the body since the driver connected, in radians, counter-clockwise."""
        return (self.right - self.left) / WHEEL_BASE

    @property
    def bump(self) -> bool:
        """True if a bumper is pressed."""
        return bool(self.contact & Contact.BUMP)

    @property
    def battery(self) -> float:
        """The charge as a fraction of the capacity; 1 if the capacity is unknown."""
        return self.charge / self.capacity if self.capacity > 0 else 1.0

    @property
    def danger(self) -> str | None:
        """The reason why the robot must not drive, or `None`."""
        if self.contact & Contact.WHEEL_DROP:
            return "a wheel hangs in the air"
        if any(self.cliff):
            return "there is a cliff"
        if self.charger:
            return "it is on the charger"
        if self.battery < LOW_BATTERY:
            return f"the battery is low ({self.battery:.0%})"
        return None


class Strain:
    """A detector of blocked wheels, updated with each frame of the stream.

    A wheel is blocked if it should turn but stands still for a second, or if its motor draws too
    much current for a third of a second. Shorter times are normal at a bump or a start.
    """

    def __init__(self) -> None:
        self._frames = [0, 0]
        self._counts: list[int | None] = [None, None]
        self._overcurrent = 0

    def observe(self, wheels: tuple[int, int], reading: Reading) -> str | None:
        """Update the detector with the next frame, and return the reason to stop, or `None`.

        `wheels` are the commanded speeds of the right and the left wheel, in mm/s.
        """
        self._overcurrent = self._overcurrent + 1 if reading.overcurrent and any(wheels) else 0
        if self._overcurrent >= _OVERCURRENT:
            return "a wheel is blocked: its motor draws too much current"
        left, right = reading.encoders
        for side, (name, count) in enumerate((("right", right), ("left", left))):
            before = self._counts[side]
            held = before is not None and abs(encoder_difference(before, count)) <= _PLAY
            if not (held and wheels[side]):
                self._frames[side], self._counts[side] = 0, count
                continue
            self._frames[side] += 1
            if self._frames[side] >= _STALL:
                return f"the {name} wheel is blocked: it does not turn"
        return None
