import dataclasses
import enum
import functools
import math
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, TypeAlias

import numpy as np
from jaxtyping import Bool, Int

from ..base.quantities import Checks, Result, derived, from_part, quantity
from ..space import CellSpace
from .dynamics import motion_violations, robots_over_time


_Flags: TypeAlias = Bool[np.ndarray, "steps robots"]
_SOURCE = "Alam 2018, section 3.4.4"


class TeamOutcome(enum.Enum):
    """The reason why the search for a joint trajectory ended; each value is a sentence."""

    COVERED = "every position was visited"
    OUT_OF_REACH = (
        "every position was visited that steps in any direction lead to from the starts; "
        "the others are out of reach"
    )
    STUCK = "every turn of one robot by one direction leads to a joint state that was there before"
    OUT_OF_PARTS = "the trajectory has as many parts as are allowed"


def _steps_to(percent: int) -> Any:
    def steps(team: Any) -> float:
        enough = np.flatnonzero(100 * team.covered >= percent * team.cells.positions)
        return float(enough[0]) if enough.size else math.inf

    return derived("", f"steps to cover {percent} %", kind="time")(steps)


@dataclasses.dataclass(frozen=True, eq=False)
class TeamTrajectory(Result):
    """A joint trajectory of several robots that covers a map, or a part of it."""

    title: ClassVar[str] = "Joint trajectory of bouncing robots for coverage"
    picture: ClassVar[str] = "first_visit"
    tables: ClassVar[Mapping[str, str]] = {"robot": "robots"}

    cells: CellSpace
    bumped: Annotated[
        _Flags, quantity("move robot", "whether the robot stays and turns", kind="flag")
    ]
    collided: Annotated[
        _Flags, quantity("move robot", "whether the robot meets another", kind="flag")
    ]
    "A mask of the robots that collide with another robot."
    collisions: Annotated[
        Int[np.ndarray, "steps"], quantity("move", "pairs of robots that collide", kind="count")
    ]
    cell: Annotated[
        Int[np.ndarray, "steps+1 robots"],
        quantity("time robot", "cell that the robot is in", kind="cell", source=_SOURCE),
    ]
    "The cells of the robots before the first step and after each step."
    covered: Annotated[
        Int[np.ndarray, "steps+1"],
        quantity("time", "positions visited so far", "positions", kind="count"),
    ]
    part_begin: Annotated[
        Int[np.ndarray, "parts"],
        quantity("part", "first time of the part", "mappings", kind="index"),
    ]
    "The time at which each part begins. All parts but the first begin with a turn of one robot."
    uncovered_positions: Annotated[
        Int[np.ndarray, "uncovered"],
        quantity(
            "uncovered_index", "positions that are never visited", kind="position", listed=True
        ),
    ]
    "The positions that are never visited, in ascending order."
    outcome: Annotated[TeamOutcome, quantity("", "outcome", kind="text")]

    @property
    def answered(self) -> bool:
        return self.uncovered == 0

    @property
    def answer(self) -> tuple[str, ...]:
        robots, visited = self.cell.shape[1], f"{self.positions_covered:,}"
        of = "all" if self.answered else f"{visited} of"
        many = "1 robot visits" if robots == 1 else f"{robots:,} robots visit"
        return (f"{many} {of} {self.cells.positions:,} positions in {self.steps:,} steps.",)

    meaning = from_part("outcome.value", "", "reason for the end", kind="text")

    @derived("", "steps", kind="count")
    def steps(self) -> int:
        return len(self.bumped)

    parts = from_part("part_begin.size", "", "parts", kind="count")

    steps_to_50_percent, steps_to_90_percent, steps_to_100_percent = map(_steps_to, (50, 90, 100))

    @derived("", "bumps", kind="count")
    def bumps(self) -> int:
        return int(self.bumped.sum())

    @derived("", "collisions of two robots", kind="count")
    def collisions_in_all(self) -> int:
        return int(self.collisions.sum())

    @derived("", "positions that are visited", kind="count")
    def positions_covered(self) -> int:
        return int(self.covered[-1])

    uncovered = from_part(
        "uncovered_positions.size", "", "positions that stay uncovered", kind="count"
    )

    @derived("", "remark", kind="text")
    def remark(self) -> str | None:
        room = self.cells.workspace
        if room is None or 2 * room.robot_radius <= self.cells.cell:
            return None
        return "Robots wider than a cell count as meeting only where their centres do."

    @derived("robot", "starts at", kind="cell", listed=True)
    def starts(self) -> Int[np.ndarray, "robots"]:
        return self.cell[0]

    @derived("robot", "ends at", kind="cell", listed=True)
    def ends(self) -> Int[np.ndarray, "robots"]:
        return self.cell[-1]

    time, robot_x, robot_y, robot_theta = robots_over_time("cell", "time robot")

    @derived("position", "time of the first visit, -1 if there is none", "mappings", kind="index")
    def first_visit(self) -> Int[np.ndarray, "positions"]:
        return self._first_visits[0]

    @derived("position", "robot that is there first, -1 if there is none", kind="index")
    def first_visitor(self) -> Int[np.ndarray, "positions"]:
        return self._first_visits[1]

    def checks(self) -> Checks:
        position = np.sort(self.cell % self.cells.positions, axis=1)
        begins = self.part_begin[1:]
        wrong = motion_violations(self.cells, self.cell, self.bumped)
        # The move before a part begins is the turn of one robot.
        wrong[begins - 1] = False
        changed = self.cell[begins] - self.cell[begins - 1]
        turned = changed // self.cells.positions % self.cells.directions
        one = np.isin(turned, (1, self.cells.directions - 1)).sum(axis=1) == 1
        alone = one & ((changed != 0).sum(axis=1) == 1)
        visits = np.bincount(self.first_visit[self.first_visit >= 0], minlength=len(self.cell))
        error = np.abs(np.cumsum(visits) - self.covered).max()
        return {
            "shared_positions": (int(np.count_nonzero(np.diff(position, axis=1) == 0)), 0),
            "moves_against_the_rule": (int(wrong.sum()), 0),
            "parts_that_begin_otherwise": (int(np.count_nonzero(~alone)), 0),
            "covered_minus_visited": (int(error), 0),
        }

    @functools.cached_property
    def _first_visits(self) -> Int[np.ndarray, "2 positions"]:
        """The time of the first visit to each position, and the robot that makes it, or -1."""
        position, first = np.unique(self.cell % self.cells.positions, return_index=True)
        visits = np.full((2, self.cells.positions), -1, np.int32)
        visits[:, position] = np.divmod(first, self.cell.shape[1])
        return visits
