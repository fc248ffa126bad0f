import dataclasses
import functools
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias

import tyro

from ... import drift
from ..parameters import Limit, Share, Unit
from ..study import Study, numbers


if TYPE_CHECKING:
    import xarray

    Files: TypeAlias = str | os.PathLike[str] | Sequence[str | os.PathLike[str]]
    Source: TypeAlias = Files | xarray.Dataset
else:
    Files = Source = tuple[Path, ...]

_Degrees: TypeAlias = Annotated[float, Unit("", "deg")]
Bounds: TypeAlias = tuple[_Degrees, _Degrees, _Degrees, _Degrees]
"""West, south, east and north limits of a region."""


def degrees_of(parameter: str, place: str) -> tuple[float, float]:
    """Parse a place in degrees: `"lon,lat"`, or with hemispheres as in `"90.9W,23.9N"`."""
    words = []
    for word, east, west in zip(place.upper().split(","), "EN", "WS", strict=False):
        sign = "-" if word.endswith(west) else ""
        words.append(sign + word.strip().rstrip(east + west))
    expected = '"lon,lat" in degrees, such as "90.9W,23.9N"'
    lon, lat = numbers(parameter, ",".join(words), ("deg", "deg"), expected)
    return lon, lat


@dataclasses.dataclass(frozen=True, kw_only=True)
class SeaStudy(Study):
    """Base class of studies that read currents, or trajectories of drifters, from files."""

    file: tyro.conf.Positional[Source] = dataclasses.field(kw_only=False)
    """Files of currents or of trajectories."""

    def __post_init__(self) -> None:
        file: Any = self.file
        for one in file if isinstance(file, list | tuple) else (file,):
            if not (isinstance(one, str | os.PathLike) or hasattr(one, "data_vars")):
                got = type(one).__name__
                raise ValueError(f"file: expected files or an xarray.Dataset, got {got}")
        super().__post_init__()

    def spec(self, result: Any) -> dict[str, Any]:
        spec = super().spec(result)
        file = spec["file"]
        return {**spec, "file": file if isinstance(file, str) else " ".join(file)}

    def headline(self, spec: dict[str, Any]) -> str:
        return str(spec["file"])


@dataclasses.dataclass(frozen=True, kw_only=True)
class CurrentStudy(SeaStudy):
    """Base class of studies of drifters in a current, with the options to read it."""

    grid: Path | None = None
    """File of the grid, such as mesh_mask.nc of NEMO, if the files of currents lack the grid."""
    bounds: Bounds | None = None
    """West, south, east and north limits of the region to read, in degrees."""
    variables: tuple[str, str] | None = None
    """Names of eastward and northward velocity variables, if the file does not identify them."""
    windage: Share = 0.0
    """Share of the wind speed to add to the current at the surface; the file must have wind."""
    stokes: bool = False
    """Add the Stokes drift of waves at the surface; the file must have the Stokes drift."""
    coast: Literal["hold", "slip", "strand"] = "hold"
    """Rule for drifters that run ashore: they stay at the coast until the current carries them off,
    and water slows down towards land (hold) or flows along it without friction (slip); or they
    strand, and so leave the map (strand)."""
    land: Path | None = None
    """GeoJSON file or shapefile of land, for currents without a mask; by default the coastline of
    Natural Earth."""
    gaps: Literal["open", "land", "fill"] = "open"
    """Treatment of squares without data that neither the mask nor the coastline marks as land: as
    an open edge (open), as land (land), or as an open edge except holes of up to nine squares in
    the water, which are filled with the velocity around them (fill)."""
    diffusivity: Annotated[float, Unit("", "m2/s"), Limit(ge=0)] = 0.0
    """Horizontal diffusivity in m2/s of the motion that the current does not resolve."""

    def read(self, **options: Any) -> "xarray.Dataset":
        """Read the currents, with these options and those that the parameters give."""
        names = "grid", "bounds", "variables", "windage", "stokes", "land", "gaps"
        options |= {name: getattr(self, name) for name in names}
        # A dataset of the program cannot be a key of the cache.
        read: Any = _currents if isinstance(self.file, tuple) else _currents.__wrapped__
        return read(self.file, tuple(options.items()))


# Cached, because all members of a sweep read the same currents.
@functools.lru_cache(maxsize=8)
def _currents(file: tuple[Path, ...], options: tuple[tuple[str, Any], ...]) -> "xarray.Dataset":
    from ...currents.netcdf import TooLargeError

    named = dict(options)
    try:
        return drift.open_currents(file, **named)
    except (TooLargeError, MemoryError) as error:
        if named["time"] is not None or named["mean"]:
            raise
        steady = "or --current steady, which holds one record at a time"
        raise type(error)(f"{error}; {steady}") from None
