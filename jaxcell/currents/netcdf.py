"""NetCDF files, opened so that every fault is reported in one line."""

import contextlib
import dataclasses
import math
import os
import warnings
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import netCDF4
import numpy as np
import xarray as xr
from jaxtyping import Float

from ..base import memory
from ..base.paths import absent


LARGEST_BYTES = 4 * 2**30
"""The largest size of an array to read; a larger one is usually a whole ocean, read by mistake."""

_MAX_READ = 10_000_000
_CHOOSE_LESS = "choose less with time, depths or bounds"

# Undeclared fill values: an old convention, and all larger values, which include the default fill
# values of NetCDF, ROMS and HYCOM.
_UNDECLARED_FILLS = (-9999.0, -99999.0)
_MAX_VALUE = 1e20


class TooLargeError(ValueError):
    """The error for arrays that take too much memory."""


@dataclasses.dataclass(frozen=True)
class OceanFile:
    """An open file, or several files combined, whose values are read when they are used."""

    name: str
    "The path of the file, for messages."
    dataset: xr.Dataset
    "The variables, with times as numbers or dates; `read` turns fill values into NaN."
    elsewhere: Mapping[str, str] = dataclasses.field(default_factory=dict)
    "The paths of other files, keyed by the names of the variables that come from them."
    positions: tuple[str, ...] = ()
    "The variables that the caller named for longitudes, latitudes and depths, if any."
    land: tuple[str, float] | None = None
    "The variable, and its value on land, that the caller named."

    def error(self, field: str, message: str) -> ValueError:
        """Return an error whose message is one line that begins with the file and the field."""
        return ValueError(f"{self.elsewhere.get(field, self.name)}: {field}: {one_line(message)}")

    def coordinates(self, field: str) -> list[str]:
        """List the variables in the attribute `coordinates` of a variable."""
        variable = self.dataset[field]
        # xarray moves decoded attributes to the encoding.
        return str({**variable.encoding, **variable.attrs}.get("coordinates", "")).split()

    def check_size(self, field: str, sizes: dict[str, int], arrays: int = 1) -> None:
        """Raise if `arrays` float64 arrays of these `sizes` exceed 4 GiB or the free memory."""
        size = 8 * arrays * math.prod(sizes.values())
        if size > LARGEST_BYTES:
            text = " x ".join(f"{count} ({name})" for name, count in sizes.items())
            most = f"expected {LARGEST_BYTES / 2**30:g} GiB at most; {_CHOOSE_LESS}"
            why = f"{text} values would take {size / 2**30:.1f} GiB of memory; {most}"
            raise TooLargeError(*self.error(field, why).args)
        memory.check(size, f"{self.name}: {field}", _CHOOSE_LESS)

    def read(self, array: xr.DataArray, dims: Sequence[str] = ()) -> Float[np.ndarray, "..."]:
        """Read a variable, or a part of a variable, as float64, with NaN for missing values.

        `dims` is the order of the dimensions; missing dimensions get the length 1.
        """
        field = str(array.name)
        if array.dtype.kind not in "fiub":
            raise self.error(field, f"expected numbers, got values of type {array.dtype}")
        self.check_size(field, {str(name): size for name, size in array.sizes.items()})
        try:
            values = np.asarray(array.values, float)
        except Exception as error:  # the exceptions for damaged files are not documented
            raise self.error(field, f"its values cannot be read: {error_line(error)}") from error
        absent = np.isin(values, _UNDECLARED_FILLS) | (np.abs(values) > _MAX_VALUE)
        values = np.where(absent, np.nan, values)
        if dims:
            kept = [name for name in dims if name in array.dims]
            values = values.transpose([array.dims.index(name) for name in kept])
            values = values.reshape([array.sizes.get(name, 1) for name in dims])
        return values


@contextlib.contextmanager
def open_netcdf(path: str | os.PathLike[str], group: str | None = None) -> Iterator[OceanFile]:
    """Open a NetCDF file, of version 3 or 4, or a `group` of it, as a context manager.

    A file without variables of its own is opened at its only group with variables.
    """
    name = os.fspath(path)
    if not Path(path).is_file():
        raise absent(name)
    engine = netcdf_engine(path)
    with unwarned():
        try:
            classic = engine != "netcdf4"
            too_long, groups = ({}, [group or ""]) if classic else _inspected(path, group)
            empty = too_long or len(groups) != 1
            dataset = xr.Dataset() if empty else open_undecoded(path, engine, groups[0])
        except Exception as error:  # as above
            why = "cannot be read as NetCDF (truncated, damaged or another format)"
            raise ValueError(f"{name}: {why}: {error_line(error)}") from error
        for field, size in too_long.items():
            expected = f"expected at most {_MAX_READ:,} values of a coordinate or of text"
            raise ValueError(f"{name}: {field}: {expected}, got {size:,}")
        if len(groups) != 1:
            expected = f"expected one of the groups {', '.join(filter(None, groups))}"
            way_on = f"name it with group (--group {groups[-1]})"
            raise ValueError(f"{name}: group: {expected}, got {group or 'none'}; {way_on}")
        with dataset:
            yield OceanFile(name, dataset)


def open_undecoded(
    path: str | os.PathLike[str], engine: Any, group: str | None = None
) -> xr.Dataset:
    """Open a dataset, or a group with the coordinates of the file, without decoding times."""
    options: dict[str, Any] = {"decode_times": False, "decode_coords": False, "cache": False}
    whole = xr.open_dataset(path, engine=engine, **options)
    if not group:
        return whole
    part = xr.open_dataset(path, engine=engine, group=group, **options)
    both = whole.merge(part, compat="override", join="override")
    closing = contextlib.ExitStack()
    for dataset in (whole, part):
        closing.callback(dataset.close)
    both.set_close(closing.close)
    return both


def _inspected(path: str | os.PathLike[str], group: str | None) -> tuple[dict[str, int], list[str]]:
    """Return the sizes of coordinates and texts that are too long for xarray to load, and the
    groups to choose from: "" for the file itself, if it has variables."""
    with netCDF4.Dataset(path) as file:
        too_long = {
            name: size
            for name, variable in file.variables.items()
            if (variable.dimensions == (name,) or variable.dtype is str)
            and (size := math.prod(variable.shape)) > _MAX_READ
        }
        found, queue = [], [file]
        while queue:
            at = queue.pop(0)
            queue += at.groups.values()
            if any(variable.ndim > 1 for variable in at.variables.values()):
                found.append(at.path.strip("/"))
    if group is None:
        return too_long, [""] if "" in found or not found else found
    asked = group.strip("/")
    return too_long, [asked] if asked in found else ["", *found]


@contextlib.contextmanager
def unwarned() -> Iterator[None]:
    """Silence warnings on double fill values, rare calendars, Zarr metadata, and closed files."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", xr.SerializationWarning)
        warnings.filterwarnings("ignore", "Failed to open Zarr store with consolidated")
        # Values are copied, but garbage may refer to the memory map of a classic file.
        warnings.filterwarnings("ignore", "Cannot close a netcdf_file opened with mmap=True")
        yield


def netcdf_engine(path: str | os.PathLike[str]) -> Literal["netcdf4", "scipy"]:
    """Choose the xarray backend for a file from its first four bytes.

    The NetCDF library reads the missing end of a truncated classic file as zeros, which look like
    slack water. Scipy refuses such a file, but it cannot read version 5 of the classic format.
    """
    with open(path, "rb") as file:
        magic = file.read(4)
    if magic == b"CDF\5":
        why = "it is of the classic NetCDF version 5, whose truncated files look whole"
        expected = "version 1, 2 or 4 (to convert it: nccopy -k nc4 OLD.nc NEW.nc)"
        raise ValueError(f"{os.fspath(path)}: {why}; expected {expected}")
    return "scipy" if magic in (b"CDF\1", b"CDF\2") else "netcdf4"


def error_line(error: Exception) -> str:
    return one_line(str(error)) or type(error).__name__


def one_line(text: str) -> str:
    """Join the lines of a text, and cut it after 500 characters."""
    words = " ".join(text.split())
    return words[:500] + "..." * (len(words) > 500)
