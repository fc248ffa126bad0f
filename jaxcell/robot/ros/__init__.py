"""Robots on ROS 2: an iRobot Create 3 or TurtleBot 4, and any base with `cmd_vel` and `odom`.

This package has not been tested on a robot. It has been tested with substitutes for `rclpy` and the
messages, which have the specified fields and types. According to the documentation of the Create 3:

- The robot uses its odometry for the actions `drive_distance` and `rotate_angle`. A robot that
    bumps keeps pushing, so this package cancels a goal as soon as `hazard_detection` reports a
    bump.
- By default the robot backs away from a bump, and drives only a few centimetres backward. A run
    needs other settings: `ros2 param set /motion_control reflexes.REFLEX_BUMP false` and
    `ros2 param set /motion_control safety_override backup_only`. `jaxcell robot check --ros
    create3` asks the robot for both. Because the cliff sensors look ahead, the floor must have no
    edge behind the robot.
- A cliff, a stall and a dropped wheel end a goal. Here they stop the robot until it is armed again.

**Other stops.** `arm` refuses a robot until its bumper has reported (`hazard_detection` of a Create
3, `bumper` of a base). The robot stops until it is armed again if the bumper or the odometry sends
no message for longer than `patience`, if the battery is below 10 % or charging (according to
`battery_state`, if it is published), or if a Create 3 is in its dock (according to `dock_status`).

**If the host fails,** an accepted goal of an action runs to its end, at most a step of the map. A
separate process, which outlives the driver, cancels all goals and sends a speed of 0 when the
driver is silent for two seconds or has ended. Most bases also stop by themselves after about half a
second without `cmd_vel`; see the manual of the base. Nothing stops the robot if the network between
host and robot fails.

`rclpy` and the messages belong to the installation of ROS, not to pip. They are imported when a
robot is opened.
"""

from .base import Base as Base
from .candidates import Candidates as Candidates
from .create3 import Create3 as Create3
from .node import RosRobot as RosRobot
