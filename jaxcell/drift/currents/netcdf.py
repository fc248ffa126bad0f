"""A NetCDF file, opened so that whatever is wrong with it is said in one line."""

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

from ...base import memory


# Above this an array is refused before it is made: more is nearly always a whole ocean by mistake.
LARGEST_BYTES = 4 * 2**30

_MAX_READ = 10_000_000

# Numbers that stand for "no value" in files that do not say so: the oldest convention, and the
# default fill of NetCDF, ROMS and HYCOM, all of them above the last.
_UNDECLARED_FILLS = (-9999.0, -99999.0)
_MAX_VALUE = 1e20


class TooLargeError(ValueError):
    """What is refused because it takes more memory than it may."""


@dataclasses.dataclass(frozen=True)
class OceanFile:
    """An open file, or several as one, whose values are still on the disk.

    **Attributes:**

    - `name`: its path, for messages.
    - `dataset`: its variables, unpacked and with declared fill values as NaN when they are read;
        times are as in the file.
    - `elsewhere`: the paths of variables that are from another file.
    """

    name: str
    dataset: xr.Dataset
    elsewhere: Mapping[str, str] = dataclasses.field(default_factory=dict)

    def error(self, field: str, message: str) -> ValueError:
        """An error that says in one line in which file and field."""
        return ValueError(f"{self.elsewhere.get(field, self.name)}: {field}: {one_line(message)}")

    def named(self, names: Sequence[str]) -> list[str]:
        """The variables with some names, in any case of letters; none unless there are all."""
        known = {str(name).lower(): str(name) for name in self.dataset.data_vars}
        return [known[name] for name in names] if all(name in known for name in names) else []

    def coordinates(self, field: str) -> list[str]:
        """The variables that a variable names as its coordinates."""
        variable = self.dataset[field]
        # Xarray moves what it has decoded.
        return str({**variable.encoding, **variable.attrs}.get("coordinates", "")).split()

    def check_size(self, field: str, sizes: dict[str, int], arrays: int = 1) -> None:
        """Refuse float64 arrays of the given sizes that would take more than 4 GiB together, or
        more than the free memory.
        """
        size = 8 * arrays * math.prod(sizes.values())
        if size > LARGEST_BYTES:
            text = " x ".join(f"{count} ({name})" for name, count in sizes.items())
            error = self.error(
                field,
                f"{text} values would take {size / 2**30:.1f} GiB of memory; expected "
                f"{LARGEST_BYTES / 2**30:g} GiB at most; choose less with time, depths or bounds",
            )
            raise TooLargeError(*error.args)
        memory.check(size, f"{self.name}: {field}", "choose less with time, depths or bounds")

    def read(self, array: xr.DataArray, dims: Sequence[str] = ()) -> Float[np.ndarray, "..."]:
        """The values of part of a variable as float64, NaN where there is none.

        **Arguments:**

        - `array`: a variable of `dataset`, or a part that was chosen with `isel`.
        - `dims`: the order of the dimensions; those that it does not have get the length 1.

        **Raises:** `ValueError` if they take too much memory, are not numbers, or cannot be read.
        """
        field = str(array.name)
        if array.dtype.kind not in "fiub":
            raise self.error(field, f"expected numbers, got values of type {array.dtype}")
        self.check_size(field, {str(name): size for name, size in array.sizes.items()})
        try:
            values = np.asarray(array.values, float)
        except Exception as error:  # what a damaged file makes the libraries raise is not written
            raise self.error(field, f"its values cannot be read: {error_line(error)}") from error
        absent = np.isin(values, _UNDECLARED_FILLS) | (np.abs(values) > _MAX_VALUE)
        values = np.where(absent, np.nan, values)
        if dims:
            kept = [name for name in dims if name in array.dims]
            values = values.transpose([array.dims.index(name) for name in kept])
            values = values.reshape([array.sizes.get(name, 1) for name in dims])
        return values


@contextlib.contextmanager
def open_netcdf(path: str | os.PathLike[str]) -> Iterator[OceanFile]:
    """Open a NetCDF file, of version 3 or 4, for the length of the block.

    **Raises:** `FileNotFoundError` if it does not exist, `ValueError` if it is truncated, damaged,
    or not NetCDF.
    """
    name = os.fspath(path)
    if not Path(path).is_file():
        raise FileNotFoundError(f"{name}: there is no such file")
    engine = netcdf_engine(path)
    with unwarned():
        try:
            sizes = _sizes_read(path) if engine == "netcdf4" else {}
        except Exception as error:  # as above
            raise _unreadable(name, error) from error
        for field, size in sizes.items():
            if size > _MAX_READ:
                raise ValueError(
                    f"{name}: {field}: expected at most {_MAX_READ:,} values of a coordinate or of "
                    f"text, got {size:,}"
                )
        try:
            dataset = open_undecoded(path, engine)
        except Exception as error:  # as above
            raise _unreadable(name, error) from error
        with dataset:
            yield OceanFile(name, dataset)


def open_undecoded(path: str | os.PathLike[str], engine: Any) -> xr.Dataset:
    """Open what a reader of xarray reads; its values stay where they are, and times as they are."""
    return xr.open_dataset(
        path, engine=engine, decode_times=False, decode_coords=False, cache=False
    )


@contextlib.contextmanager
def unwarned() -> Iterator[None]:
    """Read without a warning of what is well understood.

    Two different fill values in one variable are both missing; dates of another calendar are read
    by it; stores need not be consolidated.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", xr.SerializationWarning)
        warnings.filterwarnings("ignore", "Failed to open Zarr store with consolidated")
        yield


def netcdf_engine(path: str | os.PathLike[str]) -> Literal["netcdf4", "scipy"]:
    """The reader of a file, by its first four bytes.

    Scipy refuses a classic file that is truncated; the NetCDF library reads the end that is lost as
    zeros, and a current of zero looks like slack water.

    **Raises:** `ValueError` for the classic version 5, which scipy does not read.
    """
    with open(path, "rb") as file:
        magic = file.read(4)
    if magic == b"CDF\5":
        raise ValueError(
            f"{os.fspath(path)}: it is of the classic NetCDF version 5, whose truncated files look "
            "whole; expected version 1, 2 or 4 (to convert it: nccopy -k nc4 OLD.nc NEW.nc)"
        )
    return "scipy" if magic in (b"CDF\1", b"CDF\2") else "netcdf4"


def _sizes_read(path: str | os.PathLike[str]) -> dict[str, int]:
    """The sizes of what xarray reads whole to open a file: coordinates, and text."""
    with netCDF4.Dataset(path) as file:
        return {
            name: math.prod(one.shape)
            for name, one in file.variables.items()
            if one.dimensions == (name,) or one.dtype is str
        }


def _unreadable(name: str, error: Exception) -> ValueError:
    return ValueError(
        f"{name}: cannot be read as NetCDF (truncated, damaged or another format): "
        f"{error_line(error)}"
    )


def error_line(error: Exception) -> str:
    """What an exception says, in one line."""
    return one_line(str(error)) or type(error).__name__


def one_line(text: str) -> str:
    """A text in one line; names and arrays in it may be of any length."""
    words = " ".join(text.split())
    return words[:500] + "..." * (len(words) > 500)
