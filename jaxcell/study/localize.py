import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from .map_study import MapStudy, cell_at
from .study import Degrees, Say, silent


if TYPE_CHECKING:
    from ..base.quantities import Result
    from ..bounce import AdaptivelyLocalized, Localized
    from ..space import CellSpace
    from ..space.extent import Extent
    from ..verify import Comparison


@dataclasses.dataclass(frozen=True, kw_only=True)
class Localize(MapStudy):
    """Build the localization filter of a map, or the policy of a robot that chooses among bouncing
    angles, and localize a simulated robot with it."""

    name: ClassVar[str] = "localization"

    bounce: Degrees | None = None
    """Bouncing angle in degrees, counter-clockwise."""
    bounces: tuple[Degrees, ...] = ()
    """Instead of one: bouncing angles to choose from at each bump."""
    goal: Literal["cell", "position", "class"] = "cell"
    """What a choice of angles is to find out: the cell, the position whatever the heading, or what
    these angles can tell apart."""
    aim: Literal["worst", "mean"] = "worst"
    """Whether it is to take few bumps at worst, or in the mean over all starts."""
    start: str | None = None
    """Start of the simulated robot: "x,y,heading" in m and degrees, or a cell; else random."""
    seed: int = 0
    """Seed of the random start."""
    open_world: bool = False
    """Give the filter a trap for observations that cannot occur on the map."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.bounce is None) == (not self.bounces):
            raise ValueError("bounce: expected one angle, or several in bounces")
        for name in ("goal", "aim"):
            if not self.bounces and getattr(self, name) != getattr(type(self), name):
                raise ValueError(f"{name}: it is for --bounces; one angle leaves no choice")
        if self.bounces and self.open_world:
            raise ValueError("open_world: it is for --bounce; a choice of angles always has a trap")

    def needed(self, extent: "Extent") -> float | int:
        from ..space import estimates

        if self.bounces:
            return estimates.plans(extent, **self.motion)
        return estimates.localization(extent, **self.motion)

    def spec(self, result: "Result") -> dict[str, Any]:
        absent = ("bounce_deg", "open_world") if self.bounces else ("bounces_deg", "goal", "aim")
        return {name: one for name, one in super().spec(result).items() if name not in absent}

    def run(self, say: Say = silent) -> "Localized | AdaptivelyLocalized":
        import numpy as np

        cells = self.cells()
        if self.start is None:
            start = int(np.random.default_rng(self.seed).integers(cells.size))
        else:
            start = cell_at(cells, self.start, "start")
        return self._choose(cells, start, say) if self.bounces else self._filter(cells, start, say)

    def _filter(self, cells: "CellSpace", start: int, say: Say) -> "Localized":
        from ..bounce import Localized, bounce_map, localization_filter, localize

        assert self.bounce is not None
        bounce = math.radians(self.bounce)
        say(f"mapping {cells.size:,} cells")
        mapped = bounce_map(cells, bounce, **self.motion)
        say(f"building the filter of {cells.size:,} cells")
        filter = localization_filter(mapped, open_world=self.open_world)
        return Localized(filter, cells, self.motion, bounce, localize(mapped, filter, start))

    def _choose(self, cells: "CellSpace", start: int, say: Say) -> "AdaptivelyLocalized":
        import numpy as np

        from ..bounce import AdaptivelyLocalized, localization_policy

        say(f"choosing angles for {cells.size:,} cells")
        policy = localization_policy(
            cells, np.radians(self.bounces), self.goal, aim=self.aim, **self.motion
        )
        return AdaptivelyLocalized.of(policy, start)

    def write(self, result: Any, out: Path) -> None:
        from .. import record

        spec = self.spec(result)
        if self.bounces:
            dataclasses.replace(result.policy, metadata=spec).save(out / "policy.jxf")
            return
        dataclasses.replace(result.filter, metadata=spec).save(out / "filter.jxf")
        record.save_dataset(record.dataset(result.groups, spec=spec), out / "groups.nc")

    def verify(self, result: Any) -> "Sequence[Comparison]":
        from ..bounce import bounce_map
        from ..verify import compare_filter, compare_groups, compare_policy

        if self.bounces:
            return compare_policy(result)
        mapped = bounce_map(result.cells, result.bounce, **self.motion)
        return [*compare_groups(result.groups), *compare_filter(result, mapped)]
