import dataclasses
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from ..map_study import MapStudy
from ..parameters import AtLeastOne, Degrees, Limit
from ..study import Say, silent


if TYPE_CHECKING:
    from ...bounce import CoveragePolicy
    from ...space.extent import Extent
    from ...verify import Comparison


@dataclasses.dataclass(frozen=True, kw_only=True)
class Cover(MapStudy):
    """Find the shares of time of bouncing angles with which an imprecise robot covers a map."""

    name: ClassVar[str] = "coverage"
    command: ClassVar[str] = "cover"
    example: ClassVar[str] = "@complex --bounces 30 75 315 --error 5 --reliability 0.8"
    task: ClassVar[str] = "cover"

    bounces: tuple[Degrees, ...]
    """Bouncing angles in degrees, counter-clockwise."""
    error: Annotated[Degrees, Limit(ge=0)]
    """Largest error of a turn in degrees: a multiple of the angle between directions."""
    reliability: Annotated[float, Limit(gt=0, le=1)]
    """Probability of a turn without error."""
    target: str = "uniform"
    """Shares of time to reach: uniform, an image (brighter parts get more), or FILE.nc:VARIABLE."""
    weights: Literal["basin", "size"] = "basin"
    """Weight of each persistent group of an angle: the probability of ending in it (basin), or its
    number of cells (size)."""
    directions: AtLeastOne | None = 360
    """Number of directions."""

    def check_files(self) -> None:
        from .target import check_target

        super().check_files()
        check_target(self.target)

    def needed(self, extent: "Extent") -> float | int:
        from ...space import estimates

        # No more turns than directions, whatever the error.
        spread = min(max(self.error * extent.directions / 360, 0), extent.directions)
        branches = 1 + 2 * round(spread)
        angles = len(self.bounces)
        return estimates.coverage(extent, self.motion, angles=angles, branches=branches)

    def run(self, say: Say = silent) -> "CoveragePolicy":
        import numpy as np

        from ...bounce import coverage_policy
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
        from ...verify import compare_coverage

        error = math.radians(self.error)
        return compare_coverage(
            result, error, self.reliability, weights=self.weights, motion=self.motion
        )
