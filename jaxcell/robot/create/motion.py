"""Move a Create 2 or Roomba 600 by distances and angles."""

import cmath
import math
from collections.abc import Callable
from typing import NamedTuple

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
    "The distance of the centre of the body ahead of its start, in metres."
    angle: float
    "The turn of the body, in radians counter-clockwise."
    bumped: bool
    "True if a bump ended the motion."
    left: float = 0.0
    "The distance of the centre of the body to the left of its start, in metres."


class Create(Driver):
    """A robot on a serial line that moves by distances and angles, measured by its encoders.

    ```python
    with Create.open("/dev/ttyUSB0") as robot:
        robot.arm()
        robot.forward(0.5)
    ```

    [`jaxcell.robot.Driver`][] describes the constructor, and when the wheels stop.
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
        """Drive straight by metres, backward if negative. A bump ends a forward drive.

        The speed is in metres per second, at most 0.5, by default the speed of the robot. The
        tolerance is the largest error by the encoders, in metres. The default of the timeout is
        twice the expected time and 3 s.

        **Raises:** [`RobotStopped`][] if the robot is not armed, is stopped, or exceeds the
        timeout.
        """
        start = self.sensors()
        cruise = self.speed if speed is None else speed

        def wheels(rest: float, now: Reading) -> tuple[float, float]:
            velocity = slowed(rest, cruise, _SLOWEST)
            steer = _STEERING * (start.heading - now.heading) * WHEEL_BASE / 2
            steer = min(max(steer, -_MAX_STEERING), _MAX_STEERING)
            return velocity + steer, velocity - steer

        return self._move(
            f"forward {distance} m",
            lambda now: distance - (now.distance - start.distance),
            wheels,
            start=start,
            speed=cruise,
            most=MAX_SPEED / 1000,
            tolerance=tolerance,
            timeout=timeout,
            stop_on_bump=distance > 0,
        )

    def turn(
        self,
        angle: float,
        *,
        speed: float = 1.0,
        tolerance: float = math.radians(1),
        timeout: float | None = None,
    ) -> Moved:
        """Turn in place by radians, counter-clockwise.

        A bump does not end the turn, because the bumper may be pressed already. The speed is in
        radians per second, at most 4, and the tolerance in radians. The errors are those of
        `forward`.
        """
        start = self.sensors()

        def wheels(rest: float, now: Reading) -> tuple[float, float]:
            velocity = slowed(rest, speed, 2 * _SLOWEST / WHEEL_BASE) * WHEEL_BASE / 2
            return velocity, -velocity

        return self._move(
            f"turn {angle} rad",
            lambda now: angle - (now.heading - start.heading),
            wheels,
            start=start,
            speed=speed,
            most=4.0,
            tolerance=tolerance,
            timeout=timeout,
            stop_on_bump=False,
        )

    def _move(
        self,
        what: str,
        rest: Callable[[Reading], float],
        wheels: Callable[[float, Reading], tuple[float, float]],
        *,
        start: Reading,
        speed: float,
        most: float,
        tolerance: float,
        timeout: float | None,
        stop_on_bump: bool,
    ) -> Moved:
        """Drive until the `rest` of the motion is within the tolerance, and the wheels stand still.

        `wheels` computes the speeds of the right and the left wheel from the rest, in m/s.
        """
        whole = abs(rest(start))
        if not math.isfinite(whole):
            raise ValueError(f"{what}: expected a finite number")
        if not 0 < speed <= most:
            raise ValueError(f"{what}: speed = {speed}: expected more than 0 and at most {most}")
        if not tolerance > 0:
            raise ValueError(f"{what}: tolerance = {tolerance}: expected more than 0")
        if timeout is None:
            timeout = 2 * whole / speed + 3
        end = self._now() + timeout
        most_wheel = MAX_SPEED / 1000
        self.stop()
        try:
            now = start
            while True:
                there = abs(rest(now)) <= tolerance
                right, left = (0.0, 0.0) if there else wheels(rest(now), now)
                free = self.drive(
                    right=min(max(right, -most_wheel), most_wheel),
                    left=min(max(left, -most_wheel), most_wheel),
                    stop_on_bump=stop_on_bump,
                )
                if there or not free:
                    now = self._settle()
                    if self._bumped or abs(rest(now)) <= tolerance:
                        way = (now.place - start.place) * cmath.rect(1.0, -start.heading)
                        angle = now.heading - start.heading
                        return Moved(way.real, angle, self._bumped, way.imag)
                if self._now() > end:
                    raise RobotStopped(f"{what}: {rest(now):.3g} are left after {timeout:.3g} s")
                now = self._after(now, abs(rest(now)) / speed - _SLOWING)
        finally:
            self.stop()

    def _settle(self) -> Reading:
        """Wait until three consecutive readings have the same encoders, or for 30 readings."""
        now = self.sensors()
        same = 0
        for _ in range(30):
            before, now = now, self._after(now)
            same = same + 1 if before.encoders == now.encoders else 0
            if same == 2:
                break
        return now


def slowed(rest: float, speed: float, slowest: float) -> float:
    """Compute the velocity for the rest of a motion, between two speeds."""
    return math.copysign(min(max(abs(rest) / _SLOWING, slowest), speed), rest)
