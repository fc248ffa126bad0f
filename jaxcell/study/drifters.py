import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, TypeAlias

import tyro

from .sea_study import Count, SeaStudy
from .study import Days, Degrees, Limit, Say, WholeNumber, require, silent


if TYPE_CHECKING:
    from ..drift import ObservedDrift


_DAY = 86_400.0
# Later is the long run, which is the default.
_MAX_MOVES = 10_000
_Side: TypeAlias = Annotated[
    Degrees, Limit("more than 0 and at most 90 degrees", lambda x: 0 < x <= 90)
]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Drifters(SeaStudy):
    """Find where observed drifters end up, and how sure that is, from their trajectories."""

    name: ClassVar[str] = "drifters"

    file: tyro.conf.Positional[tuple[Path, ...]]
    """Trajectories of the Global Drifter Program, OpenDrift, Parcels or any CF file of them, a
    pattern, a Zarr store, an address of OPeNDAP, or @drifters."""
    lag: Annotated[Days, Limit("more than 0 days", lambda x: x > 0)] = 5.0
    """Days that a move takes."""
    cell: _Side = 1.0
    """Side of a cell of longitude and latitude."""
    bounds: tuple[float, float, float, float] | None = None
    """West, south, east and north of the part to cut into cells, in degrees; drifters may go
    through the date line."""
    least: Count = 1
    """Moves that must be known from a cell; cells of fewer are off the map."""
    after: Days | None = None
    """Days after which it is asked where drifters are; by default in the long run."""
    nearly_closed: Count | None = None
    """How many parts of the water to find that drifters hardly leave."""
    samples: Annotated[int, Limit("2 or more", lambda n: n >= 2)] = 100
    """How often drifters are drawn anew, with replacement, for the errors."""
    seed: WholeNumber = 0
    """Seed of these draws."""

    def __post_init__(self) -> None:
        super().__post_init__()
        longest = _MAX_MOVES * self.lag
        expected = f"more than 0 and at most {longest:g} days, {_MAX_MOVES:,} times the lag"
        require("after", self.after, expected, lambda x: 0 < x <= longest)

    def run(self, say: Say = silent) -> "ObservedDrift":
        from ..base import memory
        from ..drift import ObservedDrift, boxes, count_moves, open_trajectories
        from ..space import estimates

        say("reading trajectories")
        seen = open_trajectories(self.file)
        water = boxes(seen, self.cell, self.bounds)
        say(f"counting moves between {water.cells:,} cells")
        moves = count_moves(seen, water, self.lag * _DAY, least=self.least)
        cells = moves.water.cells
        expected = f"at most {cells}, the cells"
        require("nearly_closed", self.nearly_closed, expected, lambda n: n <= cells)
        needed = estimates.drift([cells]) + estimates.draws(cells, self.samples)
        memory.check(needed, f"drifters in {cells:,} cells", "give larger cells, or fewer samples")
        return ObservedDrift.of(
            seen,
            moves,
            after=None if self.after is None else self.after * _DAY,
            sets=self.nearly_closed,
            samples=self.samples,
            seed=self.seed,
            say=say,
        )
