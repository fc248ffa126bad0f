import math
import time
from collections.abc import Callable

from .driver import Driver
from .motion import Moved
from .packets import WHEEL_BASE


# The default speeds in metres and radians per second. They are so slow that the acceleration of the
# wheels has little effect, and the driver does not change them.
_SPEED = 0.18
_TURNING = 0.69


class ByClock:
    """A robot that measures distances and angles with a clock, at known speeds.

    The robots of Alam 2018 use only a bump sensor and a clock (sections 2.5 and 4.5.7). A clock is
    less accurate than encoders, because it measures neither the delays of commands and bumps on the
    line nor the acceleration of the wheels. The errors add up to a few centimetres over ten bumps
    in a map of a few metres.
    """

    def __init__(
        self,
        robot: Driver,
        *,
        speed: float = _SPEED,
        turning: float = _TURNING,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], object] = time.sleep,
        pause: float = 0.1,
    ) -> None:
        """**Arguments:**

        - `robot`: a robot such as a [`jaxcell.robot.Create`][], on which `arm` has been called.
        - `speed`, `turning`: the speeds of drives and turns, in metres and radians per second. They
            must be speeds that [`jaxcell.robot.Driver.drive`][] leaves unchanged.
        - `clock`, `sleep`: a function that returns the time in seconds, and one that waits for a
            number of seconds. For an emulated robot both must use the time of the emulator.
        - `pause`: the seconds for which the robot stands still after each motion.
        """
        for name, value, most in (("speed", speed, 0.5), ("turning", turning, 4.0)):
            if not 0 < value <= most:
                raise ValueError(f"{name}: expected more than 0 and at most {most}, got {value}")
        self._robot, self._speed, self._turning = robot, speed, turning
        self._clock, self._sleep, self._pause = clock, sleep, pause

    def forward(self, distance: float, *, tolerance: float) -> Moved:
        wheel = math.copysign(self._speed, distance)
        seconds, bumped = self._roll(abs(distance) / self._speed, wheel, wheel, distance > 0)
        return Moved(wheel * seconds, 0.0, bumped)

    def turn(self, angle: float, *, tolerance: float) -> Moved:
        rate = math.copysign(self._turning, angle)
        wheel = rate * WHEEL_BASE / 2
        seconds, _ = self._roll(abs(angle) / self._turning, wheel, -wheel, False)
        return Moved(0.0, rate * seconds, False)

    def _roll(
        self, seconds: float, right: float, left: float, stop_on_bump: bool
    ) -> tuple[float, bool]:
        """Turn the wheels for up to `seconds`; return the elapsed time, and true after a bump."""
        began = self._clock()
        free = True
        try:
            while free and (rest := began + seconds - self._clock()) > 0:
                free = self._robot.drive(right=right, left=left, stop_on_bump=stop_on_bump)
                # The time between two looks at the clock becomes shorter toward the end.
                self._sleep(min(max(rest / 2, 0.0001), 0.001))
        finally:
            took = self._clock() - began
            self._robot.stop()
        self._sleep(self._pause)
        return took, not free
