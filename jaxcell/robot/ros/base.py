import math
import time
from collections.abc import Callable
from typing import Literal

from ...base.optional_modules import import_module
from ..create.motion import Moved, slowed
from .halt import speed_publisher, speed_type
from .node import RosRobot, moved


# The largest and the smallest speed of a base, in metres and in radians per second.
_SPEED, _SLOWEST = 0.2, 0.03
_TURNING, _SLOWEST_TURN = 1.0, 0.15
# The rate per second at which a straight drive corrects its heading, and its fastest turn in rad/s.
_STEERING, _MAX_STEERING = 2.0, 0.4


class Base(RosRobot):
    """A mobile base that subscribes to `cmd_vel`, and publishes `odom` and `bumper`.

    Speeds are sent as `geometry_msgs/Twist` or as `TwistStamped`, depending on the subscription of
    the base. Messages on `bumper` are `std_msgs/Bool`, published continuously, and true while the
    bumper is pressed. A short node can publish them from a contact sensor, or from a laser that
    sees a wall close ahead.
    """

    kind, contact = "base", "bumper"

    def _connect_speeds(self) -> str:
        with self._news:
            if not self._news.wait_for(lambda: speed_type(self.node) is not None, self.answer):
                topic = self.node.resolve_topic_name("cmd_vel")
                raise ConnectionError(f"nothing subscribes to speeds on {topic}: is --remap right?")
        kind = super()._connect_speeds()
        self._roll = speed_publisher(self.node, kind)
        return kind

    def _connect(self) -> None:
        pressed = import_module("std_msgs.msg").Bool
        self.node.create_subscription(
            pressed, self.contact, lambda message: self._hear(pressed=message.data), self._sensors
        )

    def forward(self, distance: float, *, tolerance: float) -> Moved:
        def roll(rest: float, turned: float) -> None:
            steer = min(max(-_STEERING * turned, -_MAX_STEERING), _MAX_STEERING)
            self._roll(slowed(rest, _SPEED, _SLOWEST), steer)

        what = f"forward {distance:.3g} m"
        return self._move(what, "distance", distance, roll, tolerance, _SPEED)

    def turn(self, angle: float, *, tolerance: float) -> Moved:
        def roll(rest: float, turned: float) -> None:
            self._roll(0.0, slowed(rest, _TURNING, _SLOWEST_TURN))

        what = f"turn {math.degrees(angle):.3g} degrees"
        return self._move(what, "angle", angle, roll, tolerance, _TURNING)

    def _move(
        self,
        what: str,
        quantity: Literal["distance", "angle"],
        target: float,
        roll: Callable[[float, float], None],
        tolerance: float,
        speed: float,
    ) -> Moved:
        """Drive until `quantity` has changed by `target`; error messages call the motion `what`.

        At each odometry message, `roll` sends speeds that depend on the remaining change of the
        quantity and on the turn so far, in radians.
        """
        stop_on_bump = quantity == "distance" and target > 0
        end = time.monotonic() + 2 * abs(target) / speed + 5
        start = now = self._begin()

        def rest() -> float:
            return target - getattr(moved(start, now, False), quantity)

        try:
            while True:
                bumped = stop_on_bump and self._bumped
                if bumped or abs(rest()) <= tolerance:
                    self._halt()
                    now = self._settle()
                    bumped = stop_on_bump and self._bumped
                    if bumped or abs(rest()) <= tolerance:
                        return moved(start, now, bumped)
                roll(rest(), now.heading - start.heading)
                self._in_time(end, what)
                now = self._after(self._messages)
        finally:
            self._halt()

    def _halt(self) -> None:
        self._roll(0.0, 0.0)
