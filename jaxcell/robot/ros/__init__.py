"""Robots on ROS 2: an iRobot Create 3 or TurtleBot 4, and any base with `cmd_vel` and `odom`.

It has met no robot. It is tested against a stand-in for `rclpy` and the messages, whose fields and
types are those of their definitions. What it takes from the documentation of the Create 3:

- The actions `drive_distance` and `rotate_angle` end by the robot's own odometry. A robot that
    bumps goes on pushing, so a goal is cancelled here as soon as `hazard_detection` has a bump.
- By default it backs away from a bump by itself, and backs up by a few centimetres only. A run
    needs neither: `ros2 param set /motion_control reflexes.REFLEX_BUMP false` and
    `ros2 param set /motion_control safety_override backup_only`, as its cliff sensors look ahead,
    for a robot whose floor has no edge behind it.
- A cliff, a stall and a dropped wheel end a goal. Here they stop the robot until it is armed again.

**What else stops it.** A robot that is not heard does not drive: `arm` refuses until the bumper has
reported (`hazard_detection` of a Create 3, `bumper` of a base), and a bumper or an odometry that is
silent for `patience` stops the robot until it is armed again. So do a battery below 10 % and a
charger (`battery_state`, where there is one) and the dock of a Create 3 (`dock_status`).

**When the host dies.** A goal of an action that was accepted runs to its end, at most a step of the
map. A process of its own, which outlives that of the driver, cancels all goals and sends a speed of
0 when the driver is silent for two seconds or gone. Most bases stop by themselves when no `cmd_vel`
comes for a while, half a second or so; whether yours does is in its manual. None of it helps where
the network is cut between host and robot.

`rclpy` and the messages are those of the system, not of pip: they are imported when a robot is
opened, and this package when it is asked for.
"""

from .base import Base as Base
from .candidates import Candidates as Candidates
from .create3 import Create3 as Create3
from .node import RosRobot as RosRobot
