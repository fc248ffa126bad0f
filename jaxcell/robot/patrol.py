import dataclasses
import math
from collections.abc import Callable
from typing import Any, Literal

import numpy as np

from .outcome import RunOutcome, observed
from .routing import close, next_way, wave
from .run_log import LoggedRun, RunLog, finished
from .tasks.patrol_task import PatrolTask
from .walker import Walker


@dataclasses.dataclass(frozen=True)
class PatrolOutcome(RunOutcome):
    """The outcome of a patrol."""

    visited: tuple[int, ...] = ()
    "The positions that the random walk drew as goals and the robot reached, in order."
    obstacles: tuple[tuple[int, int], ...] = ()
    "The position and direction (0 East to 3 South) of each bump where the map has free space."
    position: int = -1
    "The position of the robot at the end."
    intruder: Any = None
    "The report on an intruder; `None` if the robot saw no intruder."


class Patrol:
    """The state of a robot on its patrol, updated after its steps.

    A random walk draws the next goal, and wave routing leads the robot to it. After a bump, the
    step counts as blocked, and the robot takes another path. Because the obstacle may have been
    another robot, all these steps count as free again when none of the possible goals can be
    reached. The number of bumps is limited, because many bumps mean a wrong map or a lost robot.
    """

    def __init__(
        self,
        task: PatrolTask,
        *,
        start: int,
        facing: int,
        seed: int,
        visits: int,
        most_bumps: int,
        limit: int,
    ) -> None:
        """Put the robot at the position `start`, in the direction `facing`, 0 East to 3 South.

        The patrol ends after `visits` goals, `most_bumps` bumps, or `limit` steps. The random goals
        depend on `seed` and on the number of the robot in its team.
        """
        for name, value in (("visits", visits), ("most_bumps", most_bumps), ("limit", limit)):
            if value < 1:
                raise ValueError(f"{name}: expected at least 1, got {value}")
        if not 0 <= start < task.cells.positions:
            raise ValueError(f"start: expected 0 to {task.cells.positions - 1}, got {start}")
        self.settings = {"start": start, "facing": facing, "seed": seed, "visits": visits}
        self.settings |= {"most_bumps": most_bumps, "limit": limit}
        "The settings, which a log needs for a replay as `patrol` in its header."
        self.position, self.facing = start, facing
        self.observations = ""
        self.visited: list[int] = []
        self.obstacles: list[tuple[int, int]] = []
        self.goal: int | None = None
        "The position to which the robot is driving, or `None`."
        self._task, self._ways = task, task.ways.copy()
        self._at = self._drawn = start
        self._rng = np.random.default_rng([seed, task.robot])
        self._visits, self._most_bumps, self._limit = visits, most_bumps, limit
        self._distance = wave(self._ways, start)
        self._intruder: Any = None

    def next(self) -> int | None:
        """Choose the direction of the next step, 0 East to 3 South; `None` at the end."""
        while not self._result:
            if self.goal is None:
                self._draw()
            elif self.position == self.goal:
                self.visited.append(self.goal)
                self._at, self.goal = self._drawn, None
            else:
                return next_way(self._ways, self._distance, self.position, self.facing)
        return None

    def observe(self, way: int, bumped: bool) -> None:
        """Update the patrol after a step in the direction `way`; `bumped` is true after a bump."""
        self.observations += str(int(bumped))
        self.facing = way
        if not bumped:
            self.position = int(self._ways[way, self.position])
            return
        self.obstacles.append((self.position, way))
        close(self._ways, self.position, way)
        assert self.goal is not None
        self._distance = wave(self._ways, self.goal)
        if self._distance[self.position] < 0:
            self.goal = None

    def report(self, intruder: Any) -> None:
        """Record the report on an intruder, which ends the patrol."""
        self._intruder = intruder

    @property
    def _result(self) -> Literal["reported", "patrolled", "refuted", "unfinished"] | None:
        if self._intruder is not None:
            return "reported"
        if len(self.visited) >= self._visits:
            return "patrolled"
        if len(self.obstacles) >= self._most_bumps:
            return "refuted"
        return "unfinished" if len(self.observations) >= self._limit else None

    def _draw(self) -> None:
        """Draw the next goal from the random walk, among the cells that the robot can reach."""
        image, probability = self._task.image[:, self._at], self._task.probability[:, self._at]
        positions = self._task.cells.positions
        reached = wave(self._ways, self.position)[image % positions] >= 0
        weight = np.cumsum(np.where(reached, probability, 0.0))
        if weight[-1] == 0:
            self._ways = self._task.ways.copy()
            weight = np.cumsum(probability)
        drawn = np.searchsorted(weight, self._rng.random() * weight[-1], side="right")
        self._drawn = int(image[min(drawn, np.flatnonzero(np.diff(weight, prepend=0))[-1])])
        self.goal = self._drawn % positions
        self._distance = wave(self._ways, self.goal)

    def outcome(self) -> PatrolOutcome:
        """Return the outcome of the patrol so far."""
        visits, bumps = len(self.visited), len(self.obstacles)
        x, y, _ = map(float, self._task.cells.centre(self.position))
        place = f"({x:g} m, {y:g} m)"
        met = f"; something was in the way {_times(bumps)} where the map is free" if bumps else ""
        match self._result:
            case "reported":
                reason = f"at {place} after {_times(visits, 'visit')}: {self._intruder}{met}"
            case "refuted":
                reason = observed(
                    f"at {place} the robot has bumped {_times(bumps)} where the map is free: the "
                    "robot is on another map, or it has lost its place",
                    self.observations,
                )
            case _:
                reason = f"{_times(visits, 'visit')} of {self._visits} are done{met}"
        return PatrolOutcome(
            self._result or "unfinished",
            self.observations,
            reason,
            visited=tuple(self.visited),
            obstacles=tuple(self.obstacles),
            position=self.position,
            intruder=self._intruder,
        )


def run_patrol(
    walker: Walker,
    patrol: Patrol,
    *,
    look: Callable[[int], Any] | None = None,
    log: RunLog | None = None,
) -> PatrolOutcome:
    """Drive a robot on its patrol of the cells of a map (Alam 2018, section 4.5.7).

    **Arguments:**

    - `walker`: the robot, at the centre of its first cell, with 4 directions and steps of one cell.
    - `patrol`: the state of the patrol, which chooses each step.
    - `look`: a function that is called with each position that the robot reaches. It returns
        `None`, or a JSON value that is reported as an intruder and ends the patrol.
    - `log`: the log, to which each observation is written immediately.

    **Returns:** the outcome.

    A simulated robot that patrols between the ends of a corridor:

        >>> from jaxcell import examples, robot
        >>> task = examples.patrol_task()
        >>> settings = {"start": 0, "facing": 0, "seed": 0, "visits": 2}
        >>> patrol = robot.Patrol(task, **settings, most_bumps=9, limit=99)
        >>> walker = examples.walker()
        >>> robot.run_patrol(walker, patrol).observations
        '0000'
    """
    if walker.drives:
        _look(patrol, look, log)
    while (way := patrol.next()) is not None:
        goal = patrol.goal
        walker.rotate(math.remainder((way - patrol.facing) * math.pi / 2, 2 * math.pi))
        bumped = walker.step()
        patrol.observe(way, bumped)
        if log is not None:
            log.observation(walker, way=way, goal=goal, position=patrol.position)
        if walker.drives and not bumped:
            _look(patrol, look, log)
    return finished(patrol.outcome(), log)


def _look(patrol: Patrol, look: Callable[[int], Any] | None, log: RunLog | None) -> None:
    intruder = None if look is None else look(patrol.position)
    if intruder is not None:
        patrol.report(intruder)
        if log is not None:
            log.event("report", position=patrol.position, intruder=intruder)


def replay_patrol(run: LoggedRun, task: PatrolTask) -> PatrolOutcome:
    """Replay the observations and reports of a logged run through a patrol.

    **Arguments:** a log, whose header has the settings of the [`Patrol`][], and the task.
    **Returns:** the outcome of the run so far.

    **Raises:** `ValueError`, with the index of the observation, if a direction or goal in the log
    differs from that of the patrol. Then the log belongs to another task.

    The log of one step of a robot that patrols between the ends of a corridor:

        >>> from jaxcell import examples, robot
        >>> task = examples.patrol_task()
        >>> settings = {"start": 0, "facing": 0, "seed": 0, "visits": 2}
        >>> settings |= {"most_bumps": 9, "limit": 9}
        >>> events = ({"event": "observation", "observation": 0, "way": 0, "goal": 2},)
        >>> run = robot.LoggedRun({"patrol": settings}, events, False)
        >>> robot.replay_patrol(run, task).result
        'unfinished'
    """
    patrol = Patrol(task, **run.header["patrol"])
    for event in run.events:
        if event["event"] == "report":
            patrol.report(event.get("intruder"))
        elif event["event"] == "observation":
            way, index = patrol.next(), len(patrol.observations)
            logged = event.get("way"), event.get("goal")
            if way is None or logged != (way, patrol.goal):
                raise ValueError(
                    f"observation {index}: the log has direction {logged[0]} and goal {logged[1]}, "
                    f"the policy {way} and {patrol.goal}; the log is of another policy"
                )
            patrol.observe(way, event["observation"] == 1)
    patrol.next()
    return patrol.outcome()


def _times(count: int, what: str = "time") -> str:
    return f"{count} {what}{'' if count == 1 else 's'}"
