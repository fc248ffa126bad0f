import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import tyro

from ... import drift, space, verify as verification
from ...base import memory
from ..parameters import AtLeastOne, Days, Degrees, Headings, Limit, Only, Unit, WholeNumber
from ..study import Say, about, renamed, silent
from .sea_study import Bounds, Files, SeaStudy, degrees_of


_DAY = 86_400.0
# Longer times are refused; the long run is the default.
_MAX_MOVES = 10_000
# The suffixes of files of counts; and parameters that have an effect only on trajectories, or only
# on counts.
_COUNTS = (".npz", ".graphml")
_OF_TRACKS = ("lag", "cell", "bounds", "drogue", "max_speed", "samples", "seed")
_OF_COUNTS = ("from_", "to")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Drifters(SeaStudy):
    """Find where observed drifters end up, with sampling errors, from their trajectories."""

    name: ClassVar[str] = "drifters"
    command: ClassVar[str] = "drifters"
    example: ClassVar[str] = "@drifters --nearly-closed 2 --out runs/drifters"
    task: ClassVar[str] = "drifters"
    headings: ClassVar[Headings] = {
        "How is the file read?": ("max_speed",),
        "By which route, for counts?": ("from_", "to"),
        "How sure is it?": ("samples", "seed"),
    }

    file: tyro.conf.Positional[Files] = dataclasses.field(kw_only=False)
    """Trajectories: files (or a pattern of their names) of the Global Drifter Program, OpenDrift,
    Parcels or the CF convention, a Zarr store, an OPeNDAP address, or the bundled @drifters. Or one
    file of counts of moves between cells of any shape, .npz or .GraphML, or the bundled @gdp."""
    lag: Annotated[Days, Limit(gt=0)] = 5.0
    """Time in days between the two observations of a drifter that make up a move."""
    cell: Annotated[Degrees, Limit(gt=0, le=90)] = 1.0
    """Side of a cell in degrees of longitude and latitude."""
    bounds: Bounds | None = None
    """West, south, east and north limits of the region to divide into cells, in degrees. The region
    crosses the date line if the east limit is less than the west limit."""
    least: AtLeastOne = 1
    """Minimum number of observed moves from a cell; cells with fewer are left out of the map."""
    drogue: Literal["kept", "lost"] | None = None
    """Select drifters that still have their drogue (kept), or drifters that have lost it (lost) and
    so move with the wind too; by default all drifters."""
    after: Days | None = None
    """Time in days at which to compute the distribution of drifters; by default in the long run, or
    after ten years for counts."""
    from_: Annotated[str | None, tyro.conf.arg(name="from"), Only(to=True)] = None
    """Place where the most likely route begins, such as 90.9W,23.9N; only for counts."""
    to: Annotated[str | None, Only(from_=True)] = None
    """Place where the route ends; the route back is computed too."""
    nearly_closed: AtLeastOne | None = None
    """Number of nearly closed sets to find: parts of the water that drifters hardly leave."""
    samples: Annotated[int, Limit(ge=2)] = 100
    """Number of bootstrap samples of drifters, drawn with replacement, to estimate the errors."""
    seed: WholeNumber = 0
    """Seed of the bootstrap samples."""
    max_speed: Annotated[float, Unit("", "m/s"), Limit(gt=0)] = 10.0
    """Largest speed of a drifter in m/s; observations that need a larger one are left out."""

    def __post_init__(self) -> None:
        super().__post_init__()
        longest = _MAX_MOVES * self.lag
        after = f" days, {_MAX_MOVES:,} times the lag"
        Limit(gt=0, le=longest).check("after", self.after, after)
        default = {field.name: field.default for field in dataclasses.fields(self)}
        for name in _OF_COUNTS if self.counts is None else _OF_TRACKS:
            if getattr(self, name) != default[name]:
                kind = "trajectories" if self.counts is None else "counts of moves"
                raise ValueError(f"{name}: it has no effect on {kind}")
        for name in _OF_COUNTS:
            if (place := getattr(self, name)) is not None:
                degrees_of(name, place)

    @property
    def counts(self) -> Path | None:
        """The file of counts; `None` if the files have trajectories."""
        file = self.file if isinstance(self.file, tuple) else (self.file,)
        one = len(file) == 1 and isinstance(file[0], str | Path)
        return Path(file[0]) if one and Path(file[0]).suffix.lower() in _COUNTS else None

    def spec(self, result: Any) -> dict[str, Any]:
        idle = _OF_COUNTS if self.counts is None else _OF_TRACKS
        names = {self.spec_name(name) for name in idle}
        return {name: value for name, value in super().spec(result).items() if name not in names}

    def verify(self, result: Any) -> "Sequence[verification.Comparison]":
        if self.counts is not None:
            return verification.compare_counted_drift(result)
        return verification.compare_drift(result)

    def run(self, say: Say = silent) -> "drift.ObservedDrift | drift.CountedDrift":
        if self.counts is not None:
            return self._of_counts(self.counts, say)
        say("reading trajectories")
        seen = drift.open_trajectories(self.file, self.max_speed)
        if self.drogue is not None:
            with about("drogue"):
                seen = seen.with_drogue(self.drogue == "kept")
        water = drift.boxes(seen, self.cell, self.bounds)
        say(f"counting moves between {water.cells:,} cells")
        moves = drift.count_moves(seen, water, self.lag * _DAY, least=self.least)
        cells = moves.water.cells
        Limit(le=cells).check("nearly_closed", self.nearly_closed, ", the number of cells")
        needed = space.estimates.drift([cells]) + space.estimates.draws(cells, self.samples)
        memory.check(needed, f"drifters in {cells:,} cells", "give larger cells, or fewer samples")
        return drift.ObservedDrift.of(
            seen,
            moves,
            after=None if self.after is None else self.after * _DAY,
            sets=self.nearly_closed,
            samples=self.samples,
            seed=self.seed,
            say=say,
        )

    def _of_counts(self, file: Path, say: Say) -> "drift.CountedDrift":
        say("reading counts")
        counts = drift.open_counts(file, self.least)
        if self.least > 1 and not counts.counted:
            raise ValueError(f"least: it has no effect on shares of moves, got {self.least}")
        Limit(le=counts.cells).check("nearly_closed", self.nearly_closed, ", the number of cells")
        ends = {"source": ("from", self.from_), "target": ("to", self.to)}
        cells = {}
        for end, (name, place) in ends.items():
            if place is not None:
                with about(name):
                    cells[end] = counts.cell(*degrees_of(name, place))
        say(f"following drifters through {counts.cells:,} cells")
        after = None if self.after is None else self.after * _DAY
        with renamed(target="to"):
            return drift.CountedDrift.of(counts, after=after, sets=self.nearly_closed, **cells)
