import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, TypeAlias

from .map_study import MapStudy, Slip, cell_at
from .study import Degrees, Limit, Say, silent


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

        return estimates.plans(extent, **self.motion)

    def run(self, say: Say = silent) -> "Result":
        from ..bounce import all_plans

        cells = self.cells()
        say(f"planning among all pairs of {cells.size:,} cells")
        return all_plans(cells, **self.choices, **self.motion).cost_summary()

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

        return compare_plan(result.costliest, **self.motion)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Navigate(Plans):
    """Plan how a bouncing robot that chooses an angle at each bump gets to a goal."""

    name: ClassVar[str] = "navigation"

    start: str
    """Where the robot is: "x,y,heading" in m and degrees, or a cell."""
    goal: str
    """Where it is to be, as for the start."""
    slip: Slip | None = None
    """How much the robot slips, as for `jaxcell localize`: then also how probable it is that the
    plan arrives, and the policy that surely does."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.slip is not None and self.collision != "swept":
            raise ValueError("collision: expected 'swept' for a robot that slips, got 'endpoint'")

    def needed(self, extent: "Extent") -> float | int:
        if self.slip is None:
            return super().needed(extent)
        from ..bounce.slip.fine_cells import needed

        return super().needed(extent) + needed(angles=len(self.bounces))

    def run(self, say: Say = silent) -> "Result":
        from ..bounce import plan

        cells = self.cells()
        start, goal = (cell_at(cells, getattr(self, end), end) for end in ("start", "goal"))
        say(f"planning among {cells.size:,} cells")
        found = plan(cells, start=start, goal=goal, **self.choices, **self.motion)
        if self.slip is None:
            return found
        from .slipped_plan import slipped_plan

        return slipped_plan(found, self.slip, self.bounces, self.step, say)

    def verify(self, result: Any) -> "Sequence[Comparison]":
        from ..verify import compare_plan

        return compare_plan(result, **self.motion)


def _whole(cost: float) -> int | float:
    """A whole number if it is one: plans of whole costs cost whole numbers."""
    return int(cost) if cost == int(cost) else cost
