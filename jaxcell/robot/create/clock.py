import math
import time
from collections.abc import Callable
from typing import Protocol, runtime_checkable

from .motion import Moved
from .packets import WHEEL_BASE


# Robots gain and lose speed at once as far as a clock can show, if they are slow; and these are
# speeds that the driver does not change.
_SPEED = 0.18
_TURNING = 0.69


@runtime_checkable
class Wheeled(Protocol):
    """A robot for [`ByClock`][], such as a [`jaxcell.robot.Create`][]."""

    def drive(self, *, right: float, left: float, stop_on_bump: bool = False) -> bool:
        """Set the speeds of the wheels; return false if a bump has stopped them."""

    def stop(self) -> None:
        """Stop the wheels."""


class ByClock:
    """Move a robot by driving at a known speed for a known time.

    A bump sensor and a clock are all that the robots of Alam 2018 use (sections 2.5 and 4.5.7).
    What comes out is less than by the encoders: the time that a command and a bump take on the
    line, and that the wheels take to gain speed, is not seen. So errors add up, in a map of metres
    some centimetres for ten bumps.
    """

    def __init__(
        self,
        robot: Wheeled,
        *,
        speed: float = _SPEED,
        turning: float = _TURNING,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], object] = time.sleep,
        pause: float = 0.1,
    ) -> None:
        """Take an armed robot, e.g. [`jaxcell.robot.Create`][], and its clock if it is emulated.

        The speeds are in metres and radians per second, such that [`jaxcell.robot.Driver.drive`][]
        does not change those of the wheels. After each motion the robot stands still for a pause,
        in seconds.

        **Raises:** `ValueError` for a speed that is not positive or that no wheel has.
        """
        for name, value, most in (("speed", speed, 0.5), ("turning", turning, 4.0)):
            if not 0 < value <= most:
                raise ValueError(f"{name}: expected more than 0 and at most {most}, got {value}")
        self._robot, self._speed, self._turning = robot, speed, turning
        self._clock, self._sleep, self._pause = clock, sleep, pause

    def forward(self, distance: float, *, tolerance: float) -> Moved:
        """Go straight, back if negative; forward it stops when the bumper is pressed."""
        wheel = math.copysign(self._speed, distance)
        seconds, bumped = self._for(abs(distance) / self._speed, wheel, wheel, distance > 0)
        return Moved(wheel * seconds, 0.0, bumped)

    def turn(self, angle: float, *, tolerance: float) -> Moved:
        """Turn in place, by radians counter-clockwise."""
        rate = math.copysign(self._turning, angle)
        wheel = rate * WHEEL_BASE / 2
        seconds, _ = self._for(abs(angle) / self._turning, wheel, -wheel, False)
        return Moved(0.0, rate * seconds, False)

    def _for(
        self, seconds: float, right: float, left: float, stop_on_bump: bool
    ) -> tuple[float, bool]:
        """Turn the wheels for a time; return the time, and whether a bump ended it."""
        began = self._clock()
        free = True
        try:
            while free and (rest := began + seconds - self._clock()) > 0:
                free = self._robot.drive(right=right, left=left, stop_on_bump=stop_on_bump)
                # Short of the end it is enough to look again now and then; there it is not.
                self._sleep(min(max(rest / 2, 0.0001), 0.001))
        finally:
            took = self._clock() - began
            self._robot.stop()
        self._sleep(self._pause)
        return took, not free
