"""Records of several files as one, each of them read from its own file when it is asked for."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Shaped
from xarray.backends import BackendArray
from xarray.core import indexing

from .axes.dimensions import axis_kind
from .axes.times import read_times, time_variable
from .netcdf import OceanFile


class _Records(BackendArray):
    """A variable of several files, one after another along an axis."""

    def __init__(self, parts: Sequence[xr.Variable], axis: int) -> None:
        self.parts, self.axis = parts, axis
        self.first = np.cumsum([0, *(part.shape[axis] for part in parts)])
        self.dtype = np.result_type(*(part.dtype for part in parts))
        shape = parts[0].shape
        self.shape = (*shape[:axis], int(self.first[-1]), *shape[axis + 1 :])

    def __getitem__(self, key: indexing.ExplicitIndexer) -> Any:
        support = indexing.IndexingSupport.OUTER
        return indexing.explicit_indexing_adapter(key, self.shape, support, self._read)

    def _read(self, key: tuple[Any, ...]) -> np.ndarray:
        asked = np.arange(self.shape[self.axis])[key[self.axis]]
        read = []
        for record in np.atleast_1d(asked):
            number = int(np.searchsorted(self.first, record, side="right")) - 1
            place = int(record - self.first[number])
            here = (*key[: self.axis], place, *key[self.axis + 1 :])
            part = self.parts[number]
            read.append(part.isel(dict(zip(part.dims, here, strict=True))).values)
        if asked.ndim == 0:
            return read[0]
        return np.stack(read, axis=sum(np.ndim(one) > 0 or isinstance(one, slice)
                                       for one in key[: self.axis]))  # fmt: skip


def join_records(files: Sequence[OceanFile], name: str) -> OceanFile:
    """Several files as one, with dates in place of the times that each counts from its own.

    Their records are put in the order of time. What does not change in time is from the first file
    that has it, and what is not at all records is left out.

    **Arguments:**

    - `files`: those that are open.
    - `name`: what they are called together.

    **Raises:** `ValueError` if their records do not go together, or their lengths.
    """
    joined = OceanFile(name, xr.Dataset())
    fixed: dict[str, xr.Variable] = {}
    moving: dict[str, list[tuple[np.ndarray, xr.Variable]]] = {}
    dates: dict[str, list[np.ndarray]] = {}
    for file in files:
        dims = (str(dim) for dim in file.dataset.dims)
        dim = next((dim for dim in dims if axis_kind(file.dataset, dim) == "time"), "")
        variables = {str(name): one for name, one in file.dataset.variables.items()}
        if dim:
            own = str(time_variable(file, dim))
            dates.setdefault(dim, []).append(read_times(file, own))
            variables = {name: one for name, one in variables.items() if name not in (dim, own)}
        for name, variable in variables.items():
            if dim in variable.dims:
                moving.setdefault(name, []).append((dates[dim][-1], variable))
            else:
                fixed.setdefault(name, variable)
    if len(dates) != 1 or len({one.dtype.kind for one in next(iter(dates.values()))}) > 1:
        raise joined.error("time", f"expected one dimension and calendar, got {', '.join(dates)}")
    [(dim, found)] = dates.items()
    times = np.unique(np.concatenate(found))
    whole = {}
    for name, parts in moving.items():
        variable = _joined(joined, name, dim, parts)
        if variable.sizes[dim] == times.size:
            whole[name] = variable
    if not whole:
        raise joined.error(
            "time", f"no variable is at each of the {times.size} records of these files; expected "
            "the same ones for u and v",
        )  # fmt: skip
    about = {} if times.dtype.kind in "MO" else {"units": "seconds"}
    try:
        dataset = xr.Dataset(fixed | whole | {dim: xr.Variable(dim, times, about)})
    except ValueError as error:
        raise joined.error("time", f"these files do not go together: {error}") from error
    return OceanFile(joined.name, dataset)


def _joined(
    file: OceanFile,
    name: str,
    dim: str,
    parts: list[tuple[Shaped[np.ndarray, " _records"], xr.Variable]],
) -> xr.Variable:
    """A variable of several files, with their times, one after another."""
    parts = sorted(parts, key=lambda part: part[0][0])
    times = np.concatenate([part[0] for part in parts])
    again = times[1:] <= times[:-1]
    if again.any():
        k = int(again.argmax())
        raise file.error(
            name,
            f"expected records in order from file to file, got {times[k + 1]} after {times[k]}",
        )
    variables = [part[1] for part in parts]
    first = variables[0]
    for one in variables:
        if one.dims != first.dims or one.isel({dim: 0}).shape != first.isel({dim: 0}).shape:
            raise file.error(
                name, f"expected one shape, got {dict(first.sizes)} and {dict(one.sizes)}"
            )
    axis = first.dims.index(dim)
    data = indexing.LazilyIndexedArray(_Records(variables, axis))
    return xr.Variable(first.dims, data, first.attrs)
