import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, ClassVar

from .map_study import MapStudy
from .study import Degrees, Say, silent


if TYPE_CHECKING:
    from ..bounce import BounceGroups
    from ..space.extent import Extent
    from ..verify import Comparison


@dataclasses.dataclass(frozen=True, kw_only=True)
class Groups(MapStudy):
    """Find the periodic groups of a bouncing robot and how every cell reaches them."""

    name: ClassVar[str] = "groups"
    batch: ClassVar[str | None] = "bounce"

    bounce: tuple[Degrees, ...]
    """Bouncing angles in degrees, counter-clockwise; several make one batched run."""

    def needed(self, extent: "Extent") -> float | int:
        from ..space import estimates

        return estimates.counts(extent, **self.motion)

    def written(self, extent: "Extent") -> float | int:
        from ..space import estimates

        return estimates.images(extent, len(self.bounce), **self.motion)

    def run(self, say: Say = silent) -> "BounceGroups":
        if not self.bounce:
            raise ValueError("bounce: expected at least one angle in degrees")
        import numpy as np

        from ..bounce import BounceGroups

        cells = self.cells()
        say(f"mapping {len(self.bounce)} x {cells.size:,} cells")
        return BounceGroups.of(cells, np.radians(self.bounce), **self.motion)

    def verify(self, result: Any) -> "Sequence[Comparison]":
        from ..verify import compare_groups

        return compare_groups(result)
