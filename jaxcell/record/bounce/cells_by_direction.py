import os
import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr
import zarr
from zarr.codecs import BloscCodec

from ...base.paths import replacing
from ...base.process import library_writes
from ...base.quantities import quantities, quantity, values
from ...bounce import BounceGroups
from ...mapping import GroupSummary
from ..data.dataset import attributes_of, check_attributes
from ..provenance import cell_coordinates, provenance


_ABOUT = {
    **quantities(BounceGroups),
    "image": quantity("bounce direction position", "cell that it is mapped to", kind="cell"),
}
_TABLES = ("group_period", "group_basin", "group_transient")
CHUNK = 2**22
"""Largest number of cells in a chunk. A Zarr store has a file per chunk."""
_CODEC = BloscCodec(cname="lz4", clevel=1, shuffle="shuffle")


def save_cells(
    result: BounceGroups, path: str | os.PathLike[str], *, spec: Mapping[str, Any] | None = None
) -> None:
    """Write the group of each cell to a Zarr store, atomically, for maps of any size.

    The store has the variables of the dataset of the groups, and `image`, the cell to which each
    cell is mapped. Cells are computed and written one direction at a time to save memory.

    **Arguments:**

    - `result`: the groups.
    - `path`: the folder to write or replace, such as `groups.zarr`.
    - `spec`: the parameters, for the attribute `spec` as JSON.

    **Raises:** `FileNotFoundError` if the parent folder does not exist; `RuntimeError` if the
    written cells contradict the numbers of `result`.

    A corridor of three squares; cells 0, 1, 2 look East and 3, 4, 5 West:

        >>> import math
        >>> import xarray as xr
        >>> from jaxcell import bounce, examples, record
        >>> groups = bounce.BounceGroups.of(examples.corridor(), math.pi)
        >>> path = examples.folder() / "groups.zarr"
        >>> record.save_cells(groups, path)
        >>> xr.open_zarr(path).image.values.tolist()
        [[[1, 2, 5], [0, 3, 4]]]
    """
    cells = result.cells
    with replacing(path) as temporary:
        numbers = {
            name: (about.dims, array, attributes_of(about))
            for name, (about, array) in values(
                result, lambda _, one: one.dims == ("bounce",)
            ).items()
        }
        title = provenance(result.title, cells, spec)
        variables = xr.Dataset(numbers, cell_coordinates(cells), title).set_coords("bounce_deg")
        with library_writes(os.path.basename(path)):
            variables.to_zarr(temporary, zarr_format=3, consolidated=False)
        store = zarr.open_group(temporary)
        store.attrs.update(check_attributes(result.title, _write_cells(store, result)))
        with warnings.catch_warnings():
            # xarray reads consolidated metadata, although the standard does not have them yet.
            warnings.filterwarnings("ignore", message="Consolidated metadata")
            zarr.consolidate_metadata(temporary)


def _write_cells(store: zarr.Group, result: BounceGroups) -> dict[str, tuple[int, int]]:
    """Write the arrays over cells; return each check's number of violations and its limit, 0."""
    cells = result.cells
    shape = len(result.bounce), cells.directions, cells.positions
    arrays = {
        name: _quantity(store, name, shape, bool if one.kind == "flag" else np.int32)
        for name, one in _ABOUT.items()
        if one.dims == ("bounce", "direction", "position")
    }
    sums: list[list[np.ndarray]] = []
    violations = differ = 0
    for i, groups in enumerate(result.by_angle()):
        period, basin, transient = np.zeros((3, groups.period.size), np.int32)
        for direction in range(cells.directions):
            leads = groups.of_cells(direction)
            group, step = leads.group, leads.step
            here = {**vars(leads), "period": groups.period[group], "periodic": step == 0}
            for name, array in arrays.items():
                array[i, direction] = here[name]
            period += np.bincount(group[step == 0], minlength=period.size)
            basin += np.bincount(group, minlength=period.size)
            np.maximum.at(transient, group, step)
            # Use only images in this direction, because a bump leads to another direction.
            image = leads.image - direction * cells.positions
            ahead = np.flatnonzero((image >= 0) & (image < cells.positions))
            same = group[image[ahead]] == group[ahead]
            nearer = step[image[ahead]] == np.maximum(step[ahead] - 1, 0)
            violations += int(np.count_nonzero(~(same & nearer)))
        sums.append([period, basin, transient])
        totals = GroupSummary(np.array(period.size), period, basin, transient).totals()
        differ += sum(int(one != getattr(result, name)[i]) for name, one in vars(totals).items())
        differ += int(np.count_nonzero(period != groups.period))
    width = max(one[0].size for one in sums)
    for name, tables in zip(_TABLES, zip(*sums, strict=True), strict=True):
        array = _quantity(store, name, (len(sums), width), np.int32)
        for i, table in enumerate(tables):
            array[i] = np.append(table, np.full(width - table.size, -1))
    return {"image_violations": (violations, 0), "numbers_not_those_of_cells": (differ, 0)}


def _quantity(store: zarr.Group, name: str, shape: tuple[int, ...], dtype: Any) -> zarr.Array:
    return store.create_array(
        name,
        shape=shape,
        # A chunk has one direction of one angle.
        chunks=(1,) * (len(shape) - 1) + (max(1, min(shape[-1], CHUNK)),),
        dtype=dtype,
        compressors=_CODEC,
        attributes=attributes_of(_ABOUT[name]),
        dimension_names=_ABOUT[name].dims,
    )
