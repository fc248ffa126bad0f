import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Int

from ...base.optional_modules import import_module
from ...space import CellSpace
from ..tasks.files import AnyTask, BeliefTask, FilterTask, PolicyTask
from ..tasks.patrol_task import PatrolTask
from .node import RosRobot


# The largest number of published arrows. The first ones are the likeliest.
_MAX_POSES = 1000


class Candidates:
    """A publisher of the possible places of a robot after each observation of its run.

    - `candidates`, a `geometry_msgs/PoseArray`: the possible configurations of a filter, policy or
        belief, or the position of a patrol. For other tasks, it contains the pose from odometry in
        the frame `start`, whose origin is the start of the robot.
    - `candidate_squares`, a `nav_msgs/OccupancyGrid` in the frame `map`: 100 on possible squares of
        the map, 0 on the other free squares, and -1 elsewhere.

    Without a map, nothing is published for a filter, policy or belief.
    """

    def __init__(self, robot: RosRobot, task: AnyTask, cells: CellSpace | None) -> None:
        quality = import_module("rclpy.qos")
        # Later subscribers receive the last message too.
        kept = quality.QoSProfile(depth=1, durability=quality.DurabilityPolicy.TRANSIENT_LOCAL)
        messages = import_module("geometry_msgs.msg")
        self._pose, self._poses = messages.Pose, messages.PoseArray
        self._grid = import_module("nav_msgs.msg").OccupancyGrid
        self._node = robot.node
        self._arrows = robot.node.create_publisher(self._poses, "candidates", kept)
        self._squares = robot.node.create_publisher(self._grid, "candidate_squares", kept)
        self._follower = None
        if isinstance(task, FilterTask | PolicyTask | BeliefTask):
            self._follower = task.follower()
        self._cells = task.cells if isinstance(task, PatrolTask) else cells

    def event(self, name: str, fields: Mapping[str, Any]) -> None:
        """Publish the places after an observation; see `on_event` of [`jaxcell.robot.RunLog`][]."""
        if name != "observation":
            return
        if self._follower is not None:
            self._follower.observe(fields["observation"])
            self._publish(np.asarray(self._follower.cells, np.int64))
        elif "position" in fields:
            assert self._cells is not None
            cell = fields["way"] * self._cells.positions + fields["position"]
            self._publish(np.array([cell]))
        else:
            ahead, left, turned = fields["estimate"]
            self._send("start", [(ahead, left, turned)])

    def _publish(self, candidates: Int[np.ndarray, "candidates"]) -> None:
        if self._cells is None:
            return
        poses = zip(*(v.tolist() for v in self._cells.centre(candidates[:_MAX_POSES])), strict=True)
        self._send("map", list(poses))
        grid = self._grid()
        grid.header.frame_id = "map"
        grid.header.stamp = self._node.get_clock().now().to_msg()
        squares = np.where(self._cells.free, 0, -1)
        possible = np.isin(np.arange(self._cells.positions), candidates % self._cells.positions)
        squares[self._cells.free] = np.where(possible, 100, 0)
        rows, columns = squares.shape
        grid.info.resolution = float(self._cells.cell)
        grid.info.width, grid.info.height = columns, rows
        grid.info.origin.position.x, grid.info.origin.position.y = map(float, self._cells.origin)
        grid.info.origin.orientation.w = 1.0
        grid.data = squares.ravel().tolist()
        self._squares.publish(grid)

    def _send(self, frame: str, poses: list[tuple[float, float, float]]) -> None:
        message = self._poses()
        message.header.frame_id = frame
        message.header.stamp = self._node.get_clock().now().to_msg()
        for x, y, heading in poses:
            pose = self._pose()
            pose.position.x, pose.position.y = float(x), float(y)
            pose.orientation.z, pose.orientation.w = math.sin(heading / 2), math.cos(heading / 2)
            message.poses.append(pose)
        self._arrows.publish(message)
