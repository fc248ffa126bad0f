"""Move a Create 2 or Roomba 600 by distances and angles."""

import cmath
import math
from collections.abc import Callable
from typing import Literal, NamedTuple

from .driver import Driver, RobotStopped
from .open_interface import MAX_SPEED
from .packets import WHEEL_BASE
from .reading import Reading


# Motions slow down to a speed that would finish them in this number of seconds, but not below the
# least wheel speed of the motors, in m/s.
_SLOWING, _SLOWEST = 0.25, 0.03
# The rate per second at which a straight drive corrects its heading, by at most this wheel speed in
# m/s.
_STEERING, _MAX_STEERING = 2.0, 0.05


class Moved(NamedTuple):
    """The measured result of a motion."""

    distance: float
    "The displacement of the centre of the body along the heading at the start, in metres."
    angle: float
    "The turn of the body, in radians counter-clockwise."
    bumped: bool
    "True if a bump ended the motion."
    left: float = 0.0
    "The displacement of the centre of the body to the left of the heading at the start, in metres."


class Create(Driver):
    """A robot on a serial line that moves by distances and angles, measured by its encoders.

    ```python
    with Create.open("/dev/ttyUSB0") as robot:
        robot.arm()
        robot.forward(0.5)
    ```

    [`jaxcell.robot.Driver`][] describes the constructor, and the events that stop the wheels.
    """

    speed: float = 0.2
    "The default speed of `forward`, in metres per second, at most 0.5."

    def forward(
        self,
        distance: float,
        *,
        speed: float | None = None,
        tolerance: float = 0.005,
        timeout: float | None = None,
    ) -> Moved:
        """Drive straight by a distance in metres, backward if negative. A bump ends the drive.

        `speed` is in metres per second, at most 0.5, by default the speed of the robot. The drive
        ends within `tolerance` metres of its target, according to the encoders. The default
        `timeout` is twice the expected duration plus 3 s.

        **Raises:** [`RobotStopped`][] if the robot is not armed, is stopped, or needs more than
        `timeout` seconds.
        """
        cruise = self.speed if speed is None else speed

        def wheels(rest: float, turned: float) -> tuple[float, float]:
            velocity = slowed(rest, cruise, _SLOWEST)
            steer = -_STEERING * turned * WHEEL_BASE / 2
            steer = min(max(steer, -_MAX_STEERING), _MAX_STEERING)
            return velocity + steer, velocity - steer

        what = f"forward {distance} m"
        most = MAX_SPEED / 1000
        return self._move(what, "distance", distance, wheels, cruise, most, tolerance, timeout)

    def turn(
        self,
        angle: float,
        *,
        speed: float = 1.0,
        tolerance: float = math.radians(1),
        timeout: float | None = None,
    ) -> Moved:
        """Turn in place by an angle in radians, counter-clockwise.

        A bump does not end the turn, because the bumper may be pressed already. `speed` is in
        radians per second, at most 4, and `tolerance` in radians. Raises the same errors as
        `forward`.
        """

        def wheels(rest: float, turned: float) -> tuple[float, float]:
            velocity = slowed(rest, speed, 2 * _SLOWEST / WHEEL_BASE) * WHEEL_BASE / 2
            return velocity, -velocity

        what = f"turn {angle} rad"
        return self._move(what, "heading", angle, wheels, speed, 4.0, tolerance, timeout)

    def _move(
        self,
        what: str,
        quantity: Literal["distance", "heading"],
        target: float,
        wheels: Callable[[float, float], tuple[float, float]],
        speed: float,
        most: float,
        tolerance: float,
        timeout: float | None,
    ) -> Moved:
        """Drive until `quantity` of the readings has changed by `target` and the robot is at rest.

        `wheels` computes the speeds of the right and the left wheel in m/s, from the remaining
        change of the quantity and the turn so far in radians. `what` names the motion in error
        messages, and `most` is the largest allowed `speed`.
        """
        start = now = self.sensors()
        stop_on_bump = quantity == "distance" and target > 0

        def rest() -> float:
            return target - (getattr(now, quantity) - getattr(start, quantity))

        if not math.isfinite(target):
            raise ValueError(f"{what}: expected a finite number")
        if not 0 < speed <= most:
            raise ValueError(f"{what}: speed = {speed}: expected more than 0 and at most {most}")
        if not tolerance > 0:
            raise ValueError(f"{what}: tolerance = {tolerance}: expected more than 0")
        if timeout is None:
            timeout = 2 * abs(target) / speed + 3
        end = self._now() + timeout
        most_wheel = MAX_SPEED / 1000
        self.stop()
        try:
            while True:
                there = abs(rest()) <= tolerance
                turned = now.heading - start.heading
                right, left = (0.0, 0.0) if there else wheels(rest(), turned)
                free = self.drive(
                    right=min(max(right, -most_wheel), most_wheel),
                    left=min(max(left, -most_wheel), most_wheel),
                    stop_on_bump=stop_on_bump,
                )
                if there or not free:
                    now = self._settle()
                    if self._bumped or abs(rest()) <= tolerance:
                        way = (now.place - start.place) * cmath.rect(1.0, -start.heading)
                        turned = now.heading - start.heading
                        return Moved(way.real, turned, self._bumped, way.imag)
                if self._now() > end:
                    raise RobotStopped(f"{what}: {rest():.3g} are left after {timeout:.3g} s")
                now = self._after(now)
        finally:
            self.stop()

    def _settle(self) -> Reading:
        """Wait until three consecutive readings have equal encoder counts, or for 30 readings."""
        now = self.sensors()
        same = 0
        for _ in range(30):
            before, now = now, self._after(now)
            same = same + 1 if before.encoders == now.encoders else 0
            if same == 2:
                break
        return now


def slowed(rest: float, speed: float, slowest: float) -> float:
    """Compute the speed, with the sign of `rest`, of a motion that has `rest` (m or rad) to go.

    The magnitude is `speed` at first, and decreases to `slowest` near the end.
    """
    return math.copysign(min(max(abs(rest) / _SLOWING, slowest), speed), rest)
