import dataclasses
from pathlib import Path
from typing import ClassVar, Literal

import tyro

from ... import drift, record
from ...base import memory
from ...base.optional_modules import has_module
from ..parameters import AtLeastOne, Headings, Limit
from ..study import Say, silent
from .sea_study import DAY, Source, WindowStudy


# Bytes per drifter and cell that it visits, nine drifters from each cell; and per drop and cell.
_VISIT, _DRIFTERS, _DROP = 60, 9, 24


@dataclasses.dataclass(frozen=True, kw_only=True)
class Deploy(WindowStudy):
    """Find where to drop some drifters, so that they visit as many cells as possible in a time."""

    name: ClassVar[str] = "deploy"
    command: ClassVar[str] = "deploy"
    example: ClassVar[str] = "@gyres --drop 5 --until 0.5 --out runs/deploy"
    task: ClassVar[str] = "deploy"
    headings: ClassVar[Headings] = {
        "Which current carries them?": (
            *("grid", "depth", "bounds", "variables"),
            *("windage", "stokes", "land", "gaps", "coast", "diffusivity", "seed"),
        ),
    }

    file: tyro.conf.Positional[Source] = dataclasses.field(kw_only=False)
    """Currents: NetCDF files (one per period, or one for u and one for v), a pattern such as
    "2016_*.nc", a Zarr store, an OPeNDAP address, or the bundled @gyres."""
    drop: AtLeastOne
    """Number of drifters to drop."""
    cover: Path | None = None
    """GeoJSON file of polygons, whose cells, by their centres, are to be visited; by default all
    water."""
    avoid: tuple[Literal["land", "edge"], ...] = ()
    """Leave out cells from which drifters strand (land), or leave the map (edge)."""
    coast: Literal["hold", "slip", "strand"] = "strand"
    """Rule for drifters that run ashore: they strand (strand), or they stay at the coast until the
    current carries them off, and water slows down towards land (hold) or flows along it without
    friction (slip)."""
    seed: int = 0
    """Seed of diffusion, and of the places in a cell."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if "land" in self.avoid and self.coast != "strand":
            raise ValueError(f"avoid: expected land only with `coast` strand, got {self.coast}")

    def run(self, say: Say = silent) -> "drift.Dropped":
        import numpy as np

        on, since, currents = self.window()
        water = drift.Water.of(currents, 0, self.coast)
        flow = drift.Flow.of(currents, 0, diffusivity=self.diffusivity, coast=self.coast)
        Limit(le=water.cells).check("drop", self.drop, ", the number of cells")
        visits = 1 + self.days * DAY / drift.crossing_time(water, flow)
        needed = water.cells * (_VISIT * _DRIFTERS * visits + _DROP * self.drop)
        doing = f"drifters from {water.cells:,} cells for {self.days:g} days"
        memory.check(needed, doing, "give smaller --bounds, or fewer days")
        regions, region = np.ones((1, water.cells), bool), "the water"
        if self.cover is not None:
            regions, region = (
                drift.read_regions(self.cover, water)[1],
                f"{self.cover.name}, whose centre is in it,",
            )
        return drift.Dropped.of(
            water, flow, np.logical_or.reduce(regions), self.drop, self.days * DAY,
            avoid=self.avoid,
            start=since,
            seed=self.seed,
            say=say,
            on=on,
            region=region,
            coastline=str(currents.attrs.get("coastline", "")),
            notices=self.notices(on, currents),
        )  # fmt: skip

    def write(self, result: "drift.Dropped", out: Path) -> None:
        record.save_deployment(result, out / "deployment.csv")
        record.save_deployment(result, out / "deployment.geojson")
        if has_module("matplotlib"):
            record.save_sea(result, out / "deployment.png")
