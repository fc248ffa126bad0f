import math

from ..create.motion import Moved
from ..create.packets import WHEEL_BASE
from .body import Body


# The metres and radians between two readings of the bumper.
_TICK, _TURN = 0.05, math.radians(15)


class DirectBody:
    """An emulated robot that a walker moves directly, without a driver and its serial commands.

    It is faster than [`SimulatedCreate`][jaxcell.robot.emulation.simulated.SimulatedCreate], and
    its encoders measure distances without rounding them to counts.
    """

    def __init__(self, body: Body) -> None:
        self.body = body

    def forward(self, distance: float, *, tolerance: float) -> Moved:
        ticks = max(1, math.ceil(abs(distance) / _TICK))
        before = self.body.travelled.copy()
        bumped = False
        for _ in range(ticks):
            self.body.advance(distance / ticks, distance / ticks, 1.0)
            if distance > 0 and (self.body.bump_left or self.body.bump_right):
                bumped = True
                break
        return Moved(float((self.body.travelled - before).mean()), 0.0, bumped)

    def turn(self, angle: float, *, tolerance: float) -> Moved:
        ticks = max(1, math.ceil(abs(angle) / _TURN))
        wheel = angle / ticks * WHEEL_BASE / 2
        for _ in range(ticks):
            self.body.advance(-wheel, wheel, 1.0)
        # A tick without motion separates this turn from the next one.
        self.body.advance(0.0, 0.0, 1.0)
        return Moved(0.0, angle, False)
