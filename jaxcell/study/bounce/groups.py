import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from ... import bounce as bouncing, record, space, verify as verification
from ..map_study import MapStudy
from ..parameters import Angles
from ..study import Say, Wanted, every, one_each, radians, scalars, silent


if TYPE_CHECKING:
    import numpy as np

    from ...base.quantities import Quantity


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
    varied: ClassVar[tuple[str, ...]] = ("bounce",)

    bounce: Angles
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

    def numbers(
        self, columns: "Mapping[str, np.ndarray]", wanted: Wanted = every
    ) -> "dict[str, tuple[Quantity, np.ndarray]]":
        import numpy as np

        angle, which = np.unique(one_each("bounce", columns, self.bounce), return_inverse=True)
        result = dataclasses.replace(self, bounce=tuple(angle.tolist())).run()
        return {
            name: (about, value[which] if about.dims else value)
            for name, (about, value) in scalars(result, ("bounce",), wanted).items()
        }

    def write(self, result: Any, out: Path) -> None:
        if not self.at_once(result):
            record.save_cells(result, out / "groups.zarr", spec=self.spec(result))

    def verify(self, result: Any) -> "Sequence[verification.Comparison]":
        return verification.compare_groups(result)
