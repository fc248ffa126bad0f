import dataclasses
import math
import os
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Int

from ..base.documents import Fields
from .outcome import RunOutcome, actions_outcome
from .run_log import LoggedRun, RunLog, finished
from .tasks.task import Task, common_fields, robot_fields, write_task
from .walker import Walker


# The actions of a robot of a team, as `member_actions` describes them.
FREE, WALL, ROBOT, LEFT, RIGHT = "0", "1", "2", "+", "-"

TRIES = 3
"""The number of times that a robot of a team tries a blocked step."""


@dataclasses.dataclass(frozen=True)
class MemberTask(Task):
    """The task of one robot of a team: its actions in a joint trajectory."""

    kind = "team"
    robot: int
    "The index of this robot in the file."
    robots: int
    "The number of robots in the team."
    start: tuple[float, float, float]
    "The pose at the start: x and y in metres, and the heading in radians."
    bounce: float
    "The bouncing angle, in radians, counter-clockwise."
    actions: str
    "The actions, one character per action, as [`jaxcell.robot.member_actions`][] writes them."

    @property
    def start_direction(self) -> int:
        return round(self.start[2] * self.directions / (2 * math.pi)) % self.directions

    @property
    def header(self) -> dict[str, Any]:
        return {
            **super().header,
            "robot": self.robot,
            "bounce_deg": math.degrees(self.bounce),
            "actions": self.actions,
        }


def member_actions(
    path: Int[np.ndarray, "times robots"],
    bumped: Bool[np.ndarray, "steps robots"],
    steps: Int[np.ndarray, "directions positions"],
) -> list[str]:
    """Write the actions of each robot in a joint trajectory.

    **Arguments:**

    - `path`, `bumped`: `cell` and `bumped` of a [`jaxcell.bounce.TeamTrajectory`][].
    - `steps`: the position after a step in each direction from each position, unchanged at a wall;
        the result of [`jaxcell.space.free_steps`][] for the cells and motion of the trajectory.

    **Returns:** the actions of each robot in order, one character each: `0` for a free step; `1`
    for a step into a wall and a turn by the bouncing angle; `2` for a turn by the bouncing angle
    without a step, because another robot is in the way; `+` and `-` for a turn by one direction to
    the left and to the right, without a step.

    A single robot in a row of two cells makes a step, and turns at the wall:

        >>> import numpy as np
        >>> from jaxcell import robot, space
        >>> room = space.Workspace([(0, 0), (2, 0), (2, 1), (0, 1)])
        >>> cells = space.CellSpace.of(room, 1.0, 4)
        >>> path, bumped = np.int32([[0], [1], [3]]), np.array([[False], [True]])
        >>> robot.member_actions(path, bumped, space.free_steps(cells))
        ['01']
    """
    directions, positions = steps.shape
    direction, position = np.divmod(path, positions)
    wall = np.take(steps, path[:-1]) == position[:-1]
    moved = position[1:] != position[:-1]
    # In a row without bumps and moves, one robot turns, which begins a part of the trajectory.
    turned = (direction[1:] - direction[:-1]) % directions
    begins = np.where(turned == 0, "", np.where(turned == 1, LEFT, RIGHT))
    kind = np.where(bumped, np.where(wall, WALL, ROBOT), np.where(moved, FREE, begins))
    return ["".join(actions) for actions in kind.T.tolist()]


def save_team(
    path: str | os.PathLike[str],
    common: dict[str, Any],
    starts: Sequence[tuple[float, float, float]],
    bounces: Sequence[float],
    actions: Sequence[str],
) -> None:
    """Write the tasks of the robots of a team to a file for [`jaxcell.robot.load_task`][].

    **Arguments:** the path of the file; its common fields, which are `cell_m`, `directions`,
    `step_m`, `robot_radius_m`, and any others; the poses at the start in metres and radians; the
    bouncing angles in radians; and the actions that [`member_actions`][] returns.

    A robot that makes two steps and turns at a wall:

        >>> import math
        >>> from jaxcell import examples, robot
        >>> common = {"cell_m": 1.0, "directions": 4, "step_m": 1.0, "robot_radius_m": 0.0}
        >>> path = examples.folder() / "team.json"
        >>> robot.save_team(path, common, [(0.5, 0.5, 0.0)], [math.pi / 2], ["001"])
        >>> task = robot.load_task(path)
        >>> task.start, task.actions
        ((0.5, 0.5, 0.0), '001')
    """
    robots = [
        {
            "start": [x, y, round(math.degrees(theta), 9)],
            "bounce_deg": round(math.degrees(bounce), 9),
            "actions": own,
        }
        for (x, y, theta), bounce, own in zip(starts, bounces, actions, strict=True)
    ]
    write_task(path, MemberTask.kind, **(common | {"robots": robots}))


def read_member(path: Path, values: dict[str, Any], robot: int) -> MemberTask:
    """Read the task of one robot from the parsed contents of a team file."""
    fields = Fields(values, f"{path}: ")
    own = robot_fields(path, fields, robot)
    x, y, heading = own.numbers("start", (3,), whole=False).tolist()
    actions = own.get("actions")
    if not isinstance(actions, str) or set(actions) - {FREE, WALL, ROBOT, LEFT, RIGHT}:
        raise own.refused("actions", "a text of 0, 1, 2, + and -")
    return MemberTask(
        **common_fields(path, fields),
        robot=robot,
        robots=len(values["robots"]),
        start=(x, y, math.radians(heading)),
        bounce=math.radians(own.number("bounce_deg")),
        actions=actions,
    )


class Member:
    """The state of a robot of a team, updated with its observations."""

    def __init__(self, actions: str) -> None:
        self.observations = ""
        self.index = 0
        "The index of the next action."
        self._actions, self._bumps = actions, 0
        self._refuted = ""

    @property
    def action(self) -> str | None:
        """The next action, or `None` at the end."""
        over = self._refuted or self.index == len(self._actions)
        return None if over else self._actions[self.index]

    @property
    def waits(self) -> bool:
        """True if the last step was blocked, so that the robot must wait and try it again."""
        return self._bumps > 0

    def observe(self, bumped: bool) -> None:
        """Update the state after a step; `bumped` is true if the step ended in a bump."""
        self.observations += str(int(bumped))
        if bumped == (self.action == WALL):
            self.index, self._bumps = self.index + 1, 0
        elif bumped:
            self._bumps += 1
            if self._bumps == TRIES:
                self._refuted = f"the robot bumped {TRIES} times where its way is free"
        else:
            self._refuted = "the robot met no wall where there is one"

    def replay(self, observations: str) -> None:
        """Update the state with the observations of an earlier run, and pass over its turns."""
        left = list(observations)
        while left or self.action in (ROBOT, LEFT, RIGHT):
            if self.action is None:
                raise ValueError("the log has more observations than the robot has steps")
            if self.action in (FREE, WALL):
                self.observe(left.pop(0) == "1")
            else:
                self.index += 1

    def outcome(self) -> RunOutcome:
        """Return the outcome of the run so far."""
        return actions_outcome(self.observations, self.index, len(self._actions), self._refuted)


def run_member(
    walker: Walker,
    task: MemberTask,
    *,
    log: RunLog | None = None,
    pause: float = 2.0,
    sleep: Callable[[float], object] = time.sleep,
) -> RunOutcome:
    """Drive a robot through its part of a joint trajectory (Alam 2018, Alg. 3.4).

    The robots do not see each other and share no clock, so they arrive a little early or late at
    the places where two robots meet in the trajectory. At such a place, each robot makes the turn
    of the trajectory without a step, and does not sense the other robot. If a step that is free in
    the trajectory bumps, another robot may be in the way. Then the robot goes back, waits, and
    tries again, at most 3 times in all.

    **Arguments:** a walker; the task; the log; the seconds of each wait; and a function that waits.
    **Returns:** [`jaxcell.robot.RunOutcome`][]: `"arrived"`, or `"refuted"` if a step does not bump
    where the map has a wall, or bumps three times where it has none.

    A simulated robot in a corridor of three cells:

        >>> import math, pathlib
        >>> from jaxcell import examples, robot
        >>> walker = examples.walker()
        >>> map = pathlib.Path("team.json"), 1.0, 4, 1.0, 0.0
        >>> task = robot.MemberTask(*map, 0, 1, (0.5, 0.5, 0.0), math.pi / 2, "001")
        >>> outcome = robot.run_member(walker, task)
        >>> outcome.result, outcome.observations
        ('arrived', '001')
    """
    member = Member(task.actions)
    direction = 2 * math.pi / task.directions
    turns = {WALL: task.bounce, ROBOT: task.bounce, LEFT: direction, RIGHT: -direction}
    while (action := member.action) is not None:
        index = member.index
        if action in (FREE, WALL):
            if member.waits and walker.drives:
                sleep(pause)
            bumped = walker.step()
            member.observe(bumped)
            if log is not None:
                log.observation(walker, action=index)
        else:
            member.index += 1
        if member.index > index and action in turns:
            walker.rotate(turns[action])
    return finished(member.outcome(), log)


def replay_member(run: LoggedRun) -> RunOutcome:
    """Replay the log of [`run_member`][], and return the outcome of the run so far."""
    member = Member(run.header["actions"])
    member.replay(run.observations)
    return member.outcome()
