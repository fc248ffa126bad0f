"""What currents are read from: files, stores, addresses, and datasets in hand."""

import contextlib
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TypeAlias

import numpy as np
import xarray as xr

from ...base.paths import ADDRESS, existing
from .axes.dimensions import axis_kind
from .conventions import find
from .netcdf import OceanFile, error_line, open_netcdf, open_undecoded, unwarned
from .records import join_records


Source: TypeAlias = str | os.PathLike[str] | Sequence[str | os.PathLike[str]] | xr.Dataset


@contextlib.contextmanager
def open_source(source: Source, grid: Source | None = None) -> Iterator[OceanFile]:
    """Open all that currents are in as one file, for the length of the block.

    Of several files the records go on from one to the next, in the order of time, and variables of
    different names are side by side. Nothing is read but positions and times.

    **Arguments:**

    - `source`: as `path` of [`jaxcell.drift.open_currents`][].
    - `grid`: the same for what does not change in time and is in a file of its own. What is in both
        is from there.

    **Raises:** `FileNotFoundError` if there is no such file; `ValueError` if it cannot be read, or
    if files do not fit one another.
    """
    with contextlib.ExitStack() as stack:
        stack.enter_context(unwarned())
        file = _opened(source, stack)
        if grid is not None:
            file = _with_grid(file, _opened(grid, stack))
        yield file


def source_name(source: Source) -> str:
    """What a source is called in results, without what leads to it."""
    if isinstance(source, xr.Dataset):
        return Path(str(source.encoding.get("source", "dataset"))).name
    return _joined([Path(path).name for path in _paths(source)])


def _joined(names: Sequence[str]) -> str:
    if len(names) <= 2:
        return ", ".join(names)
    return f"{names[0]} to {names[-1]} ({len(names)} files)"


def _paths(source: str | os.PathLike[str] | Sequence[str | os.PathLike[str]]) -> list[str]:
    """The paths that are meant, those that match a pattern in the order of their names."""
    several = [source] if isinstance(source, str | os.PathLike) else source
    paths = [path for one in several for path in existing(one)]
    if not paths:
        raise ValueError("path: expected a file or more, got none")
    return paths


def _opened(source: Source, stack: contextlib.ExitStack) -> OceanFile:
    if isinstance(source, xr.Dataset):
        return OceanFile(source_name(source), source.reset_coords())
    files = [_opened_alone(path, stack) for path in _paths(source)]
    if len(files) == 1:
        return files[0]
    clashing = _clashing_positions(files)
    parts = [
        OceanFile(file.name, file.dataset.drop_vars(clashing, errors="ignore")) for file in files
    ]
    return join_records(parts, _joined([file.name for file in files]))


def _opened_alone(path: str, stack: contextlib.ExitStack) -> OceanFile:
    """One file, Zarr store, or address of an OPeNDAP server."""
    if ADDRESS.match(path):
        path = ADDRESS.sub(r"\1://", path)
        engine, why = "netcdf4", "cannot be reached by OPeNDAP (no network, or no such dataset)"
    elif Path(path).is_dir():
        engine, why = "zarr", "cannot be read as a Zarr store"
    else:
        return stack.enter_context(open_netcdf(path))
    try:
        return OceanFile(path, stack.enter_context(open_undecoded(path, engine)))
    except Exception as error:  # what the libraries raise is not written
        raise ValueError(f"{path}: {why}: {error_line(error)}") from error


def _clashing_positions(files: list[OceanFile]) -> set[str]:
    """Longitudes and latitudes that differ where velocities stand on different points of a grid.

    **Raises:** `ValueError` for files with the same fields at different positions.
    """
    known: dict[str, tuple[OceanFile, np.ndarray]] = {}
    clashing = set()
    for file in files:
        variables = file.dataset.variables
        for role in ("lon", "lat"):
            names = (str(name) for name, one in variables.items() if one.ndim in (1, 2))
            if (name := find(file.dataset, role, names)) is None:
                continue
            values = file.read(file.dataset[name])
            other, before = known.setdefault(name, (file, values))
            if np.array_equal(values, before, equal_nan=True):
                continue
            fields = [{str(n) for n, v in one.dataset.data_vars.items() if v.ndim > 2}
                      for one in (file, other)]  # fmt: skip
            if values.ndim == 1 or fields[0] & fields[1]:
                raise file.error(name, f"not the same as in {other.name}; expected one grid")
            clashing.add(name)
    return clashing


def _with_grid(file: OceanFile, grid: OceanFile) -> OceanFile:
    """A file with the variables of another that do not change in time."""
    there, here = grid.dataset, file.dataset
    for dim, size in there.sizes.items():
        if axis_kind(there, str(dim)) == "time":
            there = there.isel({dim: 0}, drop=True) if size == 1 else there.drop_dims([dim])
        elif here.sizes.get(dim, size) != size:
            raise grid.error(
                str(dim), f"expected the length {here.sizes[dim]} of {file.name}, got {size}"
            )
        elif (
            dim in here.indexes
            and dim in there.indexes
            and not np.allclose(file.read(here[dim]), grid.read(there[dim]))
        ):
            raise grid.error(str(dim), f"not the same as in {file.name}; expected one grid")
    times = {dim for dim in here.dims if axis_kind(here, str(dim)) == "time"}
    moving = {name for name, one in here.variables.items() if times & set(one.dims)}
    # In the mesh of NEMO these repeat the centres; elsewhere they are positions of any points.
    plotted = {"nav_lon", "nav_lat"} if "glamt" in there.variables else set()
    there = there.reset_coords().drop_vars(moving | plotted | set(here.indexes), errors="ignore")
    elsewhere = {str(name): grid.name for name in there.variables}
    return OceanFile(file.name, here.assign(there.variables), elsewhere)
