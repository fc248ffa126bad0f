"""The dataset and the summary of any result, from the descriptions of its quantities."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from ...base.quantities import Checks, Quantity, Result, columns, flat, parts, values
from ...space import CellSpace
from ..checks import PROBABILITY, with_checks
from ..provenance import cell_coordinates, provenance


def dataset(result: Result, *, spec: Mapping[str, Any] | None = None) -> xr.Dataset:
    """A result as a labelled dataset.

    Each quantity is a variable with its meaning, units and kind as attributes; those of a part
    begin with the name of the part. A result on cells has their coordinates: over `position` `x`
    and `y`, over `direction` `theta`.

    **Arguments:**

    - `result`: what a study gave.
    - `spec`: what was asked for, kept as JSON in the attribute `spec`.

    **Returns:** an `xarray.Dataset` for [`jaxcell.record.save_dataset`][].

    **Raises:** `ValueError` if `spec` is not JSON; `RuntimeError` if the numbers contradict what
    their kinds or the relations between them say.
    """
    cells = getattr(result, "cells", None)
    found = xr.Dataset(attrs=provenance(result.title, cells, spec))
    if cells is not None:
        found = found.assign_coords(cell_coordinates(cells))
    for name, (described, value) in flat(result).items():
        array = np.asarray(value)
        attributes = {"long_name": described.meaning, **described.attributes}
        if described.units is not None:
            attributes["units"] = described.units
        variable = xr.Variable(described.dims, array, attributes)
        if described.kind == "coordinate":
            found = found.assign_coords({name: variable})
        else:
            variable.attrs["kind"] = described.kind
            found[name] = variable
    return with_checks(found, {**_checks_of_kinds(found), **_checks(result, "")})


def summary(result: Result, cells: CellSpace | None = None) -> dict[str, Any]:
    """The numbers of a result that a person or a script wants, as JSON has them.

    Single numbers and texts, listed arrays, and a list of rows for each of `result.tables`; a part
    has an object of its own. What is not finite is `None`.

    **Arguments:**

    - `result`: what a study gave.
    - `cells`: those on which its positions are; by default its own.
    """
    cells = getattr(result, "cells", None) if cells is None else cells
    found = {
        name: _plain(value, about, cells)
        for name, (about, value) in values(result).items()
        if not about.dims or (about.listed and len(about.dims) == 1)
    }
    for dim, table in result.tables.items():
        rows = {
            name: _plain(value, about, cells)
            for name, (about, value) in columns(result, dim).items()
        }
        if rows:
            found[table] = [
                dict(zip(rows, row, strict=True)) for row in zip(*rows.values(), strict=True)
            ]
    return found | {name: summary(part, cells) for name, part in parts(result).items()}


def place(cells: CellSpace, position: int) -> dict[str, Any] | None:
    """A position with its place in metres; none for -1."""
    if position < 0:
        return None
    x, y, _ = cells.centre(position)
    return {"cell": position, "x": float(x), "y": float(y)}


def _checks(result: Result, prefix: str) -> Checks:
    """The relations that a result and its parts name."""
    found = {prefix + name: one for name, one in result.checks().items()}
    for name, part in parts(result).items():
        found |= _checks(part, f"{prefix}{name}_")
    return found


def _plain(value: Any, about: Quantity, cells: CellSpace | None) -> Any:
    """Numbers and texts as JSON has them."""
    if isinstance(value, str | bool | None):
        return value
    array = np.asarray(value)
    if about.kind == "position" and cells is not None:
        places = [place(cells, one) for one in array.ravel().tolist()]
        return places if array.ndim else places[0]
    if about.kind == "index" and array.ndim == 2:
        return [[one for one in row if one >= 0] for row in array.tolist()]
    if array.dtype.kind == "f":
        return _finite(array.tolist())
    return array.tolist()


def _finite(value: Any) -> Any:
    if isinstance(value, list):
        return [_finite(one) for one in value]
    return value if math.isfinite(value) else None


def _checks_of_kinds(found: xr.Dataset) -> Checks:
    """The largest violation of what the kind of each variable says."""
    checks: dict[str, tuple[float, float]] = {}
    for name, variable in found.data_vars.items():
        kind, array = variable.attrs.get("kind"), np.atleast_1d(variable.values)
        if kind in ("share", "distribution") and array.size:
            checks[f"{name}_out_of_0_to_1"] = (_most(-array, array - 1), PROBABILITY)
        if kind == "distribution":
            over = variable.attrs.get("over", variable.dims[-1]).split()
            sums = np.atleast_1d(variable.sum(over).values)
            checks[f"{name}_sums_to_1"] = (_most(np.abs(sums - 1)), PROBABILITY)
        if kind in ("count", "time") and array.size:
            checks[f"{name}_below_0"] = (_most(-array.astype(float)), 0)
        if kind in ("index", "position") and array.size:
            checks[f"{name}_below_minus_1"] = (_most(-1 - array.astype(float)), 0)
    return checks


def _most(*arrays: np.ndarray) -> float:
    """The largest value above 0; NaN if one is."""
    return float(max(np.max(array, initial=0.0) for array in arrays))
