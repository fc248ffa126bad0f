"""Records of several files as one dataset; each record is read from its file when it is used."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Shaped
from xarray.backends import BackendArray
from xarray.core import indexing

from ..base.doubts import Doubt, warn
from .axes.dimensions import axis_kind
from .axes.times import read_times, time_variable
from .netcdf import OceanFile


class _Records(BackendArray):
    """A variable of several files, joined along an axis."""

    def __init__(self, axis: int, records: Sequence[tuple[xr.Variable, int]]) -> None:
        """Join `records`, each of a part, in which it has an index along the `axis`."""
        self.axis, self.records = axis, records
        self.dtype = np.result_type(*{part.dtype for part, _ in records})
        shape = records[0][0].shape
        self.shape = (*shape[:axis], len(records), *shape[axis + 1 :])

    def __getitem__(self, key: indexing.ExplicitIndexer) -> Any:
        support = indexing.IndexingSupport.OUTER
        return indexing.explicit_indexing_adapter(key, self.shape, support, self._read)

    def _read(self, key: tuple[Any, ...]) -> np.ndarray:
        chosen = np.arange(self.shape[self.axis])[key[self.axis]]
        read = []
        for record in np.atleast_1d(chosen):
            part, at = self.records[record]
            place = (*key[: self.axis], at, *key[self.axis + 1 :])
            read.append(part.isel(dict(zip(part.dims, place, strict=True))).values)
        if chosen.ndim == 0:
            return read[0]
        kept = [np.ndim(index) > 0 or isinstance(index, slice) for index in key[: self.axis]]
        return np.stack(read, axis=sum(kept))


def join_records(files: Sequence[OceanFile], name: str) -> OceanFile:
    """Join files: sort records by time, and take other variables from the first file that has them.

    A record in several files, such as of forecasts that overlap, is taken from the file that begins
    last. Times become dates, because the files may count times from different dates. Variables that
    some records lack are left out.
    """
    joined = OceanFile(name, xr.Dataset())
    fixed: dict[str, xr.Variable] = {}
    moving: dict[str, list[tuple[np.ndarray, xr.Variable]]] = {}
    dates: dict[str, list[np.ndarray]] = {}
    for file in files:
        dims = (str(dim) for dim in file.dataset.dims)
        dim = next((dim for dim in dims if axis_kind(file.dataset, dim) == "time"), "")
        variables = {str(name): v for name, v in file.dataset.variables.items()}
        if dim:
            own = str(time_variable(file, dim))
            dates.setdefault(dim, []).append(read_times(file, own))
            variables = {name: v for name, v in variables.items() if name not in (dim, own)}
        for name, variable in variables.items():
            if dim in variable.dims:
                moving.setdefault(name, []).append((dates[dim][-1], variable))
            else:
                fixed.setdefault(name, variable)
    if len(dates) != 1 or len({times.dtype.kind for times in next(iter(dates.values()))}) > 1:
        raise joined.error("time", f"expected one dimension and calendar, got {', '.join(dates)}")
    [(dim, of_files)] = dates.items()
    times = np.unique(np.concatenate(of_files))
    whole, doubts = {}, set()
    for name, parts in moving.items():
        variable, doubt = _joined(joined, name, dim, parts)
        if variable.sizes[dim] == times.size:
            whole[name] = variable
            doubts.add(doubt)
    for doubt in doubts - {""}:
        warn(f"{joined.name}: {doubt}", Doubt)
    if not whole:
        why = f"no variable is at each of the {times.size} records of these files"
        raise joined.error("time", f"{why}; expected the same records for u and v")
    about = {} if times.dtype.kind in "MO" else {"units": "seconds"}
    try:
        dataset = xr.Dataset(fixed | whole | {dim: xr.Variable(dim, times, about)})
    except ValueError as error:
        raise joined.error("time", f"these files cannot be combined: {error}") from error
    return OceanFile(joined.name, dataset)


def _joined(
    file: OceanFile,
    name: str,
    dim: str,
    parts: list[tuple[Shaped[np.ndarray, " _records"], xr.Variable]],
) -> tuple[xr.Variable, str]:
    """Join the parts of a variable, each with its times, in chronological order.

    **Returns:** the variable, and a doubt if parts with different beginnings overlap, or "".
    """
    # Of parts that begin together the longest comes last, and its records are used.
    parts = sorted(parts, key=lambda part: (part[0][0], part[0].size))
    variables = [part[1] for part in parts]
    first = variables[0]
    for other in variables:
        if dict(first.sizes) | {dim: 0} != dict(other.sizes) | {dim: 0} or other.dims != first.dims:
            shapes = f"{dict(first.sizes)} and {dict(other.sizes)}"
            raise file.error(name, f"expected one shape, got {shapes}")
    times = np.unique(np.concatenate([part[0] for part in parts]))
    number, place = np.full(times.size, -1), np.zeros(times.size, int)
    begin, doubt = None, ""
    for k, (own, variable) in enumerate(parts):
        at = np.searchsorted(times, own)
        if (odd := np.diff(at) != 1).any():
            i = int(odd.argmax())
            between = own[i + 1] if at[i + 1] <= at[i] else times[at[i] + 1]
            why = f"expected records in order from file to file, got {between} after {own[i]}"
            raise file.error(name, why)
        if (again := number[at] >= 0).any() and own[0] == begin:
            last = int(np.flatnonzero(again)[-1])
            before = variables[number[at[last]]].isel({dim: int(place[at[last]])})
            if not before.equals(variable.isel({dim: last})):
                differ = f"two files that begin at {begin} have different values at {own[last]}"
                expected = "files of one model run, or runs that begin one after the other"
                raise file.error(name, f"{differ}; expected {expected}")
        elif again.any():
            doubt = f"records until {own[again][-1]} are in more than one file; those of the file"
            doubt += " that begins last are used"
        number[at], place[at], begin = k, np.arange(at.size), own[0]
    records = [(variables[k], at) for k, at in zip(number, place.tolist(), strict=True)]
    data = indexing.LazilyIndexedArray(_Records(first.dims.index(dim), records))
    return xr.Variable(first.dims, data, first.attrs), doubt
