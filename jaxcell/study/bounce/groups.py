import dataclasses
import functools
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from ...base import memory
from ..map_study import MapStudy
from ..parameters import Degrees
from ..study import Say, silent


if TYPE_CHECKING:
    from ...bounce import BounceGroups
    from ...space.extent import Extent
    from ...verify import Comparison


MAX_AT_ONCE = 20_000_000
"""The most cells that are held at once, written to one dataset, and drawn."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Groups(MapStudy):
    """Find the periodic groups of a bouncing robot and how every cell reaches them.

    More than 20 million cells, or more than fit in memory, are written one direction at a time to a
    Zarr store, in place of a dataset and a recording.
    """

    name: ClassVar[str] = "groups"
    command: ClassVar[str] = "groups"
    example: ClassVar[str] = "@lab_a --bounce 45 90 135"
    task: ClassVar[str] = "groups"
    batch: ClassVar[str | None] = "bounce"

    bounce: tuple[Degrees, ...]
    """Bouncing angles in degrees, counter-clockwise."""

    def needed(self, extent: "Extent") -> float | int:
        from ...space import estimates

        return estimates.counts(extent, self.motion)

    def written(self, extent: "Extent") -> float | int:
        from ...space import estimates

        angles = len(self.bounce)
        if self._at_once(extent):
            return estimates.images(extent, angles, self.motion)
        return estimates.by_direction(extent, self.motion)

    def at_once(self, result: Any) -> bool:
        from ...space.extent import Extent

        return self._at_once(Extent.of(result.cells))

    def _at_once(self, extent: "Extent") -> bool:
        from ...space import estimates

        angles = len(self.bounce)
        needed = estimates.images(extent, angles, self.motion)
        return extent.size * angles <= MAX_AT_ONCE and (self._free is None or needed <= self._free)

    @functools.cached_property
    def _free(self) -> int | None:
        """The memory that is free at the first call, which decides how results are written."""
        return memory.free()

    def run(self, say: Say = silent) -> "BounceGroups":
        import numpy as np

        from ...bounce import BounceGroups

        cells = self.cells()
        say(f"mapping {len(self.bounce)} x {cells.size:,} cells")
        return BounceGroups.of(cells, np.radians(self.bounce), motion=self.motion)

    def write(self, result: Any, out: Path) -> None:
        from ... import record

        if not self.at_once(result):
            record.save_cells(result, out / "groups.zarr", spec=self.spec(result))

    def verify(self, result: Any) -> "Sequence[Comparison]":
        from ...verify import compare_groups

        return compare_groups(result)
