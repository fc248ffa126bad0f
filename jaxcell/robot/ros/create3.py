import math
import time
from typing import Any

from ...base.optional_modules import import_module
from ..create.driver import RobotStopped
from ..create.motion import Moved
from .halt import goal_cancellers
from .node import RosRobot, moved


# The speeds in metres and radians per second.
_SPEED, _TURNING = 0.2, 1.0
# The seconds to wait for the answer to a goal, and to the last cancellation.
_ANSWER, _FAREWELL = 5.0, 1.0

_SUCCEEDED = 4
_BACKUP_LIMIT, _BUMP = 0, 1
# The settings of /motion_control that a run needs, and the fields and types of their values.
_NEEDED: dict[str, bool | str] = {"safety_override": "backup_only", "reflexes.REFLEX_BUMP": False}
_VALUES = {1: "bool_value", 4: "string_value"}
_DANGERS = {2: "there is a cliff", 3: "a wheel is blocked", 4: "a wheel hangs in the air"}


class Create3(RosRobot):
    """An iRobot Create 3, alone or as the base of a TurtleBot 4, which is driven by ROS actions.

    ```python
    with Create3(remap=["__ns:=/robot1"]) as robot:
        robot.arm()
        robot.forward(0.5, tolerance=0.005)
    ```

    [`jaxcell.robot.ros`][] describes the events that stop the robot, and two necessary settings.
    """

    kind, contact = "create3", "hazard_detection"

    def _connect(self) -> None:
        self._backing = False
        actions = import_module("irobot_create_msgs.action")
        client = import_module("rclpy.action").ActionClient
        self._drive, self._rotate = actions.DriveDistance, actions.RotateAngle
        self._driving = client(self.node, self._drive, "drive_distance")
        self._rotating = client(self.node, self._rotate, "rotate_angle")
        self._cancel_all = goal_cancellers(self.node)
        messages = import_module("irobot_create_msgs.msg")
        self.node.create_subscription(
            messages.HazardDetectionVector, self.contact, self._hear_hazards, self._sensors
        )
        self.node.create_subscription(
            messages.DockStatus, "dock_status", self._hear_dock, self._sensors
        )

    def arm(self) -> None:
        for client, name in (self._driving, "drive_distance"), (self._rotating, "rotate_angle"):
            if not client.wait_for_server(timeout_sec=_ANSWER):
                raise RobotStopped(f"nothing offers the action {name}")
        super().arm()

    def settings(self) -> tuple[dict[str, bool | str | None], str]:
        """Ask the robot for the two settings that a run needs.

        **Returns:** their values, `None` for one that the robot does not know, and the command that
        sets them to what a run needs, or `""`.

        **Raises:** [`jaxcell.robot.RobotStopped`][] if nothing answers.
        """
        service, name = import_module("rcl_interfaces.srv"), "motion_control/get_parameters"
        client = self.node.create_client(service.GetParameters, name)
        node = self.node.resolve_service_name(name).rpartition("/")[0]
        there = client.wait_for_service(timeout_sec=self.answer)
        asked = self._watched(client.call_async(service.GetParameters.Request(names=[*_NEEDED])))
        with self._news:
            if not (there and self._news.wait_for(asked.done, self.answer)):
                raise RobotStopped(f"{node} does not answer: is --remap right?")
        values: dict[str, bool | str | None] = dict.fromkeys(_NEEDED)
        # The answer of a node that lacks one of the settings is empty.
        for name, answer in zip(_NEEDED, asked.result().values, strict=False):
            values[name] = getattr(answer, _VALUES.get(answer.type, ""), None)
        wrong = [name for name in _NEEDED if values[name] != _NEEDED[name]]
        sets = (f"ros2 param set {node} {name} {str(_NEEDED[name]).lower()}" for name in wrong)
        return values, " && ".join(sets)

    def forward(self, distance: float, *, tolerance: float) -> Moved:
        goal = self._drive.Goal()
        goal.distance, goal.max_translation_speed = float(distance), _SPEED
        self._backing = distance < 0
        what = f"forward {distance:.3g} m"
        return self._act(self._driving, goal, what, abs(distance) / _SPEED, distance > 0)

    def turn(self, angle: float, *, tolerance: float) -> Moved:
        goal = self._rotate.Goal()
        goal.angle, goal.max_rotation_speed = float(angle), _TURNING
        self._backing = False
        what = f"turn {math.degrees(angle):.3g} degrees"
        return self._act(self._rotating, goal, what, abs(angle) / _TURNING, False)

    def _act(self, client: Any, goal: Any, what: str, seconds: float, stop_on_bump: bool) -> Moved:
        """Send an action goal, wait about `seconds` for its end, and cancel it at a bump."""
        start = self._begin()
        if stop_on_bump and self._bumped:
            return Moved(0.0, 0.0, True)
        result = None
        try:
            sent = self._watched(client.send_goal_async(goal))
            self._wait(sent.done, time.monotonic() + _ANSWER, f"{what}: the goal")
            handle = sent.result()
            if not handle.accepted:
                raise RobotStopped(f"{what}: the robot refuses the goal")
            result = self._watched(handle.get_result_async())
            end = time.monotonic() + 2 * seconds + 5
            self._wait(lambda: result.done() or (stop_on_bump and self._bumped), end, what)
            bumped = stop_on_bump and self._bumped
            if not result.done():
                handle.cancel_goal_async()
                self._wait(result.done, time.monotonic() + _ANSWER, f"{what}: its end")
        except BaseException:
            self._halt()
            raise
        now = self._settle()
        # The message of the hazard that may have ended the goal has arrived by now.
        self._check()
        if not bumped and result.result().status != _SUCCEEDED:
            raise RobotStopped(f"{what}: the robot has given up the goal")
        return moved(start, now, bumped)

    def _watched(self, future: Any) -> Any:
        """Make a future wake the waiting thread when it is done, and return the future."""
        future.add_done_callback(self._notice)
        return future

    def _notice(self, _: Any) -> None:
        with self._news:
            self._news.notify_all()

    def _halt(self) -> None:
        self._cancel_all()

    def _stop_at_end(self) -> None:
        answers, end = self._cancel_all(), time.monotonic() + _FAREWELL
        while not all(answer.done() for answer in answers) and time.monotonic() < end:
            time.sleep(0.01)

    def _hear_dock(self, message: Any) -> None:
        self._hear_danger("dock", "it is on the dock" if message.is_docked else None)

    def _hear_hazards(self, message: Any) -> None:
        kinds = {hazard.type for hazard in message.detections}
        danger = next((text for kind, text in _DANGERS.items() if kind in kinds), None)
        if _BACKUP_LIMIT in kinds and self._backing:
            danger = "it does not back up farther: its safety_override must be backup_only"
        self._hear(pressed=_BUMP in kinds, danger=danger)
