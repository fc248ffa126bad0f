import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from .map_study import MapStudy, cell_at
from .study import Degrees, Say, require, silent


if TYPE_CHECKING:
    from ..bounce import Localized, Slipped
    from ..space import CellSpace
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
    slip: float | None = None
    """How much the robot slips: the relative error of its steps and turns, and its veer in radians
    a metre. Then a belief localizes it, in place of a filter."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require("slip", self.slip, "a number from 0 to 1", lambda x: 0 <= x <= 1)
        if self.slip is not None and self.open_world:
            raise ValueError("open_world: a belief has no trap; expected no slip with it")
        if self.slip is not None and self.collision != "swept":
            raise ValueError("collision: expected 'swept' for a robot that slips, got 'endpoint'")

    def needed(self, extent: "Extent") -> float | int:
        from ..space import estimates

        if self.slip is not None:
            from ..bounce.slip import needed

            return needed()
        return estimates.localization(extent, **self.motion)

    def run(self, say: Say = silent) -> "Localized | Slipped":
        import numpy as np

        from ..bounce import Localized, bounce_map, localization_filter, localize

        cells = self.cells()
        if self.start is None:
            start = int(np.random.default_rng(self.seed).integers(cells.size))
        else:
            start = cell_at(cells, self.start, "start")
        bounce = math.radians(self.bounce)
        if self.slip is not None:
            return self._slipped(cells, bounce, start, say)
        say(f"mapping {cells.size:,} cells")
        mapped = bounce_map(cells, bounce, **self.motion)
        say(f"building the filter of {cells.size:,} cells")
        filter = localization_filter(mapped, open_world=self.open_world)
        return Localized(filter, cells, self.motion, bounce, localize(mapped, filter, start))

    def _slipped(self, cells: "CellSpace", bounce: float, start: int, say: Say) -> "Slipped":
        from ..automata import HiddenMap
        from ..bounce import FineCells, slip_matrices, slipping_run
        from ..robot.emulation.body import bumper_give
        from ..space import Slip

        assert self.slip is not None
        slip = Slip.of(self.slip, give=bumper_give(cells.cell))
        fine = FineCells.within(cells, slip)
        say(f"mapping {fine.size:,} fine cells")
        matrices = slip_matrices(fine, bounce, slip, step=self.step)
        hidden = HiddenMap.of(*matrices, fine.coarse, fine.centres)
        say("driving the robot")
        return slipping_run(
            hidden,
            cells,
            bounce,
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
        if self.slip is not None:
            dataclasses.replace(result.hidden, metadata=spec).save(out / "belief.jxb")
            return
        dataclasses.replace(result.filter, metadata=spec).save(out / "filter.jxf")
        record.save_dataset(record.dataset(result.groups, spec=spec), out / "groups.nc")

    def verify(self, result: Any) -> "Sequence[Comparison]":
        from ..bounce import bounce_map
        from ..verify import compare_filter, compare_groups, compare_slip

        if self.slip is not None:
            return compare_slip(result)

        mapped = bounce_map(result.cells, result.bounce, **self.motion)
        return [*compare_groups(result.groups), *compare_filter(result, mapped)]
