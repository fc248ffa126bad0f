import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from .map_study import MapStudy, cell_at
from .study import Degrees, Say, silent


if TYPE_CHECKING:
    from ..bounce import Localized
    from ..space.extent import Extent
    from ..verify import Comparison


@dataclasses.dataclass(frozen=True, kw_only=True)
class Localize(MapStudy):
    """Build the localization filter of a map, and localize a simulated robot with it."""

    name: ClassVar[str] = "localization"

    bounce: Degrees
    """Bouncing angle in degrees, counter-clockwise."""
    start: str | None = None
    """Start of the simulated robot: "x,y,heading" in m and degrees, or a cell; else random."""
    seed: int = 0
    """Seed of the random start."""
    open_world: bool = False
    """Give the filter a trap for observations that cannot occur on the map."""

    def needed(self, extent: "Extent") -> float | int:
        from ..space import estimates

        return estimates.localization(extent, **self.motion)

    def run(self, say: Say = silent) -> "Localized":
        import numpy as np

        from ..bounce import Localized, bounce_map, localization_filter, localize

        cells = self.cells()
        if self.start is None:
            start = int(np.random.default_rng(self.seed).integers(cells.size))
        else:
            start = cell_at(cells, self.start, "start")
        bounce = math.radians(self.bounce)
        say(f"mapping {cells.size:,} cells")
        mapped = bounce_map(cells, bounce, **self.motion)
        say(f"building the filter of {cells.size:,} cells")
        filter = localization_filter(mapped, open_world=self.open_world)
        return Localized(filter, cells, self.motion, bounce, localize(mapped, filter, start))

    def write(self, result: Any, out: Path) -> None:
        from .. import record

        spec = self.spec(result)
        dataclasses.replace(result.filter, metadata=spec).save(out / "filter.jxf")
        record.save_dataset(record.dataset(result.groups, spec=spec), out / "groups.nc")

    def verify(self, result: Any) -> "Sequence[Comparison]":
        from ..bounce import bounce_map
        from ..verify import compare_filter, compare_groups

        mapped = bounce_map(result.cells, result.bounce, **self.motion)
        return [*compare_groups(result.groups), *compare_filter(result, mapped)]
