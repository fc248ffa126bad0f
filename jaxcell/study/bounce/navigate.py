import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar, TypeAlias

from ... import bounce, space, verify as verification
from ...base.quantities import Result
from ..map_study import MapStudy, cell_at
from ..parameters import Degrees, Length, Limit, Only, Share
from ..study import Say, about, numbers, radians, silent
from .anywhere import AnywhereStudy


_Cost: TypeAlias = Annotated[float, Limit(gt=0)]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Plans(MapStudy):
    """Find the cost of the best plan of a bouncing robot between each pair of cells."""

    name: ClassVar[str] = "plans"
    task: ClassVar[str] = "plans"

    bounces: tuple[Degrees, ...]
    """Bouncing angles to choose from, in degrees, counter-clockwise."""
    keep: _Cost = 1.0
    """Cost of a step, and of a bump with the same angle as the previous bump."""
    change: _Cost = 100.0
    """Cost of a bump with a different angle from the previous bump."""

    def needed(self, extent: "space.Extent") -> float | int:
        return space.estimates.plans(extent, self.motion)

    def run(self, say: Say = silent) -> Result:
        cells = self.cells()
        say(f"planning among all pairs of {cells.size:,} cells")
        return bounce.all_plans(cells, **self.choices, motion=self.motion).cost_summary()

    @property
    def choices(self) -> dict[str, Any]:
        """The bouncing angles and costs, as keyword arguments of functions of `jaxcell.bounce`."""
        return {
            "bounces": radians(self.bounces),
            "keep": _whole(self.keep),
            "change": _whole(self.change),
        }

    def verify(self, result: Any) -> "Sequence[verification.Comparison]":
        return verification.compare_plan(result.costliest, self.motion)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Navigate(AnywhereStudy, Plans):
    """Plan how a bouncing robot, which chooses an angle at each bump, reaches a goal."""

    name: ClassVar[str] = "navigation"
    command: ClassVar[str] = "navigate"
    example: ClassVar[str] = "@complex --bounces 45 90 135 --start 0.5,1.5,0 --goal 12.5,9.5,0"
    task: ClassVar[str] = ""

    start: str | None = None
    """Start of the robot: "x,y,heading" in m and degrees, or a cell number. With --anywhere, robots
    start at random by default."""
    goal: str
    """Goal, in the same form as the start; with --anywhere "x,y" in m."""
    goal_radius: Annotated[Length | None, Only(anywhere=True)] = None
    """Distance within which a robot has reached the goal, in metres; by default the side of a cell,
    or half a metre if cells are smaller."""
    keep: Annotated[_Cost, Only(anywhere=False)] = 1.0
    change: Annotated[_Cost, Only(anywhere=False)] = 100.0
    slip: Annotated[Share | None, Only(anywhere=False, collision="swept")] = None
    """Common standard deviation of three errors: the relative errors of a step and of a turn, and
    the drift of the heading in radians per metre. The result then also has the probability that
    the plan succeeds, and a policy that is certain to reach the goal, if there is one."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.anywhere and self.start is None:
            raise ValueError("start: expected the start of the robot, or `anywhere`")

    def needed(self, extent: "space.Extent") -> float | int:
        if self.slip is None:
            return super().needed(extent)
        from ...bounce.slip.fine_cells import most_cells, needed

        cells = most_cells(self.slip)
        return super().needed(extent) + needed(cells, angles=len(self.bounces))

    def run(self, say: Say = silent) -> Result:
        if self.anywhere:
            return self._home(say)
        cells = self.cells()
        start, goal = (cell_at(cells, getattr(self, end), end) for end in ("start", "goal"))
        say(f"planning among {cells.size:,} cells")
        planned = bounce.plan(cells, start=start, goal=goal, **self.choices, motion=self.motion)
        if self.slip is None:
            return planned
        from .slipped_plan import slipped_plan

        return slipped_plan(planned, self.slip, self.bounces, self.step, say)

    def _home(self, say: Say) -> Result:
        x, y = numbers("goal", self.goal, 2, '"x,y" in metres, for robots that start anywhere')
        with about(f"goal {self.goal!r}"):
            self.cells().index(x, y)
        radius = max(self.cells().cell, 0.5) if self.goal_radius is None else self.goal_radius
        return self.run_anywhere(self.bounces, self.start, say, ((x, y), radius))

    def write(self, result: Any, out: Path) -> None:
        if self.anywhere:
            self.save_task(result, out)

    def verify(self, result: Any) -> "Sequence[verification.Comparison]":
        return [] if self.anywhere else verification.compare_plan(result, self.motion)


def _whole(cost: float) -> int | float:
    """Convert a cost that is a whole number to `int`, so that sums of such costs are exact."""
    return int(cost) if cost == int(cost) else cost
