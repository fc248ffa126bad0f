import dataclasses
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from .map_study import MapStudy
from .study import AtLeastOne, Degrees, Limit, Say, silent


if TYPE_CHECKING:
    from ..bounce import CoveragePolicy
    from ..space.extent import Extent
    from ..verify import Comparison


@dataclasses.dataclass(frozen=True, kw_only=True)
class Cover(MapStudy):
    """Find the shares of time of bouncing angles with which an imprecise robot covers a map."""

    name: ClassVar[str] = "coverage"

    bounces: tuple[Degrees, ...]
    """Bouncing angles in degrees, counter-clockwise."""
    error: Annotated[Degrees, Limit("a whole number of directions", lambda x: x >= 0)]
    """Largest error of a turn in degrees, a whole number of directions."""
    reliability: Annotated[float, Limit("above 0 and at most 1", lambda x: 0 < x <= 1)]
    """Probability of a turn without error, above 0 and at most 1."""
    target: str = "uniform"
    """What to cover: uniform, an image whose bright parts are worth more, or FILE.nc:VARIABLE."""
    weights: Literal["basin", "size"] = "basin"
    """What persistent groups of an angle weigh: the chance of ending there, or their cells."""
    directions: AtLeastOne | None = 360
    """Number of directions."""

    def check_files(self) -> None:
        from .target import check_target

        super().check_files()
        check_target(self.target)

    def needed(self, extent: "Extent") -> float | int:
        from ..space import estimates

        # No more turns than directions, whatever the error.
        spread = min(max(self.error * extent.directions / 360, 0), extent.directions)
        branches = 1 + 2 * round(spread)
        angles = len(self.bounces)
        return estimates.coverage(extent, self.motion, angles=angles, branches=branches)

    def run(self, say: Say = silent) -> "CoveragePolicy":
        import numpy as np

        from ..bounce import coverage_policy
        from .target import read_target

        cells = self.cells()
        doing = (
            f"covering {cells.positions:,} positions by {len(self.bounces)} angles, "
            f"{cells.size:,} cells each"
        )
        say(doing)
        count = len(self.bounces)
        return coverage_policy(
            cells,
            np.radians(self.bounces),
            float(np.radians(self.error)),
            self.reliability,
            read_target(cells, self.target),
            weights=self.weights,
            motion=self.motion,
            progress=lambda done: say(doing, done, count),
        )

    def verify(self, result: Any) -> "Sequence[Comparison]":
        from ..verify import compare_coverage

        error = math.radians(self.error)
        return compare_coverage(
            result, error, self.reliability, weights=self.weights, motion=self.motion
        )
