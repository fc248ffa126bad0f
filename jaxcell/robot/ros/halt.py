"""How a robot on ROS 2 is stopped, and the process that does it when its driver is gone."""

import sys
import time
from collections.abc import Callable
from typing import Any

from ...base.extras import import_module
from ..create.watchdog import watch


_ACTIONS = ("drive_distance", "rotate_angle")


def goal_cancellers(node: Any) -> Callable[[], None]:
    """What cancels every goal of a Create 3, whoever sent it."""
    service = import_module("action_msgs.srv").CancelGoal
    clients = [node.create_client(service, f"{name}/_action/cancel_goal") for name in _ACTIONS]

    def cancel() -> None:
        for client in clients:
            # A request that names no goal and no time is for all.
            client.call_async(service.Request())

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


def main(kind: str, patience: float, arguments: list[str]) -> None:
    """Stop a robot whenever its driver is silent, and when it is gone.

    **Arguments:**

    - `kind`: that of its class.
    - `patience`: seconds.
    - `arguments`: of ROS.
    """
    rclpy = import_module("rclpy")
    handlers = import_module("rclpy.signals").SignalHandlerOptions.NO
    rclpy.init(args=arguments, signal_handler_options=handlers)
    node = rclpy.create_node("jaxcell_watchdog")
    cancel = goal_cancellers(node) if kind == "create3" else None
    roll = speed_publisher(node)

    def stop() -> None:
        roll(0.0, 0.0)
        if cancel is not None:
            cancel()
        # What was sent leaves while the node spins.
        rclpy.spin_once(node, timeout_sec=0.1)

    def end() -> None:
        for _ in range(5):
            stop()
            time.sleep(0.1)

    watch(stop, end, patience)
    node.destroy_node()
    rclpy.shutdown()


if __name__ == "__main__":
    main(sys.argv[1], float(sys.argv[2]), sys.argv[3:])
