"""A process that stops a robot on ROS 2 when its driver hangs or ends."""

import sys
import time

from ...base.optional_modules import import_module
from ..create.watchdog import watch
from .halt import goal_cancellers, speed_publisher


def main(kind: str, patience: float, speeds: str, arguments: list[str]) -> None:
    """Stop a robot whenever its driver is silent for `patience` seconds, and when the driver ends.

    `kind` is the kind of the robot, such as `"create3"`, `speeds` is the ROS type of its velocity
    messages, and `arguments` are command-line arguments for ROS.
    """
    rclpy = import_module("rclpy")
    handlers = import_module("rclpy.signals").SignalHandlerOptions.NO
    rclpy.init(args=arguments, signal_handler_options=handlers)
    node = rclpy.create_node("jaxcell_watchdog")
    cancel = goal_cancellers(node) if kind == "create3" else None
    roll = speed_publisher(node, speeds)

    def stop() -> None:
        roll(0.0, 0.0)
        if cancel is not None:
            cancel()
        # Messages leave while the node spins.
        rclpy.spin_once(node, timeout_sec=0.1)

    def end() -> None:
        for _ in range(5):
            stop()
            time.sleep(0.1)

    watch(stop, end, patience)
    node.destroy_node()
    rclpy.shutdown()


if __name__ == "__main__":
    main(sys.argv[1], float(sys.argv[2]), sys.argv[3], sys.argv[4:])
