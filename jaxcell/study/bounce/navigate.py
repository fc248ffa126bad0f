import dataclasses
from collections.abc import Sequence
from typing import Annotated, Any, ClassVar, TypeAlias

from ... import bounce as bouncing, space, verify as verification
from ...base.quantities import Result
from ..errors import ErrorTexts, read_errors
from ..map_study import MapStudy, RobotStudy, cell_at
from ..parameters import Angles, Limit, Pose
from ..study import Say, radians, renamed, silent


_Cost: TypeAlias = Annotated[float, Limit(gt=0)]


@dataclasses.dataclass(frozen=True, kw_only=True)
class PlanStudy(RobotStudy):
    """Base class of studies of the plans of a bouncing robot, which chooses an angle per bump."""

    bounce: Angles
    """Bouncing angles to choose from, in degrees, counter-clockwise."""
    keep: _Cost = 1.0
    """Cost of a step, and of a bump with the same angle as the previous bump."""
    change: _Cost = 100.0
    """Cost of a bump with a different angle from the previous bump."""

    def needed(self, extent: "space.Extent") -> float | int:
        return space.estimates.plans(extent, self.motion)

    @property
    def choices(self) -> dict[str, Any]:
        """The bouncing angles, the costs and the motion, for functions of `jaxcell.bounce`."""
        return {
            "bounces": radians(self.bounce),
            "keep": _whole(self.keep),
            "change": _whole(self.change),
            "motion": self.motion,
        }


@dataclasses.dataclass(frozen=True, kw_only=True)
class Plans(PlanStudy, MapStudy):
    """Find the cost of the best plan of a bouncing robot between each pair of cells."""

    name: ClassVar[str] = "plans"
    task: ClassVar[str] = "plans"

    def run(self, say: Say = silent) -> Result:
        cells = self.cells()
        say(f"planning among all pairs of {cells.size:,} cells")
        with renamed(bounces="bounce"):
            return bouncing.all_plans(cells, **self.choices).cost_summary()

    def verify(self, result: Any) -> "Sequence[verification.Comparison]":
        return verification.compare_plan(result.costliest, self.motion)


@dataclasses.dataclass(frozen=True, kw_only=True)
class WayStudy(PlanStudy):
    """Base class of studies of the plan of a bouncing robot from a start to a goal."""

    start: Pose
    """Start of the robot: "x,y,heading" in m and degrees, or a cell number."""
    goal: Pose
    """Goal, in the same form as the start."""

    def plan(self, say: Say) -> "bouncing.Plan":
        """Find the plan with the least cost."""
        cells = self.cells()
        start, goal = (cell_at(cells, getattr(self, end), end) for end in ("start", "goal"))
        say(f"planning among {cells.size:,} cells")
        with renamed(bounces="bounce"):
            return bouncing.plan(cells, start=start, goal=goal, **self.choices)

    def verify(self, result: Any) -> "Sequence[verification.Comparison]":
        return verification.compare_plan(result, self.motion)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Navigate(WayStudy, MapStudy):
    """Plan how a bouncing robot, which chooses an angle at each bump, reaches a goal.

    `jaxcell navigate slip` is for robots that slip, and `navigate anywhere` for robots that start
    anywhere and do not know where they are."""

    name: ClassVar[str] = "navigation"
    command: ClassVar[str] = "navigate"
    example: ClassVar[str] = "@complex --bounce 45 90 135 --start 0.5,1.5,0 --goal 12.5,9.5,0"
    task: ClassVar[str] = "navigate"

    def run(self, say: Say = silent) -> "bouncing.Plan":
        return self.plan(say)


@dataclasses.dataclass(frozen=True, kw_only=True)
class NavigateSlip(WayStudy):
    """Find the probability that the plan of a robot that slips succeeds, and a policy that surely
    reaches the goal, if there is one."""

    name: ClassVar[str] = "navigation"
    command: ClassVar[str] = "navigate slip"
    example: ClassVar[str] = "@lab_a --bounce 45 135 --start 0 --goal 60 --errors slip=2%"
    task: ClassVar[str] = "navigate slip"

    errors: ErrorTexts
    """Error slip=2%: the common standard deviation of the relative errors of a step and of a turn,
    and of the drift of the heading in radians per metre."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self._slip()

    def _slip(self) -> float:
        return read_errors(self.errors, ("slip",), needed="slip")["slip"]

    def needed(self, extent: "space.Extent") -> float | int:
        from ...bounce.slip.fine_cells import most_cells, needed

        fine = needed(most_cells(self._slip()), angles=len(self.bounce))
        return super().needed(extent) + fine

    def run(self, say: Say = silent) -> Result:
        from .slipped_plan import slipped_plan

        return slipped_plan(self.plan(say), self._slip(), self.bounce, self.step, say)


def _whole(cost: float) -> int | float:
    """Convert a cost that is a whole number to `int`, so that sums of such costs are exact."""
    return int(cost) if cost == int(cost) else cost
