import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from .anywhere import AnywhereStudy
from .map_study import Slip, cell_at
from .study import Degrees, Say, refuse, silent


if TYPE_CHECKING:
    from ..base.quantities import Result
    from ..bounce import AdaptivelyLocalized, Anywhere, Localized, OffsetLocalized, Slipped
    from ..space import CellSpace
    from ..space.extent import Extent
    from ..verify import Comparison


@dataclasses.dataclass(frozen=True, kw_only=True)
class Localize(AnywhereStudy):
    """Build the localization filter of a map, or the policy of a robot that chooses among bouncing
    angles, and localize a simulated robot with it."""

    name: ClassVar[str] = "localization"

    bounce: Degrees | None = None
    """Bouncing angle in degrees, counter-clockwise; it or --bounces is needed."""
    bounces: tuple[Degrees, ...] = ()
    """Instead of one: bouncing angles to choose from at each bump. A robot that slips takes the one
    after which its belief has the least entropy at the next bump, in the mean."""
    goal: Literal["cell", "position", "class"] = "cell"
    """What a choice of angles is to find out: the cell, the position whatever the heading, or what
    these angles can tell apart."""
    aim: Literal["worst", "mean"] = "worst"
    """Whether it is to take few bumps at worst, or in the mean over all starts."""
    start: str | None = None
    """Start of the simulated robot: "x,y,heading" in m and degrees, or a cell; else random."""
    offsets: bool = False
    """Put the robot down anywhere in a cell, where walls run along the edges of cells: the filter
    loses no robot whose walker knows the heading."""
    open_world: bool = False
    """Give the filter a trap for observations that cannot occur on the map."""
    slip: Slip | None = None
    """How much the robot slips: the relative error of its steps and turns, and its veer in radians
    a metre. Then a belief localizes it, in place of a filter."""
    bump_turn: Degrees = 0.0
    """With a slip: turn of the robot toward the wall by a bump at 45 degrees, unseen by its wheels,
    in degrees; at an incidence i it is sin(2 i) times as much."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.slip is not None and self.collision != "swept":
            raise ValueError("collision: expected 'swept' for a robot that slips, got 'endpoint'")
        if (self.bounce is None) == (not self.bounces):
            raise ValueError("bounce: expected one angle, or several in bounces")
        if self.anywhere:
            return
        if self.offsets:
            if self.bounces:
                raise ValueError("offsets: expected one angle, in bounce, got several")
            refuse(self, "with offsets", "collision", "start", "slip")
        if self.slip is not None:
            refuse(self, "for a robot that slips", "open_world", "goal", "aim")
            return
        refuse(self, "without a slip", "bump_turn")
        if self.bounces:
            refuse(self, "for several bounces, which always have a trap", "open_world")
        else:
            refuse(self, "for one angle, which leaves no choice", "goal", "aim")

    @property
    def of_cells(self) -> tuple[str, ...]:
        return (*super().of_cells, "open_world", "goal", "aim", "slip", "offsets")

    def needed(self, extent: "Extent") -> float | int:
        from ..space import estimates

        if self.anywhere:
            return 0
        if self.slip is not None:
            from ..bounce.slip.fine_cells import needed

            return needed(angles=max(1, len(self.bounces)))
        if self.bounces:
            return estimates.choice(extent, self.motion)
        return estimates.localization(extent, self.motion)

    @property
    def smaller(self) -> str:
        if self.bounces or self.slip is not None:
            return ""
        return "`jaxcell groups` writes the groups alone a direction at a time, or "

    def spec(self, result: "Result") -> dict[str, Any]:
        if self.anywhere:
            return super().spec(result)
        absent = {"bounce_deg", "open_world"} if self.bounces else {"bounces_deg", "goal", "aim"}
        if not self.offsets:
            absent |= {"offsets"}
        if self.slip is not None:
            absent |= {"goal", "aim"}
        elif self.bounces:
            absent |= {"slip"}
        return {name: one for name, one in super().spec(result).items() if name not in absent}

    def run(
        self, say: Say = silent
    ) -> "Localized | AdaptivelyLocalized | OffsetLocalized | Slipped | Anywhere":
        import numpy as np

        if self.anywhere:
            bounces = self.bounces if self.bounce is None else (self.bounce,)
            return self.localized_anywhere(bounces, self.start, say)
        cells = self.cells()
        if self.offsets:
            return self._at_any_offset(cells, say)
        if self.start is None:
            start = int(np.random.default_rng(self.seed).integers(cells.size))
        else:
            start = cell_at(cells, self.start, "start")
        if self.slip is not None:
            return self._slipped(cells, start, say)
        if self.bounces:
            return self._choose(cells, start, say)
        assert self.bounce is not None
        return self._filter(cells, math.radians(self.bounce), start, say)

    def _filter(self, cells: "CellSpace", bounce: float, start: int, say: Say) -> "Localized":
        from ..bounce import Localized, bounce_map, localization_filter, localize

        say(f"mapping {cells.size:,} cells")
        mapped = bounce_map(cells, bounce, motion=self.motion)
        say(f"building the filter of {cells.size:,} cells")
        filter = localization_filter(mapped, open_world=self.open_world)
        return Localized(filter, cells, self.motion, bounce, localize(mapped, filter, start))

    def _at_any_offset(self, cells: "CellSpace", say: Say) -> "OffsetLocalized":
        from ..bounce import OffsetLocalized, Offsets, localization_filter

        assert self.bounce is not None
        bounce = math.radians(self.bounce)
        say("finding the classes of offsets")
        offsets = Offsets.of(cells, motion=self.motion)
        mapped = offsets.bounce_map(bounce)
        say(f"building the filter of {mapped.image.size:,} configurations")
        filter = localization_filter(mapped, open_world=self.open_world)
        return OffsetLocalized(filter, cells, offsets, bounce)

    def _choose(self, cells: "CellSpace", start: int, say: Say) -> "AdaptivelyLocalized":
        import numpy as np

        from ..bounce import AdaptivelyLocalized, localization_policy

        say(f"choosing angles for {cells.size:,} cells")
        policy = localization_policy(
            cells, np.radians(self.bounces), self.goal, aim=self.aim, motion=self.motion
        )
        return AdaptivelyLocalized.of(policy, start)

    def _slipped(self, cells: "CellSpace", start: int, say: Say) -> "Slipped":
        import numpy as np

        from ..bounce import FineCells, slip_map, slipping_run
        from ..bounce.plans.roadmap import different_shifts
        from ..robot.emulation.body import bumper_give
        from ..space import Slip

        assert self.slip is not None
        bounces = np.radians(self.bounces if self.bounce is None else [self.bounce])
        if self.bounces:
            different_shifts(bounces, cells.directions)
        slip = Slip.of(
            self.slip, give=bumper_give(cells.cell), bump_turn=math.radians(self.bump_turn)
        )
        fine = FineCells.within(cells, slip)
        say(f"mapping {fine.size:,} fine cells")
        hidden = slip_map(fine, bounces.tolist(), slip, step=self.step)
        say("driving the robot")
        return slipping_run(
            hidden,
            cells,
            bounces,
            slip,
            start,
            seed=self.seed,
            step=self.step,
            fine_side=fine.fine.cell,
            fine_directions=fine.fine.directions,
        )

    def write(self, result: Any, out: Path) -> None:
        from .. import record

        spec = self.spec(result)
        if self.anywhere:
            self.save_task(result, out)
            return
        if self.slip is not None:
            dataclasses.replace(result.hidden, metadata=spec).save(out / "belief.jxb")
            return
        if self.bounces:
            dataclasses.replace(result.policy, metadata=spec).save(out / "policy.jxf")
            return
        if self.offsets:
            result.of_cells(spec).save(out / "filter.jxf")
            return
        dataclasses.replace(result.filter, metadata=spec).save(out / "filter.jxf")
        record.save_dataset(record.dataset(result.groups, spec=spec), out / "groups.nc")

    def verify(self, result: Any) -> "Sequence[Comparison]":
        from ..bounce import bounce_map
        from ..verify import compare_filter, compare_groups, compare_policy, compare_slip

        if self.anywhere:
            return []
        if self.slip is not None:
            return compare_slip(result)

        if self.bounces:
            return compare_policy(result)
        if self.offsets:
            return compare_filter(result, result.offsets.bounce_map(result.bounce))
        mapped = bounce_map(result.cells, result.bounce, motion=self.motion)
        return [*compare_groups(result.groups), *compare_filter(result, mapped)]
