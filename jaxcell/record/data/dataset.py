import dataclasses
import math
import os
from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from ...base.paths import replacing
from ...base.process import library_writes
from ...base.quantities import PROBABILITY, Checks, Quantity, Result, parts, unsigned, values
from ...space import CellSpace
from ..provenance import cell_coordinates, provenance
from .summary import cells_of


def dataset(result: Result, *, spec: Mapping[str, Any] | None = None) -> xr.Dataset:
    """Convert a result to a dataset, labelled with the descriptions of its quantities.

    Each quantity becomes a variable with its meaning, units and kind as attributes. If a field is
    itself a result, the names of its variables, but not of its coordinates, begin with the name of
    the field. Arrays of Python objects are left out. If the result has cells, the dataset has their
    coordinates: `x` and `y` over `position`, `theta` over `direction`.

    **Arguments:**

    - `result`: the result of a study.
    - `spec`: the parameters of the study, for the attribute `spec` as JSON.

    **Returns:** an `xarray.Dataset` for [`jaxcell.record.save_dataset`][].

    **Raises:** `ValueError` if `spec` cannot be written as JSON; `RuntimeError` if a number is out
    of the range of its kind, or if a check of the result fails.

    The groups of a robot that bounces in a lab:

        >>> from jaxcell import record, study
        >>> groups = study.Groups(map="@lab_a", bounce=(45.0,)).run()
        >>> record.dataset(groups).step.attrs["long_name"]
        'mappings until the cell is on its group'
    """
    cells = cells_of(result)
    attributes = {**provenance(result.title, cells, spec), **result.attributes}
    variables = xr.Dataset(attrs=attributes)
    if cells is not None:
        variables = variables.assign_coords(cell_coordinates(cells))
    for name, (described, value) in _flat(result).items():
        array = np.asarray(value)
        if array.dtype == object:
            continue
        variable = xr.Variable(described.dims, array, attributes_of(described))
        if described.kind == "coordinate":
            variables = variables.assign_coords({name: variable})
        else:
            variables[name] = variable
    checks = {**_checks_of_kinds(variables, cells), **_checks(result, "")}
    return variables.assign_attrs(check_attributes(result.title, checks))


def save_dataset(dataset: xr.Dataset, path: str | os.PathLike[str]) -> None:
    """Write a dataset as a compressed NetCDF-4 file, atomically.

    **Arguments:**

    - `dataset`: the dataset.
    - `path`: the file to write or replace.

    **Raises:** `FileNotFoundError` if the folder does not exist.

    A dataset, written and read again:

        >>> import xarray as xr
        >>> from jaxcell import examples, record
        >>> path = examples.folder() / "result.nc"
        >>> record.save_dataset(xr.Dataset({"steps": ("cell", [1, 2])}), path)
        >>> xr.load_dataset(path).steps.values.tolist()
        [1, 2]
    """
    encoding = {
        name: {"zlib": True, "complevel": 1, "_FillValue": None}
        for name, variable in dataset.variables.items()
        if variable.ndim and variable.dtype.kind in "bif"
    }
    with replacing(path) as temporary, library_writes(os.path.basename(path)):
        dataset.to_netcdf(temporary, format="NETCDF4", engine="netcdf4", encoding=encoding)


def attributes_of(described: Quantity) -> dict[str, Any]:
    """Return the attributes of the variable for a quantity, such as `long_name` and `units`."""
    attributes = {"long_name": described.meaning, **described.attributes}
    if described.units is not None:
        attributes["units"] = described.units
    return attributes if described.kind == "coordinate" else attributes | {"kind": described.kind}


def check_attributes(title: str, checks: Checks) -> dict[str, float | int]:
    """Return the value of each check, for the attributes `check_<name>` of a dataset.

    A value above its limit raises `RuntimeError`. The limits are far above rounding errors, so only
    wrong arrays exceed them.
    """
    for name, (value, limit) in checks.items():
        if not (value <= limit or limit == np.inf):
            raise RuntimeError(
                f"{title}: the result contradicts itself: {name} is {value:g}, "
                f"expected at most {limit:g}"
            )
    return {f"check_{name}": unsigned(value) for name, (value, _) in checks.items()}


def _flat(result: Result) -> dict[str, tuple[Quantity, Any]]:
    flat = dict(values(result))
    for name, part in parts(result).items():
        if isinstance(part, tuple):
            flat |= _along(name.removesuffix("s"), part)
            continue
        for key, (about, value) in _flat(part).items():
            # Parts share dimensions, and the coordinates of dimensions.
            flat[key if about.kind == "coordinate" else f"{name}_{key}"] = about, value
    return flat


def _along(dim: str, members: tuple[Result, ...]) -> dict[str, tuple[Quantity, np.ndarray]]:
    """Combine each single number of several results into an array along the dimension `dim`."""
    rows = [values(member, lambda _, about: not about.dims) for member in members]
    return {
        f"{dim}_{name}": (
            dataclasses.replace(about, dims=(dim,)),
            np.array([row[name][1] for row in rows]),
        )
        for name, (about, _) in rows[0].items()
        if all(name in row for row in rows)
    }


def _checks(result: Result, prefix: str) -> Checks:
    checks = {prefix + name: check for name, check in result.checks().items()}
    for name, part in parts(result).items():
        if not isinstance(part, tuple):
            checks |= _checks(part, f"{prefix}{name}_")
    return checks


def _checks_of_kinds(dataset: xr.Dataset, cells: CellSpace | None) -> Checks:
    """Return checks that the values of each variable are possible for its kind, as for shares."""
    checks: dict[str, tuple[float, float]] = {}
    for name, variable in dataset.data_vars.items():
        kind, array = variable.attrs.get("kind"), np.atleast_1d(variable.values)
        if "padding" in variable.attrs:
            array = _without(array, float(variable.attrs["padding"].partition(":")[0]))
        if kind in ("share", "distribution") and array.size:
            checks[f"{name}_out_of_0_to_1"] = (_most(-array, array - 1), PROBABILITY)
        if kind == "distribution":
            over = variable.attrs.get("over", variable.dims[-1]).split()
            sums = np.atleast_1d(variable.sum(over).values)
            checks[f"{name}_sums_to_1"] = (_most(np.abs(sums - 1)), PROBABILITY)
        if kind == "time":
            # Unknown times are NaN.
            array = _without(array, math.nan)
        if kind in ("count", "time") and array.size:
            checks[f"{name}_below_0"] = (_most(-array.astype(float)), 0)
        if kind in ("cell", "index", "place", "position") and array.size:
            checks[f"{name}_below_minus_1"] = (_most(-1 - array.astype(float)), 0)
        if kind in ("cell", "position") and cells is not None:
            size = cells.size if kind == "cell" else cells.positions
            checks[f"{name}_not_of_the_map"] = (int(np.count_nonzero(array >= size)), 0)
    return checks


def _without(array: np.ndarray, padding: float) -> np.ndarray:
    return array[~np.isnan(array) if math.isnan(padding) else array != padding]


def _most(*arrays: np.ndarray) -> float:
    """Return the largest value, but at least 0; NaN if an array contains NaN."""
    return float(max(np.max(array, initial=0.0) for array in arrays))
