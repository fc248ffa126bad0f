"""How a robot on ROS 2 is stopped."""

from collections.abc import Callable
from typing import Any

from ...base.extras import import_module


_ACTIONS = ("drive_distance", "rotate_angle")


def goal_cancellers(node: Any) -> Callable[[], list[Any]]:
    """What cancels every goal of a Create 3, whoever sent it, and gives the futures of that."""
    service = import_module("action_msgs.srv").CancelGoal
    clients = [node.create_client(service, f"{name}/_action/cancel_goal") for name in _ACTIONS]

    def cancel() -> list[Any]:
        # A request that names no goal and no time is for all.
        return [client.call_async(service.Request()) for client in clients]

    return cancel


def speed_publisher(node: Any) -> Callable[[float, float], None]:
    """What sets the speed of a base: forward in metres, and left in radians, a second."""
    twist = import_module("geometry_msgs.msg").Twist
    publisher = node.create_publisher(twist, "cmd_vel", 1)

    def roll(forward: float, left: float) -> None:
        message = twist()
        message.linear.x, message.angular.z = float(forward), float(left)
        publisher.publish(message)

    return roll
