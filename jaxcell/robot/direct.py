import math

from .body import Body
from .create import Moved
from .driver import RobotStopped
from .packets import WHEEL_BASE


# Of a tick, in metres that a wheel rolls. The wheels stop without slowing down, so that it need not
# be shorter towards the end.
_TICK = 0.02
_SPEED = 0.2


class DirectRobot:
    """Drives a [`Body`][jaxcell.robot.body.Body] without a serial line and without a clock.

    What [`jaxcell.robot.walker.Walker`][] needs of a robot, hundreds of times as fast as the
    emulator: for experiments with thousands of runs. The encoders are read without rounding, and
    nothing is late.
    """

    def __init__(self, body: Body) -> None:
        self.body = body

    def forward(self, distance: float, *, tolerance: float) -> Moved:
        """Goes straight; see [`jaxcell.robot.walker.Drivable`][].

        **Raises:** [`jaxcell.robot.RobotStopped`][] if it backs into a wall.
        """
        start = self._sensed()
        bumped = distance > 0 and self._bumped
        while not bumped and abs(rest := distance - self._sensed()[0] + start[0]) > tolerance:
            before = self._sensed()
            self._roll(rest, rest)
            bumped = distance > 0 and self._bumped
            if not bumped and self._sensed() == before:
                raise RobotStopped(f"forward {distance} m: {rest:.3g} are left, and it stands")
        return self._stop(start, bumped)

    def turn(self, angle: float, *, tolerance: float) -> Moved:
        """Turns in place; see [`jaxcell.robot.walker.Drivable`][]."""
        start = self._sensed()
        while abs(rest := angle - self._sensed()[1] + start[1]) > tolerance:
            self._roll(-rest * WHEEL_BASE / 2, rest * WHEEL_BASE / 2)
        return self._stop(start, False)

    @property
    def _bumped(self) -> bool:
        return self.body.bump_left or self.body.bump_right

    def _roll(self, left: float, right: float) -> None:
        """Rolls the wheels so far, or a tick of it."""
        share = min(1.0, _TICK / abs(left))
        seconds = share * abs(left) / _SPEED
        self.body.advance(math.copysign(_SPEED, left), math.copysign(_SPEED, right), seconds)

    def _stop(self, start: tuple[float, float], bumped: bool) -> Moved:
        # Each motion slips in its own way.
        self.body.advance(0.0, 0.0, 0.0)
        distance, angle = self._sensed()
        return Moved(distance - start[0], angle - start[1], bumped)

    def _sensed(self) -> tuple[float, float]:
        left, right = self.body.travelled.tolist()
        return (left + right) / 2, (right - left) / WHEEL_BASE
