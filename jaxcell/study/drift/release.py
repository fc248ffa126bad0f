import dataclasses
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import tyro

from ... import drift, record
from ...base import memory
from ...base.optional_modules import has_module
from ...base.paths import existing
from ..parameters import Days, Duration, Headings, Length, Limit, Only
from ..study import Say, about, numbers, silent
from .sea_study import DAY, Source, WindowStudy, later


if TYPE_CHECKING:
    import numpy as np


# The number of times of an answer for less than two days.
_TIMES = 8
# Bytes per drifter and time: its place, its cell, and whether it is stranded, twice.
_BYTES = 42


@dataclasses.dataclass(frozen=True, kw_only=True)
class Release(WindowStudy):
    """Find where drifters from one place are after some days, and which coast they reach when."""

    name: ClassVar[str] = "release"
    command: ClassVar[str] = "release"
    example: ClassVar[str] = "@gyres --start=-117.93,33.5 --until 0.5 --out runs/release"
    task: ClassVar[str] = "release"
    headings: ClassVar[Headings] = {
        "Which current carries them?": (
            *("grid", "depth", "bounds", "variables"),
            *("windage", "stokes", "land", "gaps", "coast", "diffusivity"),
        ),
        "How many, and what becomes of them?": (
            *("precision", "beaching", "resuspension", "seed"),
        ),
    }

    file: tyro.conf.Positional[Source] = dataclasses.field(kw_only=False)
    """Currents: NetCDF files (one per period, or one for u and one for v), a pattern such as
    "2016_*.nc", a Zarr store, an OPeNDAP address, or the bundled @gyres."""
    start: str
    """Place of the release: "lon,lat" in degrees, or a GeoJSON file of polygons, in which
    drifters are released uniformly."""
    radius: Length | None = None
    """Radius in metres of the disc around `start` in which drifters are released. By default it is
    a square of the size of a cell."""
    every: Annotated[Days | None, Limit(gt=0), Only(backward=False)] = None
    """Release drifters again and again, each of these days, through the period `on`, and follow
    each release for `until` days: the answer is the mean over the releases."""
    backward: bool = False
    """Find where drifters come from that are found at `start` at the time `on`, `until` days
    before."""
    at: tuple[Annotated[Days, Limit(gt=0)], ...] = ()
    """Times in days after the release at which to answer, at most `until`; by default each whole
    day, or eight times if `until` is less than two days."""
    regions: Path | None = None
    """GeoJSON file of polygons at which drifters may arrive, beside the coast."""
    precision: Annotated[float, Limit(ge=0.0005, le=0.2)] = 0.01
    """Half width of the 95 % interval of a probability, which determines the number of drifters."""
    beaching: Annotated[Duration | None, Only(coast=("hold", "slip"))] = None
    """Time in seconds after which half of the drifters in coastal cells have stranded."""
    resuspension: Annotated[Duration | None, Only(beaching=True)] = None
    """Time in seconds in which half of the drifters on a beach float again; by default they never
    float again."""
    seed: int = 0
    """Seed of the places of release, of diffusion and of beaching."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.backward and (self.on is None or self.period is not None):
            raise ValueError(f"on: expected the time of the find, got {self.on}")
        if self.backward and self.coast == "strand":
            raise ValueError(
                "coast: expected hold or slip with backward, and `beaching`, got strand"
            )
        if any(time > self.days for time in self.at):
            raise ValueError(f"at: expected times up to {self.days:g} days, got {max(self.at):g}")

    def check_files(self) -> None:
        super().check_files()
        if self._place is None:
            existing(Path(self.start))

    def check_time(self) -> None:
        if self.every is None:
            super().check_time()
        elif self.until is None or self.period is None:
            raise ValueError("every: expected a month or a period as `on`, and `until`")

    @property
    def starts(self) -> list[float]:
        """The days from the first release to each release."""
        if self.every is None or self.period is None:
            return [0.0]
        import numpy as np

        length = float((self.period[1] - self.period[0]) / np.timedelta64(1, "D"))
        return [self.every * k for k in range(math.ceil(length / self.every - 1e-9))]

    def span(self, first: "np.datetime64") -> "tuple[np.datetime64, np.datetime64]":
        on, end = super().span(first)
        if self.backward:
            return later(on, -self.days), on
        return on, later(end, self.starts[-1])

    @property
    def times(self) -> list[float]:
        """The times of the answer, in seconds after the release."""
        if self.at:
            return [DAY * time for time in sorted({*self.at, self.days})]
        if self.days < 2:
            return [DAY * self.days * (k + 1) / _TIMES for k in range(_TIMES)]
        return [DAY * day for day in (*range(1, math.ceil(self.days)), self.days)]

    def run(self, say: Say = silent) -> "drift.Released":
        import numpy as np

        from ...base.intervals import drifters_for
        from ...drift import released_drifters as of
        from ...drift.regions import read_polygons

        on, since, currents = self.window()
        water = drift.Water.of(currents, 0, self.coast)
        flow = drift.Flow.of(currents, 0, diffusivity=self.diffusivity, coast=self.coast)
        count, random = drifters_for(self.precision), np.random.default_rng(self.seed)
        count = len(self.starts) * math.ceil(count / len(self.starts))
        looks = len(self.times)
        if self.backward:
            looks += math.ceil(self.days * DAY / of.tick_of(water, flow))
        doing = f"{count:,} drifters at {len(self.times)} times"
        memory.check(_BYTES * count * looks, doing, "give a larger --precision")
        with about(f"start {self.start}"):
            if (place := self._place) is None:
                polygons = read_polygons(self.start)[1]
                points = of.points_in(random, water, polygons, count)
                area = of.area_of(water, polygons)
                around = f"in the polygons of {Path(self.start).name}"
            else:
                points = of.points_around(random, water, place, count, self.radius)
                area = of.area_around(water, place, self.radius)
                around = self._around(water, place)
        given: dict[str, Any] = {
            "regions": None if self.regions is None else read_polygons(self.regions),
            "afloat": self.beaching or math.inf,
            "stranded": self.resuspension or math.inf,
            "seed": self.seed,
            "say": say,
            "on": self.moment if self.backward else on,
            "around": around,
            "source": str(currents.attrs["source"]),
            "coastline": str(currents.attrs.get("coastline", "")),
            "notices": self.notices(on, currents),
        }
        starts = [since + DAY * day for day in self.starts]
        if self.backward:
            given["found"], starts = area, [since + DAY * self.days]
        return drift.Released.of(water, flow, points, self.times, starts=starts, **given)

    def write(self, result: "drift.Released", out: Path) -> None:
        record.save_release(result, out / "release.geojson")
        if has_module("matplotlib"):
            record.save_sea(result, out / "release.png")

    @property
    def _place(self) -> tuple[float, float] | None:
        """The longitude and latitude of the release; `None` for polygons of a file."""
        if self.start.endswith((".geojson", ".json")):
            return None
        lon, lat = numbers("start", self.start, ("deg", "deg"), '"lon,lat" in degrees or a file')
        return lon, lat

    def _around(self, water: "drift.Water", place: tuple[float, float]) -> str:
        """Describe the place of the release."""
        from ...drift.results.sentences import name_place

        if self.radius is not None:
            return f"within {self.radius / 1000:.3g} km of {name_place(*place)}"
        dx, dy = (water.sides[:, water.cell(*place)] / 1000).tolist()
        return f"in the {dx:.3g} x {dy:.3g} km around {name_place(*place)}"
