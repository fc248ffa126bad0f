"""Move a Create 2 or Roomba 600 by given distances and angles."""

import cmath
import math
from collections.abc import Callable
from typing import NamedTuple

from .driver import Driver, RobotStopped
from .open_interface import MAX_SPEED
from .packets import WHEEL_BASE
from .reading import Reading


# Motions slow down in proportion to what is left, seconds, to a wheel speed that the motors still
# hold, m/s. A robot going straight steers back at this rate, 1/s, by at most this wheel speed.
_SLOWING = 0.25
_SLOWEST = 0.03
_STEERING = 2.0
_MAX_STEERING = 0.05


class Moved(NamedTuple):
    """The distance and turn of a motion, and whether a bump ended it."""

    distance: float
    "Distance of the body's centre ahead of its start by the encoders, in metres."
    angle: float
    "Turn of the body by the encoders, in radians counterclockwise."
    bumped: bool
    "True if a bumper ended the motion."
    left: float = 0.0
    "Distance of the body's centre to the left of its start and heading then, in metres."


class Create(Driver):
    """A robot on a serial line that moves by distances and angles, by its encoders.

    ```python
    with Create.open("/dev/ttyUSB0") as robot:
        robot.arm()
        robot.forward(0.5)
    ```

    [`jaxcell.robot.Driver`][] has the constructor, and describes when and why the wheels stop.
    """

    speed: float = 0.2
    "Default speed of `forward`, in metres per second, up to 0.5."

    def forward(
        self,
        distance: float,
        *,
        speed: float | None = None,
        tolerance: float = 0.005,
        timeout: float | None = None,
    ) -> Moved:
        """Drive straight by metres, backward if negative, or up to the first bump.

        The speed is in metres per second, up to 0.5; by default that of the robot. The tolerance is
        the largest error by the encoders, in metres. The default of the timeout is twice the
        expected time and 3 s.

        **Raises:** [`RobotStopped`][] if the robot is not armed, is stopped on its way, or exceeds
        the timeout.
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
        """Turn on the spot. A bump does not stop the turn, because a bumper may be pressed already.

        `angle` is in radians counterclockwise, of which `2 * math.pi` are a whole turn, `speed` in
        radians per second, up to 4, and `tolerance` in radians.

        **Raises:** as `forward`.
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
        """Drive until `rest` of a reading is within the tolerance, and the wheels are still."""
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
        """Wait for three readings in a row with the same encoders, or for 30."""
        now = self.sensors()
        same = 0
        for _ in range(30):
            before, now = now, self._after(now)
            same = same + 1 if before.encoders == now.encoders else 0
            if same == 2:
                break
        return now


def slowed(rest: float, speed: float, slowest: float) -> float:
    """Compute the velocity in proportion to the remaining distance, between two speeds."""
    return math.copysign(min(max(abs(rest) / _SLOWING, slowest), speed), rest)
