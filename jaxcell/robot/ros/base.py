import math
import time
from collections.abc import Callable
from typing import Any

from ...base.optional_modules import import_module
from ..create.motion import Moved, slowed
from .halt import speed_publisher, speed_type
from .node import Odometry, RosRobot, moved


# Largest and smallest speeds of a base, in metres and in radians per second.
_SPEED, _SLOWEST = 0.2, 0.03
_TURNING, _SLOWEST_TURN = 1.0, 0.15
# Rate at which a straight drive corrects its heading, 1/s, and its fastest turn, rad/s.
_STEERING, _MAX_STEERING = 2.0, 0.4


class Base(RosRobot):
    """A base that takes `cmd_vel` and publishes `odom` and a bumper.

    Speeds are sent as `geometry_msgs/Twist` or `TwistStamped`, whichever type the base subscribes
    to. The bumper is a `std_msgs/Bool` on `bumper`, published continuously, and true while the
    bumper is pressed. A short node can publish it from a contact sensor, or from a laser that sees
    a wall close ahead.

    [`jaxcell.robot.ros`][] describes what stops the base.
    """

    kind, contact = "base", "bumper"

    def _connect_speeds(self) -> str:
        with self._news:
            if not self._news.wait_for(lambda: speed_type(self.node) is not None, self.answer):
                topic = self.node.resolve_topic_name("cmd_vel")
                raise ConnectionError(f"nothing takes speeds on {topic}: is --remap right?")
        kind = super()._connect_speeds()
        self._roll = speed_publisher(self.node, kind)
        return kind

    def _connect(self) -> None:
        pressed = import_module("std_msgs.msg").Bool
        self.node.create_subscription(
            pressed, self.contact, lambda message: self._hear(pressed=message.data), self._sensors
        )

    def forward(self, distance: float, *, tolerance: float) -> Moved:
        """Drive straight, backward if negative; a press of the bumper stops a forward drive."""

        def rest(start: Odometry, now: Odometry) -> float:
            return distance - moved(start, now, False).distance

        def roll(left: float, turned: float) -> None:
            steer = min(max(-_STEERING * turned, -_MAX_STEERING), _MAX_STEERING)
            self._roll(slowed(left, _SPEED, _SLOWEST), steer)

        end = time.monotonic() + 2 * abs(distance) / _SPEED + 5
        what = f"forward {distance:.3g} m"
        return self._move(what, rest, roll, tolerance, end, stop_on_bump=distance > 0)

    def turn(self, angle: float, *, tolerance: float) -> Moved:
        """Turn in place, by radians counter-clockwise; a bump does not stop the turn."""

        def rest(start: Odometry, now: Odometry) -> float:
            return angle - (now.heading - start.heading)

        def roll(left: float, turned: float) -> None:
            self._roll(0.0, slowed(left, _TURNING, _SLOWEST_TURN))

        end = time.monotonic() + 2 * abs(angle) / _TURNING + 5
        what = f"turn {math.degrees(angle):.3g} degrees"
        return self._move(what, rest, roll, tolerance, end, stop_on_bump=False)

    def _move(
        self,
        what: str,
        rest: Callable[[Odometry, Odometry], float],
        roll: Callable[[float, float], Any],
        tolerance: float,
        end: float,
        *,
        stop_on_bump: bool,
    ) -> Moved:
        """Send a speed for each message of the odometry until the rest is within the tolerance."""
        start = now = self._begin()
        try:
            while True:
                bumped = stop_on_bump and self._bumped
                if bumped or abs(rest(start, now)) <= tolerance:
                    self._halt()
                    now = self._settle()
                    bumped = stop_on_bump and self._bumped
                    if bumped or abs(rest(start, now)) <= tolerance:
                        return moved(start, now, bumped)
                roll(rest(start, now), now.heading - start.heading)
                self._in_time(end, what)
                now = self._after(self._messages)
        finally:
            self._halt()

    def _halt(self) -> None:
        self._roll(0.0, 0.0)
