import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, TypeAlias

from .anywhere import AnywhereStudy
from .map_study import MapStudy, Slip, cell_at
from .study import Degrees, Length, Limit, Say, numbers, refuse, silent


if TYPE_CHECKING:
    from ..base.quantities import Result
    from ..space.extent import Extent
    from ..verify import Comparison


_Cost: TypeAlias = Annotated[float, Limit("a finite cost above 0", lambda x: x > 0)]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Plans(MapStudy):
    """Find what the plans of a bouncing robot cost between all pairs of cells."""

    name: ClassVar[str] = "plans"

    bounces: tuple[Degrees, ...]
    """Bouncing angles to choose from, in degrees, counter-clockwise."""
    keep: _Cost = 1.0
    """What a step costs, and a bump with the same angle as the bump before."""
    change: _Cost = 100.0
    """What a bump with another angle costs."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.bounces:
            raise ValueError("bounces: expected at least one angle in degrees")

    def needed(self, extent: "Extent") -> float | int:
        from ..space import estimates

        return estimates.plans(extent, self.motion)

    def run(self, say: Say = silent) -> "Result":
        from ..bounce import all_plans

        cells = self.cells()
        say(f"planning among all pairs of {cells.size:,} cells")
        return all_plans(cells, **self.choices, motion=self.motion).cost_summary()

    @property
    def choices(self) -> dict[str, Any]:
        """What the robot chooses from, for the functions of `jaxcell.bounce`."""
        import numpy as np

        return {
            "bounces": np.radians(self.bounces),
            "keep": _whole(self.keep),
            "change": _whole(self.change),
        }

    def verify(self, result: Any) -> "Sequence[Comparison]":
        from ..verify import compare_plan

        return compare_plan(result.costliest, self.motion)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Navigate(AnywhereStudy, Plans):
    """Plan how a bouncing robot that chooses an angle at each bump gets to a goal."""

    name: ClassVar[str] = "navigation"

    start: str | None = None
    """Where the robot is: "x,y,heading" in m and degrees, or a cell."""
    goal: str
    """Where it is to be, as for the start; for robots that start anywhere "x,y" in m."""
    goal_radius: Length | None = None
    """Distance from the goal within which a robot that starts anywhere is home, in metres; by
    default a cell, or half a metre where cells are smaller."""
    slip: Slip | None = None
    """How much the robot slips, as for `jaxcell localize`: then also how probable it is that the
    plan arrives, and the policy that surely does."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.anywhere:
            refuse(self, "without anywhere", "goal_radius")
            if self.start is None:
                raise ValueError("start: expected where the robot is, or --anywhere")
        if self.slip is not None and self.collision != "swept":
            raise ValueError("collision: expected 'swept' for a robot that slips, got 'endpoint'")

    @property
    def of_cells(self) -> tuple[str, ...]:
        return (*super().of_cells, "slip", "keep", "change")

    def needed(self, extent: "Extent") -> float | int:
        if self.slip is None:
            return super().needed(extent)
        from ..bounce.slip.fine_cells import needed

        return super().needed(extent) + needed(angles=len(self.bounces))

    def run(self, say: Say = silent) -> "Result":
        from ..bounce import plan

        if self.anywhere:
            return self._home(say)
        cells = self.cells()
        start, goal = (cell_at(cells, getattr(self, end), end) for end in ("start", "goal"))
        say(f"planning among {cells.size:,} cells")
        found = plan(cells, start=start, goal=goal, **self.choices, motion=self.motion)
        if self.slip is None:
            return found
        from .slipped_plan import slipped_plan

        return slipped_plan(found, self.slip, self.bounces, self.step, say)

    def spec(self, result: "Result") -> dict[str, Any]:
        spec = super().spec(result)
        absent = () if self.anywhere else ("goal_radius_m", "seed")
        return {name: spec[name] for name in spec if name not in absent}

    def _home(self, say: Say) -> "Result":
        x, y = numbers("goal", self.goal, 2, '"x,y" in metres, for robots that start anywhere')
        radius = max(self.cells().cell, 0.5) if self.goal_radius is None else self.goal_radius
        return self.home_from_anywhere(self.bounces, (x, y), radius, self.start, say)

    def write(self, result: Any, out: Path) -> None:
        if self.anywhere:
            self.save_task(result, out)

    def verify(self, result: Any) -> "Sequence[Comparison]":
        from ..verify import compare_plan

        return [] if self.anywhere else compare_plan(result, self.motion)


def _whole(cost: float) -> int | float:
    """A whole number if it is one: plans of whole costs cost whole numbers."""
    return int(cost) if cost == int(cost) else cost
