import dataclasses
import functools
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, TypeAlias

import tyro

from ... import drift
from ..parameters import Days, Headings, Limit, Metres, Share, Unit
from ..study import Study, numbers


if TYPE_CHECKING:
    import numpy as np
    import xarray

    Files: TypeAlias = str | os.PathLike[str] | Sequence[str | os.PathLike[str]]
    Source: TypeAlias = Files | xarray.Dataset
else:
    Files = Source = tuple[Path, ...]

DAY = 86_400.0
"""Seconds in a day."""

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
class Naming:
    """The options for what files of currents do not say themselves."""

    grid: Path | None = None
    """File of the grid, such as mesh_mask.nc of NEMO, if the files of currents lack the grid."""
    variables: tuple[str, str] | None = None
    """Names of eastward and northward velocity variables, if the file does not identify them."""
    dims: tuple[str, ...] | None = None
    """Axes of dimensions whose names are unknown, such as k=depth j=y i=x; the axes are time,
    depth, y, x, and on a C-grid y_rho, x_rho, y_v and x_u."""
    coords: tuple[str, ...] | None = None
    """Names of the variables with longitudes, latitudes and, if unknown, depths."""
    time_units: str | None = None
    """Unit of the times, such as "days since 2000-01-01"."""
    calendar: str | None = None
    """Calendar of the times by its name in CF, such as noleap."""
    mask: str | None = None
    """Land, as VAR=VALUE: squares in which a variable always has this value, such as uo=0."""
    units: str | None = None
    """Unit of the velocities, such as cm/s or knots."""
    group: str | None = None
    """Group of the file that has the velocities."""

    @property
    def said(self) -> dict[str, Any]:
        """The arguments of `open_currents` about what a file does not say."""
        return {name: getattr(self, name) for name in Naming.__annotations__}


@dataclasses.dataclass(frozen=True, kw_only=True)
class CurrentStudy(Naming, SeaStudy):
    """Base class of studies of drifters in a current, with the options to read it."""

    headings: ClassVar[Headings] = {"What does the file not say?": tuple(Naming.__annotations__)}

    bounds: Bounds | None = None
    """West, south, east and north limits of the region to read, in degrees."""
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
        names = "bounds", "windage", "stokes", "land", "gaps"
        options |= {name: getattr(self, name) for name in names} | self.said
        # A dataset of the program cannot be a key of the cache.
        read: Any = _currents if isinstance(self.file, tuple) else _currents.__wrapped__
        return read(self.file, tuple(options.items()))


@dataclasses.dataclass(frozen=True, kw_only=True)
class WindowStudy(CurrentStudy):
    """Base class of studies of drifters from a time on, in the current as it changes."""

    on: str | None = None
    """Time at which drifters are dropped, such as 2020-03-01 or 2020-03-01T06:00 (UTC); by default
    that of the first record. A month (2020-03) or a period (2020-03-01/2020-03-11) also ends the
    answer, in place of `until`."""
    until: Annotated[Days | None, Limit(gt=0)] = None
    """Time in days from the drop to the end of the answer."""
    depth: Metres | None = None
    """Depth of the drifters in metres; by default the layer nearest to the surface."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check_time()
        if self.days <= 0:
            raise ValueError(f"on: expected a period that ends after it begins, got {self.on}")

    def check_time(self) -> None:
        """Raise `ValueError` unless either `until` or a period ends the answer."""
        if (self.until is None) == (self.period is None):
            got = "nothing" if self.until is None else f"{self.until:g} and `on` {self.on}"
            raise ValueError(f"until: expected days, or a month or a period as `on`, got {got}")

    @property
    def days(self) -> float:
        """The days from the drop to the end of the answer."""
        import numpy as np

        if self.until is not None or self.period is None:
            return float(self.until or 0)
        begin, end = self.period
        return float((end - begin) / np.timedelta64(1, "D"))

    def span(self, first: "np.datetime64") -> "tuple[np.datetime64, np.datetime64]":
        """Return the time of the drop and the end of the answer, for records from `first` on."""
        on = first if self.on is None else self.moment
        return on, later(on, self.days)

    def window(self) -> "tuple[np.datetime64, float, xarray.Dataset]":
        """Read the currents from the record before the drop to the end of the answer.

        Returns the time of the drop, also in seconds after the first of the records, and these.
        """
        import numpy as np

        from ...currents.ocean import read_moments

        moments = read_moments(self.file, **self.said)
        on, end = self.span(moments[0])
        if moments.size > 1:
            # A mean of a day is of the whole day, and its time is noon.
            half = np.diff(moments)[[0, -1]] // 2
            begins, ends = moments[0] - half[0], moments[-1] + half[1]
            first, last, got = np.array([begins, ends, on]).astype("datetime64[m]")
            if not begins <= on < ends:
                raise ValueError(
                    f"on: expected a time of the records, {first} to {last}, got {got}"
                )
            if end > ends:
                left = (ends - on) / np.timedelta64(1, "D")
                raise ValueError(
                    f"until: the records end on {last}, {left:.4g} days after the release; "
                    f"expected at most that, got {(end - on) / np.timedelta64(1, 'D'):g}"
                )
        records = (
            max(0, int(np.searchsorted(moments, on, "right")) - 1),
            int(np.searchsorted(moments, end).clip(0, moments.size - 1)),
        )
        depths = None if self.depth is None else (self.depth,)
        currents = self.read(time=records if moments.size > 1 else None, depths=depths, mean=False)
        return on, float((on - currents.time.values[0]) / np.timedelta64(1, "s")), currents

    def notices(self, on: "np.datetime64", currents: "xarray.Dataset") -> tuple[str, ...]:
        """Say that the current is steady if there is one record, or which record is held."""
        import numpy as np

        from ...base.formatting import in_time

        times = currents.time.values
        if times.size == 1:
            return ("There is one record in this time: the current of the answer is steady.",)
        hour = np.timedelta64(1, "h")
        held = {"first": (times[0] - on) / hour, "last": (self.span(on)[1] - times[-1]) / hour}
        return tuple(
            f"The {name} record is held for {in_time(hours)} beyond its time."
            for name, hours in held.items()
            if hours > 1e-3
        )

    @property
    def period(self) -> "tuple[np.datetime64, np.datetime64] | None":
        """The begin and end of a month or a period as `on`; `None` for a time."""
        from ...currents.axes.times import read_period

        period = read_period(self.on)
        return None if period is None else (_moment(period[0]), _moment(period[1]))

    @property
    def moment(self) -> "np.datetime64":
        """The time `on`, or its begin if it is a period."""
        return _moment(str(self.on)) if self.period is None else self.period[0]


def later(time: "np.datetime64", days: float) -> "np.datetime64":
    """Return the time some days after a time."""
    import numpy as np

    return time + np.timedelta64(round(days * DAY * 1e9), "ns")


def _moment(text: str) -> "np.datetime64":
    import numpy as np

    try:
        return np.datetime64(text.removesuffix("Z"), "ns")
    except ValueError:
        raise ValueError(f"on: expected a date such as 2020-03-01, got {text}") from None


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
