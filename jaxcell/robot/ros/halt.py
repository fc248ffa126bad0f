"""Stop a robot on ROS 2."""

from collections.abc import Callable
from typing import Any

from ...base.optional_modules import import_module


_ACTIONS = ("drive_distance", "rotate_angle")


def goal_cancellers(node: Any) -> Callable[[], list[Any]]:
    """Return a function that cancels all goals of a Create 3 and returns futures of its replies."""
    service = import_module("action_msgs.srv").CancelGoal
    clients = [node.create_client(service, f"{name}/_action/cancel_goal") for name in _ACTIONS]

    def cancel() -> list[Any]:
        # A request without a goal and a time applies to all goals.
        return [client.call_async(service.Request()) for client in clients]

    return cancel


def speed_type(node: Any) -> str | None:
    """Find the message type of a robot's speeds: `"Twist"`, else `"TwistStamped"`, else `None`."""
    topic = node.resolve_topic_name("cmd_vel")
    types = {end.topic_type for end in node.get_subscriptions_info_by_topic(topic)}
    names = ("Twist", "TwistStamped")
    return next((name for name in names if f"geometry_msgs/msg/{name}" in types), None)


def speed_publisher(node: Any, kind: str) -> Callable[[float, float], None]:
    """Return a function that sets the speeds of a base, in metres and radians per second.

    `kind` is the message type that [`speed_type`][jaxcell.robot.ros.halt.speed_type] returns.
    """
    messages = import_module("geometry_msgs.msg")
    publisher = node.create_publisher(getattr(messages, kind), "cmd_vel", 1)

    def roll(forward: float, left: float) -> None:
        twist = messages.Twist()
        twist.linear.x, twist.angular.z = float(forward), float(left)
        if kind == "Twist":
            publisher.publish(twist)
            return
        message = messages.TwistStamped()
        message.twist = twist
        message.header.frame_id = "base_link"
        message.header.stamp = node.get_clock().now().to_msg()
        publisher.publish(message)

    return roll
