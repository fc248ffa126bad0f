import abc
import cmath
import contextlib
import math
import os
import sys
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any, ClassVar, NamedTuple, TypeVar

from ...base.optional_modules import import_module
from ...base.process import end_by_signals, leave_signals
from ..create.driver import TICK, RobotStopped
from ..create.motion import Moved
from ..create.reading import LOW_BATTERY
from ..create.watchdog import Watchdog
from ..walker import Drivable
from .halt import speed_type


_R = TypeVar("_R", bound="RosRobot")

# The seconds without a message of the driver until the watchdog stops the robot.
_SILENCE = 2.0
# The constant of `sensor_msgs/BatteryState` for charging.
_CHARGING = 1
# The largest motion of a standing robot between two messages, in metres and radians.
_STILL, _STILL_TURN = 5e-4, 1e-3


class Odometry(NamedTuple):
    """The pose in an odometry message."""

    place: complex
    "The position in metres, with x as the real part and y as the imaginary part."
    heading: float
    "The heading in radians, counter-clockwise, not wrapped."


class RosRobot(Drivable, abc.ABC):
    """A robot on ROS 2 that a [`jaxcell.robot.Walker`][] drives by the odometry of the robot.

    A robot is a context manager. Within its block, the node `jaxcell` receives messages in a
    thread, and the robot can drive after `arm`. The wheels stop at the end of the block, even if
    SIGINT, SIGTERM or SIGHUP ends it. They also stop at the events that [`jaxcell.robot.ros`][]
    describes. Then motions raise [`jaxcell.robot.RobotStopped`][] until the robot is armed again.
    """

    kind: ClassVar[str]
    "The kind of the robot (`create3` or `base`), which tells the watchdog how to stop it."
    contact: ClassVar[str]
    "The topic of the bumper."
    greeting: float = 10.0
    "The seconds to wait for the first odometry message."
    answer: float = 5.0
    "The seconds to wait for the first bumper message, and for the robot's subscription to speeds."

    def __init__(self, *, remap: Sequence[str] = (), patience: float = 1.0) -> None:
        """**Arguments:**

        - `remap`: ROS rules that rename topics, such as `__ns:=/robot1` or
            `cmd_vel:=/base/cmd_vel`.
        - `patience`: the longest silence of the odometry and the bumper, in seconds.
        """
        self._remap, self._patience = remap, patience
        self._news = threading.Condition(threading.RLock())
        self._odometry: Odometry | None = None
        # The times of the last messages of the odometry and the bumper, by topic.
        self._heard = dict.fromkeys(("odom", self.contact), -math.inf)
        self._messages = 0
        self._pressed = self._bumped = False
        # The danger that each sensor reports, or `None`.
        self._dangers: dict[str, str | None] = {}
        self._reason: str | None = "it is not armed"
        self._failure: BaseException | None = None
        self._stack = contextlib.ExitStack()

    def __enter__(self: _R) -> _R:
        with self._stack:
            self._open()
            self._stack = self._stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._reason = "it is closed"
        self._stack.close()

    def _open(self) -> None:
        rclpy = import_module("rclpy")
        executors, quality = import_module("rclpy.executors"), import_module("rclpy.qos")
        words = ["--ros-args", *(word for rule in self._remap for word in ("-r", rule))]
        # The signal handlers of rclpy would leave the wheels turning.
        handlers = import_module("rclpy.signals").SignalHandlerOptions.NO
        self._stack.callback(leave_signals, end_by_signals())
        rclpy.init(args=words, signal_handler_options=handlers)
        self._stack.callback(rclpy.shutdown)
        self.node = rclpy.create_node("jaxcell")
        self._stack.callback(self.node.destroy_node)
        self._sensors = quality.qos_profile_sensor_data
        message = import_module("nav_msgs.msg").Odometry
        self.node.create_subscription(message, "odom", self._hear_odometry, self._sensors)
        battery = import_module("sensor_msgs.msg").BatteryState
        self.node.create_subscription(battery, "battery_state", self._hear_battery, self._sensors)
        self._connect()
        executor = executors.SingleThreadedExecutor()
        executor.add_node(self.node)
        thread = threading.Thread(target=self._spin, args=(executor,), daemon=True)
        thread.start()
        self._stack.callback(thread.join, 5.0)
        self._stack.callback(executor.shutdown)
        with self._news:
            if not self._news.wait_for(lambda: self._odometry is not None, self.greeting):
                raise ConnectionError(
                    f"no odometry comes on {self.node.resolve_topic_name('odom')}: is the robot "
                    f"on, and in ROS_DOMAIN_ID {os.environ.get('ROS_DOMAIN_ID', '0')}?"
                )
        own = [self.kind, str(_SILENCE), self._connect_speeds()]
        watchdog = Watchdog([sys.executable, "-m", f"{__package__}.watchdog", *own, *words])
        self._stack.callback(watchdog.dismiss)
        beating = threading.Event()
        beats = threading.Thread(target=self._tick, args=(watchdog, beating), daemon=True)
        beats.start()
        self._stack.callback(beats.join)
        self._stack.callback(beating.set)
        self._stack.callback(self._stop_at_end)

    @abc.abstractmethod
    def _connect(self) -> None:
        """Create the publishers and subscriptions that only this kind of robot has."""

    def _connect_speeds(self) -> str:
        """Prepare to send speeds, and return their message type, `Twist` or `TwistStamped`."""
        return speed_type(self.node) or "Twist"

    @abc.abstractmethod
    def _halt(self) -> None: ...

    def _stop_at_end(self) -> None:
        self._halt()

    def arm(self) -> None:
        """Allow the robot to drive.

        **Raises:** [`jaxcell.robot.RobotStopped`][] if the robot is in danger, its bumper does not
        report, or a Create 3 does not offer its actions.
        """
        with self._news:
            heard = self._news.wait_for(lambda: self._heard[self.contact] > -math.inf, self.answer)
            if not heard:
                raise RobotStopped(
                    f"nothing comes on {self.node.resolve_topic_name(self.contact)}, so it would "
                    "not feel a wall: is --remap right?"
                )
            self._reason = next(filter(None, self._dangers.values()), None)
            self._check()

    def _check(self) -> None:
        """Raise `RobotStopped` if the robot must not drive, or the error that ended the thread."""
        if self._failure is not None:
            raise self._failure
        # If several topics are silent, the longest silence is the cause.
        topic = min(self._heard, key=self._heard.__getitem__)
        if self._reason is None and time.monotonic() - self._heard[topic] > self._patience:
            silent = "no odometry" if topic == "odom" else f"no {topic}"
            self._stop(f"{silent} for {self._patience:g} s")
        if self._reason is not None:
            raise RobotStopped(self._reason)

    def _stop(self, reason: str) -> None:
        """Stop the wheels, and refuse motions for this reason until the robot is armed again."""
        if self._reason is None:
            self._reason = reason
            self._halt()
        self._news.notify_all()

    def _hear_odometry(self, message: Any) -> None:
        pose = message.pose.pose
        z, w = pose.orientation.z, pose.orientation.w
        with self._news:
            heading = 2 * math.atan2(z, w)
            if self._odometry is not None:
                turned = math.remainder(heading - self._odometry.heading, 2 * math.pi)
                heading = self._odometry.heading + turned
            self._odometry = Odometry(complex(pose.position.x, pose.position.y), heading)
            self._heard["odom"] = time.monotonic()
            self._messages += 1
            self._news.notify_all()

    def _hear(self, *, pressed: bool, danger: str | None = None) -> None:
        with self._news:
            self._heard[self.contact] = time.monotonic()
            self._pressed = pressed
            self._bumped |= pressed
            self._hear_danger(self.contact, danger)

    def _hear_danger(self, source: str, danger: str | None) -> None:
        with self._news:
            self._dangers[source] = danger
            if danger is not None:
                self._stop(danger)
            self._news.notify_all()

    def _hear_battery(self, message: Any) -> None:
        danger = None
        if message.power_supply_status == _CHARGING:
            danger = "it is on the charger"
        # A percentage that is not measured is NaN.
        elif message.percentage < LOW_BATTERY:
            danger = f"the battery is low ({message.percentage:.0%})"
        self._hear_danger("battery", danger)

    def _spin(self, executor: Any) -> None:
        try:
            executor.spin()
        except BaseException as error:
            with self._news:
                self._failure = error
                self._news.notify_all()

    def _tick(self, watchdog: Watchdog, closing: threading.Event) -> None:
        while not closing.wait(TICK):
            try:
                watchdog.beat()
            except OSError:
                with self._news:
                    self._stop("the watchdog is gone")

    def _begin(self) -> Odometry:
        """Check that the robot may drive, forget earlier bumps, and return the pose."""
        with self._news:
            self._check()
            self._bumped = self._pressed
            assert self._odometry is not None
            return self._odometry

    def _wait(self, condition: Callable[[], bool], end: float, motion: str) -> None:
        """Wait for a condition; raise if the robot must stop, or the `motion` outlasts `end`."""
        with self._news:
            while not condition():
                self._check()
                self._in_time(end, motion)
                self._news.wait(TICK)

    def _in_time(self, end: float, motion: str) -> None:
        """Stop the wheels and raise if the `motion` has not ended by the time `end`."""
        if time.monotonic() > end:
            with self._news:
                self._stop(f"{motion}: it takes too long")
                self._check()

    def _after(self, messages: int) -> Odometry:
        """Wait for the odometry message after the first `messages` ones, and return the latest."""
        self._wait(lambda: self._messages > messages, math.inf, "")
        assert self._odometry is not None
        return self._odometry

    def _settle(self) -> Odometry:
        """Wait until the robot stands still in three consecutive messages, or for 30 messages."""
        now, still = self._after(self._messages), 0
        for _ in range(30):
            before, now = now, self._after(self._messages)
            moved = abs(now.place - before.place) > _STILL
            still = 0 if moved or abs(now.heading - before.heading) > _STILL_TURN else still + 1
            if still == 2:
                break
        return now


def moved(start: Odometry, end: Odometry, bumped: bool) -> Moved:
    """Compute the result of a motion from the poses at its start and its end."""
    way = (end.place - start.place) * cmath.rect(1.0, -start.heading)
    return Moved(way.real, end.heading - start.heading, bumped, way.imag)
