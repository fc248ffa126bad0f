"""Trajectories of observed drifters, and of particles in models."""

import dataclasses
import os
import re
from pathlib import Path

import cftime
import numpy as np
import xarray as xr
from jaxtyping import Bool, Float, Int

from ...base.doubts import Doubt, warn
from ...base.paths import replacing
from ...base.process import library_writes
from ...base.shown import Shown
from ...currents.axes.times import SECONDS
from ...currents.component import FASTEST_CURRENT
from ...currents.conventions import Role, find
from ...currents.netcdf import OceanFile
from ...currents.parquet import write_parquet
from ...currents.sources import Source, open_source, paths_of, source_name
from ...currents.sphere import wrapped
from .possible import possible_observations
from .tables import read_csv


_ROLES: dict[Role, str] = {"lon": "longitude", "lat": "latitude", "time": "time"}
# Names, in small letters, of variables with the counts of observations and with the labels of
# drifters; and prefixes of the name of the dimension of drifters.
_COUNTS = ("rowsize", "row_size")
_LABELS = (
    *("id", "drifter", "particle", "particle_id", "trajectory", "drifter_id", "buoy", "buoy_id"),
    *("wmo", "platform", "platform_id", "platform_code", "device", "device_id", "name", "imei"),
)
_DRIFTERS = ("traj", "drifter", "particle")
_MAX_TIME = 1e17


@dataclasses.dataclass(frozen=True, eq=False)
class Trajectories(Shown):
    """Observed positions of drifters, sorted by drifter.

    Three observations of one drifter, and two of another:

        >>> import numpy as np
        >>> from jaxcell import drift
        >>> lon, lat = np.array([179.9, -179.9, -179.7, 10.0, 10.1]), np.zeros(5)
        >>> time = 3600.0 * np.array([0, 1, 2, 0, 1])
        >>> seen = drift.Trajectories(lon, lat, time, np.repeat([0, 1], [3, 2]))
        >>> seen.drifters, seen.lon.size
        (2, 5)
    """

    lon: Float[np.ndarray, "observations"]
    "Longitudes in degrees, from -180 to 180."
    lat: Float[np.ndarray, "observations"]
    "Latitudes in degrees."
    time: Float[np.ndarray, "observations"]
    "Times in seconds, ascending for each drifter."
    drifter: Int[np.ndarray, "observations"]
    "The number of the drifter of each observation, from 0, ascending."
    source: str = "trajectories"
    "The name of the file or dataset."
    since: str = ""
    "The date from which seconds are counted, such as `2020-01-01`; empty if unknown."
    drogued: Bool[np.ndarray, "observations"] | None = None
    "True for observations of drifters that still had their drogue; `None` if unknown."

    def __post_init__(self) -> None:
        later = (np.diff(self.drifter) > 0) | (np.diff(self.time) > 0)
        if not (later & (np.diff(self.drifter) >= 0)).all():
            raise ValueError(
                "time: expected observations that go on in time, drifter after drifter; number "
                f"{int(np.argmin(later)) + 1} does not"
            )

    @property
    def drifters(self) -> int:
        """Number of drifters."""
        return int(self.drifter.max(initial=-1)) + 1

    @classmethod
    def of(
        cls,
        lon: Float[np.ndarray, "observations"],
        lat: Float[np.ndarray, "observations"],
        time: Float[np.ndarray, "observations"],
        drifter: Int[np.ndarray, "observations"],
        source: str = "trajectories",
        since: str = "",
        drogued: Bool[np.ndarray, "observations"] | None = None,
        max_speed: float | int = FASTEST_CURRENT,
    ) -> "Trajectories":
        """Sort observations, and leave out invalid, repeated and impossible observations.

        An observation is impossible if the drifter would have to move faster than `max_speed` (m/s;
        by default 10) between it and the longest possible part of the track, beyond an error of
        1 km of its position, or if it rests at exactly 0 N 0 E, as the fixes of a receiver without
        satellites do. A longitude beyond 360 or a latitude beyond 90 is invalid, such as a missing
        value of 999. Warnings of the class `jaxcell.base.doubts.Doubt` say how many there are, and
        how many times go back.

        **Arguments:** as the fields of this class; the numbers in `drifter` may be in any order,
        with gaps.
        """

        def doubt(marked: np.ndarray, of: np.ndarray, what: str) -> None:
            if count := int(marked.sum()):
                warn(f"{source}: {count:,} of {of.size:,} observations are {what}", Doubt)

        given = np.isfinite(lon) & np.isfinite(lat) & np.isfinite(time)
        wrong = given & ((np.abs(lon) > 360) | (np.abs(lat) > 90))
        why = "longitudes beyond 360 or latitudes beyond 90 are no positions"
        doubt(wrong, wrong, f"left out: {why}")
        known = np.flatnonzero(given & ~wrong)
        by_drifter = known[np.argsort(drifter[known], kind="stable")]
        back = (np.diff(time[by_drifter]) < 0) & (np.diff(drifter[by_drifter]) == 0)
        doubt(back, wrong, "earlier than the one before of their drifter, and are sorted by time")
        order = known[np.lexsort((time[known], drifter[known]))]
        lon, lat, time, drifter = (column[order] for column in (lon, lat, time, drifter))
        new = np.append(True, (np.diff(time) > 0) | (np.diff(drifter) != 0))[: time.size]
        doubt(~new, new, "left out: their drifters have another at the same time")
        drogued = None if drogued is None else drogued[order][new]
        lon, lat, time, drifter = wrapped(lon[new]), lat[new], time[new], drifter[new]
        possible = possible_observations(lon, lat, time, drifter, max_speed)
        for first in np.flatnonzero(~possible)[:1]:
            fast = f"left out, which drifters could reach only at more than {max_speed:g} m/s"
            at = f"the first is at {lat[first]:g} N, {lon[first]:g} E"
            still = f"which rest at exactly 0 N 0 E; {at}; for another limit, set `max_speed`"
            doubt(~possible, possible, f"{fast}, or {still}")
        return cls(lon, lat, time, drifter, source, since, drogued)._selected(possible)

    def _selected(self, chosen: Bool[np.ndarray, "observations"]) -> "Trajectories":
        """Select observations, and number their drifters from 0."""
        fields = self.lon[chosen], self.lat[chosen], self.time[chosen]
        number = np.unique(self.drifter[chosen], return_inverse=True)[1].astype(np.int64)
        drogued = None if self.drogued is None else self.drogued[chosen]
        return Trajectories(*fields, number, self.source, self.since, drogued)

    def with_drogue(self, kept: bool) -> "Trajectories":
        """Select the observations of drifters with their drogue if `kept`, else of those without.

        **Raises:** `ValueError` if `drogued` is unknown, or no observation is left.
        """
        if self.drogued is None:
            expected = "expected a variable drogue_status or drogue_lost_date"
            why = "it is not known which drifters had their drogue"
            raise ValueError(f"{self.source}: {why}; {expected}")
        if not (chosen := self.drogued == kept).any():
            raise ValueError(f"{self.source}: no drifter had {'' if kept else 'lost '}its drogue")
        return self._selected(chosen)

    def dataset(self) -> xr.Dataset:
        """Return a dataset in the CF convention for trajectories, as a contiguous ragged array.

        It can be read by TrajAn (`dataset.traj`) and by [`open_trajectories`][].
        """
        unit = f"seconds since {self.since}" if self.since else "seconds"
        data = {
            "lon": ("index", self.lon, {"standard_name": "longitude", "units": "degrees_east"}),
            "lat": ("index", self.lat, {"standard_name": "latitude", "units": "degrees_north"}),
            "rowsize": ("trajectory", np.bincount(self.drifter), {"sample_dimension": "index"}),
        }
        names = np.arange(self.drifters), {"cf_role": "trajectory_id"}
        coords = {
            "time": ("index", self.time, {"standard_name": "time", "units": unit}),
            "trajectory": ("trajectory", *names),
        }
        about = {"Conventions": "CF-1.8", "featureType": "trajectory", "source": self.source}
        return xr.Dataset(data, coords, about)


def save_trajectories(seen: Trajectories, path: str | os.PathLike[str]) -> None:
    """Write trajectories to a file, whose suffix decides its format.

    **Arguments:**

    - `path`: `.nc` for the dataset of [`Trajectories.dataset`][]; `.parquet` for a table in the
        layout of Parcels 4, which needs PyArrow.

    **Raises:** `ValueError` for another suffix; `ModuleNotFoundError` without PyArrow.

    Three positions of a drifter, written and read:

        >>> import pathlib, tempfile
        >>> import numpy as np
        >>> from jaxcell import drift
        >>> lon, time = np.array([4.0, 4.1, 4.2]), 3600.0 * np.arange(3)
        >>> seen = drift.Trajectories(lon, 0 * lon, time, np.zeros(3, int), since="2020-01-01")
        >>> path = pathlib.Path(tempfile.mkdtemp()) / "seen.nc"
        >>> drift.save_trajectories(seen, path)
        >>> again = drift.open_trajectories(path)
        >>> again.lon.round(6).tolist(), again.since
        ([4.0, 4.1, 4.2], '2020-01-01')
    """
    suffix = Path(path).suffix.lower()
    if suffix not in (".nc", ".parquet"):
        raise ValueError(f"{os.fspath(path)}: expected a name that ends in .nc or .parquet")
    with replacing(path) as temporary:
        if suffix == ".parquet":
            whole = seen.dataset()
            names = {"x": "lon", "y": "lat", "t": "time"}
            columns = {new: (whole[old].values, whole[old].attrs) for new, old in names.items()}
            owner = seen.drifter, {"cf_role": "trajectory_id"}
            write_parquet(temporary, {**columns, "particle_id": owner})
        else:
            with library_writes(os.path.basename(path)):
                seen.dataset().to_netcdf(temporary, engine="netcdf4")


def open_trajectories(path: Source, max_speed: float | int = FASTEST_CURRENT) -> Trajectories:
    """Read trajectories from the Global Drifter Program, OpenDrift, Parcels, or any CF file.

    A file has a matrix of drifters by observations, with common or separate times; or the
    concatenated observations of the drifters, with the number of observations per drifter (a ragged
    array); or the drifter of each observation, whose times may be common to a number of particles,
    as in PyGNOME. Several files are read one by one; drifters of
    different files are different drifters, even if their labels are equal.

    **Arguments:**

    - `path`: one or more files, a pattern, a Zarr store, an OPeNDAP address, a Parcels 4 table
        whose name ends in `.parquet`, a table of text whose name ends in `.csv`, with columns
        such as `id`, `time`, `lat` and `lon`, or an open dataset with encoded times.
    - `max_speed`: the largest speed in m/s; see [`Trajectories.of`][].

    **Returns:** [`Trajectories`][].

    **Raises:** `FileNotFoundError`; `ValueError` that names the file and the variable for a file
    that cannot be read, or has no trajectories.

    Two particles, as OpenDrift writes them:

        >>> import numpy as np, xarray as xr
        >>> from jaxcell import drift
        >>> dims, lon = ("trajectory", "time"), np.array([[4.0, 4.1, 4.2], [5.0, 5.1, np.nan]])
        >>> time = ("time", [0, 1, 2], {"units": "hours since 2020-01-01"})
        >>> file = xr.Dataset({"lon": (dims, lon), "lat": (dims, 0 * lon + 60)}, {"time": time})
        >>> seen = drift.open_trajectories(file)
        >>> seen.drifters, seen.lon.round(6).tolist(), seen.time.tolist()
        (2, [4.0, 4.1, 4.2, 5.0, 5.1], [0.0, 3600.0, 7200.0, 0.0, 3600.0])
    """
    sources = [path] if isinstance(path, xr.Dataset) else paths_of(path)
    parts = [_observations(source) for source in sources]
    columns = [part for part, _ in parts]
    first = 0
    for column in columns:
        column["drifter"] = column["drifter"] + first
        first = int(column["drifter"].max(initial=first - 1)) + 1
    dates = [since for _, since in parts]
    since = dates[0] if all(dates) else ""
    if since:
        for column, date in zip(columns, dates, strict=True):
            column["time"] = column["time"] + _seconds_between(since, date)
    name, known = source_name(path), [column for column in columns if "drogued" in column]
    if 0 < len(known) < len(columns):
        some = f"{len(known)} of {len(columns)} files"
        warn(f"{name}: the drogue is known in {some}, and not used", Doubt)
    fields = set.intersection(*(set(column) for column in columns))
    joined = {field: np.concatenate([column[field] for column in columns]) for field in fields}
    return Trajectories.of(**joined, source=name, since=since, max_speed=max_speed)


def _observations(source: str | xr.Dataset) -> tuple[dict[str, np.ndarray], str]:
    """Read the observations of one file, and the date from which it counts seconds, or ""."""
    if not isinstance(source, xr.Dataset) and str(source).lower().endswith(".csv"):
        source = read_csv(source)
    with open_source(source) as file:
        read = {str(role): file.dataset[_field(file, role)] for role in _ROLES}
        lon = read["lon"]
        time = read["time"] = _repeated(file, read["time"], lon)
        drifter = _drifters(file, lon, time)
        for array in read.values():
            if not set(array.dims) <= set(lon.dims):
                why = f"expected dimensions of {lon.dims}, got {array.dims}"
                raise file.error(str(array.name), why)
        values = {role: file.read(read[role]) for role in ("lon", "lat")}
        values["time"] = _seconds(file, time)
        full = {
            role: xr.DataArray(value, dims=read[role].dims).broadcast_like(drifter)
            for role, value in values.items()
        }
        full["drifter"] = drifter
        if (drogued := _drogued(file, drifter, full["time"])) is not None:
            full["drogued"] = drogued
        flat = {role: array.transpose(*lon.dims).values.ravel() for role, array in full.items()}
        dated = re.search(r" since (.+)", str(time.attrs.get("units", "")))
        since = "1970-01-01" if time.dtype.kind == "M" else dated[1].strip() if dated else ""
        return flat, since


def _repeated(file: OceanFile, time: xr.DataArray, lon: xr.DataArray) -> xr.DataArray:
    """Repeat each time for all its particles, if the file counts the particles of each time."""
    for name, variable in file.dataset.variables.items():
        counted = "ragged_row_count" in variable.attrs or str(name).lower() == "particle_count"
        if counted and variable.dims == time.dims != lon.dims:
            counts = file.read(file.dataset[name])
            if (counts < 0).any() or counts.sum() != lon.size:
                found = f"{counts.sum():g} in numbers of particles"
                raise file.error(str(name), f"expected {lon.size} observations, got {found}")
            repeated = np.repeat(time.values, counts.astype(np.int64))
            return xr.DataArray(repeated, dims=lon.dims, attrs=time.attrs, name=time.name)
    return time


def _seconds_between(first: str, second: str) -> float:
    """Return the seconds from one date of units of time to another."""
    if first == second:
        return 0.0
    dates = [cftime.num2date(0, f"seconds since {date}") for date in (first, second)]
    return float((dates[1] - dates[0]).total_seconds())


def _field(file: OceanFile, role: Role) -> str:
    names = [str(name) for name in file.dataset.variables]
    if (name := find(file.dataset, role, names)) is None:
        listed = ", ".join(names)
        raise file.error(role, f"expected trajectories with a {_ROLES[role]}, got {listed}")
    return name


def _drifters(file: OceanFile, lon: xr.DataArray, time: xr.DataArray) -> xr.DataArray:
    """Return the number of the drifter of each observation, on the dimensions of longitudes."""
    if lon.ndim == 2:
        named = [dim for dim in lon.dims if str(dim).lower().startswith(_DRIFTERS)]
        across = [dim for dim in lon.dims if dim not in time.dims]
        along = (across or named or lon.dims)[0]
        number = xr.DataArray(np.arange(lon.sizes[along]), dims=[along])
        return number.broadcast_like(xr.DataArray(np.zeros(lon.shape), dims=lon.dims))
    if lon.ndim != 1:
        raise file.error(str(lon.name), f"expected one dimension or two, got {lon.dims}")
    (dim,) = lon.dims
    for name, variable in file.dataset.variables.items():
        if variable.attrs.get("sample_dimension") == dim or str(name).lower() in _COUNTS:
            counts = file.read(file.dataset[name])
            whole = counts.ndim == 1 and (counts == np.abs(counts.round())).all()
            if not whole or counts.sum() != lon.size:
                got = f"{counts.sum():g}{' in numbers that are none of observations' * (not whole)}"
                expected = f"expected {lon.size} observations of all drifters"
                raise file.error(str(name), f"{expected}, got {got}")
            owner = np.repeat(np.arange(counts.size), counts.astype(np.int64))
            return xr.DataArray(owner, dims=[dim])
    for name, variable in file.dataset.variables.items():
        about, usual = variable.attrs, str(name).lower() in _LABELS
        labels = "instance_dimension" in about or about.get("cf_role") == "trajectory_id" or usual
        if labels and variable.dims == (dim,):
            _, label = np.unique(variable.values, return_inverse=True)
            return xr.DataArray(label, dims=[dim])
    if time.dims == lon.dims and (time.values[1:] >= time.values[:-1]).all():
        warn(f"{file.name}: no variable names the drifters; taken as one drifter", Doubt)
        return xr.DataArray(np.zeros(lon.size, int), dims=[dim])
    raise file.error(
        str(lon.name),
        f"the drifters along {dim} are unknown, and their times are not those of one; expected a "
        "count of observations for each drifter (sample_dimension), the drifter of each "
        "observation in a variable named id, or a file for each drifter",
    )


def _drogued(file: OceanFile, drifter: xr.DataArray, seconds: xr.DataArray) -> xr.DataArray | None:
    """Mark observations of drifters that have a drogue, from its status or the date of its loss.

    A missing date means that the drogue was never lost. The result is `None` if the file contains
    neither status nor date.
    """
    variables = {str(name).lower(): name for name in file.dataset.variables}
    if (name := variables.get("drogue_status")) is not None:
        status = file.dataset[name]
        if set(status.dims) <= set(drifter.dims):
            kept = xr.DataArray(file.read(status) == 1, dims=status.dims)
            return kept.broadcast_like(drifter)
    if (name := variables.get("drogue_lost_date")) is not None:
        lost = file.dataset[name]
        date = _seconds(file, lost)
        number, drifters = drifter.values, int(drifter.max()) + 1
        if date.shape == (drifters,):
            never = np.where(np.isfinite(date) & (date > 0), date, np.inf)
            return xr.DataArray(seconds.values < never[number], dims=drifter.dims)
    return None


def _seconds(file: OceanFile, time: xr.DataArray) -> np.ndarray:
    """Convert times to seconds since the date in their units."""
    if time.dtype.kind == "M":
        # Not every date fits 64 bits in nanoseconds.
        seconds = time.values.astype("datetime64[us]").astype(np.int64) / 1e6
        return np.where(np.isnat(time.values), np.nan, seconds)
    units = str(time.attrs.get("units", "")).split(" since ")[0].strip().lower()
    if units not in SECONDS:
        raise file.error(str(time.name), f"units: expected a unit of time, got {units!r}")
    values = file.read(time)
    # Whole numbers have no NaN: a missing time is read as a number near the least one.
    return np.where(np.abs(values) < _MAX_TIME, values, np.nan) * SECONDS[units]
