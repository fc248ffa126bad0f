import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar

from ... import bounce as bouncing, record, space, verify as verification
from ..map_study import MapStudy
from ..parameters import Degrees
from ..study import Say, radians, silent


MAX_AT_ONCE = 20_000_000
"""The largest number of pairs of cell and angle written as one dataset and one recording."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Groups(MapStudy):
    """Find the periodic groups of a bouncing robot, and the steps from every cell to its group.

    If there are more than 20 million pairs of cell and angle, results are written to a Zarr store,
    one direction at a time, instead of a dataset and a recording.
    """

    name: ClassVar[str] = "groups"
    command: ClassVar[str] = "groups"
    example: ClassVar[str] = "@lab_a --bounce 45 90 135"
    task: ClassVar[str] = "groups"
    batch: ClassVar[str | None] = "bounce"

    bounce: tuple[Degrees, ...]
    """Bouncing angles in degrees, counter-clockwise."""

    def needed(self, extent: "space.Extent") -> float | int:
        return space.estimates.counts(extent, self.motion)

    def written(self, extent: "space.Extent") -> float | int:
        if self._at_once(extent):
            return space.estimates.images(extent, len(self.bounce), self.motion)
        return space.estimates.by_direction(extent, self.motion)

    def at_once(self, result: Any) -> bool:
        return self._at_once(space.Extent.of(result.cells))

    def _at_once(self, extent: "space.Extent") -> bool:
        return extent.size * len(self.bounce) <= MAX_AT_ONCE

    def run(self, say: Say = silent) -> "bouncing.BounceGroups":
        cells = self.cells()
        say(f"mapping {len(self.bounce)} x {cells.size:,} cells")
        return bouncing.BounceGroups.of(cells, radians(self.bounce), motion=self.motion)

    def write(self, result: Any, out: Path) -> None:
        if not self.at_once(result):
            record.save_cells(result, out / "groups.zarr", spec=self.spec(result))

    def verify(self, result: Any) -> "Sequence[verification.Comparison]":
        return verification.compare_groups(result)
