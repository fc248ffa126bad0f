"""The sources of currents: files, stores, addresses, and open datasets."""

import contextlib
import functools
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TypeAlias

import numpy as np
import xarray as xr

from ..base.paths import ADDRESS, existing
from .axes.dimensions import axis_kind
from .conventions import find
from .netcdf import OceanFile, error_line, open_netcdf, open_undecoded, unwarned
from .parquet import read_parquet
from .records import join_records
from .said import Said


Source: TypeAlias = str | os.PathLike[str] | Sequence[str | os.PathLike[str]] | xr.Dataset


@contextlib.contextmanager
def open_source(
    source: Source, grid: Source | None = None, said: Said | None = None
) -> Iterator[OceanFile]:
    """Open all files of a source as one, as a context manager; only positions and times are read.

    Those variables of `grid` that do not change in time replace variables of the source.
    """
    with contextlib.ExitStack() as stack:
        stack.enter_context(unwarned())
        said = said or Said()
        file = _opened(source, stack, said)
        if grid is not None:
            file = _with_grid(file, _opened(grid, stack, Said(dims=said.dims)))
        yield said.placed(file)


def source_name(source: Source) -> str:
    """Return the name of a source in results: its file names, without folders."""
    if isinstance(source, xr.Dataset):
        return Path(str(source.encoding.get("source", "dataset"))).name
    return _joined([Path(path).name for path in paths_of(source)])


def _joined(names: Sequence[str]) -> str:
    if len(names) <= 2:
        return ", ".join(names)
    return f"{names[0]} to {names[-1]} ({len(names)} files)"


def paths_of(source: str | os.PathLike[str] | Sequence[str | os.PathLike[str]]) -> list[str]:
    """List the paths of a source; the matches of a pattern are sorted by name."""
    several = [source] if isinstance(source, str | os.PathLike) else source
    if not isinstance(several, Sequence):
        got = type(source).__name__
        raise ValueError(f"path: expected a file, a list of files or a dataset, got {got}")
    paths = [path for pattern in several for path in existing(pattern)]
    if not paths:
        raise ValueError("path: expected a file or more, got none")
    return paths


def _opened(source: Source, stack: contextlib.ExitStack, said: Said) -> OceanFile:
    if isinstance(source, xr.Dataset):
        # The names of scalar coordinates, such as a depth, are written to attributes as in a file.
        variables, attributes = xr.conventions.encode_dataset_coordinates(source)
        return said.named(OceanFile(source_name(source), xr.Dataset(variables, attrs=attributes)))
    files = [said.named(_opened_alone(path, stack, said.group)) for path in paths_of(source)]
    fields = [file for file in files if "glamt" not in file.dataset.variables]
    meshes = [file for file in files if "glamt" in file.dataset.variables] if fields else []
    parts = fields or files
    if len(parts) > 1:
        clashing = _clashing_positions(parts)
        kept = [file.dataset.drop_vars(clashing, errors="ignore") for file in parts]
        names = [file.name for file in parts]
        parts = [join_records(list(map(OceanFile, names, kept)), _joined(names))]
    return functools.reduce(_with_grid, meshes, parts[0])


def _opened_alone(path: str, stack: contextlib.ExitStack, group: str | None) -> OceanFile:
    """Open one file, Zarr store, or address of an OPeNDAP server."""
    if path.lower().endswith(".parquet"):
        return OceanFile(path, read_parquet(path))
    if ADDRESS.match(path):
        path = ADDRESS.sub(r"\1://", path)
        engine, why = "netcdf4", "cannot be reached by OPeNDAP (no network, or no such dataset)"
    elif Path(path).is_dir():
        engine, why = "zarr", "cannot be read as a Zarr store"
    else:
        return stack.enter_context(open_netcdf(path, group))
    try:
        return OceanFile(path, stack.enter_context(open_undecoded(path, engine, group)))
    except Exception as error:  # the exceptions of the libraries are not documented
        raise ValueError(f"{path}: {why}: {error_line(error)}") from error


def _clashing_positions(files: list[OceanFile]) -> set[str]:
    """Find longitudes and latitudes that differ between files, as for u and v on a C-grid."""
    known: dict[str, tuple[OceanFile, np.ndarray]] = {}
    clashing = set()
    for file in files:
        variables = file.dataset.variables
        for role in ("lon", "lat"):
            names = (str(name) for name, v in variables.items() if v.ndim in (1, 2))
            if (name := find(file.dataset, role, names)) is None:
                continue
            values = file.read(file.dataset[name])
            other, before = known.setdefault(name, (file, values))
            if np.array_equal(values, before, equal_nan=True):
                continue
            fields = [{n for n, v in one.dataset.items() if v.ndim > 2} for one in (file, other)]
            if values.ndim == 1 or set.intersection(*fields):
                raise file.error(name, f"not the same as in {other.name}; expected one grid")
            clashing.add(name)
    return clashing


def _with_grid(file: OceanFile, grid: OceanFile) -> OceanFile:
    """Add those variables of the file `grid` that do not change in time."""
    fixed, moving = grid.dataset, file.dataset
    for dim, size in fixed.sizes.items():
        shared = dim in moving.indexes and dim in fixed.indexes
        if axis_kind(fixed, str(dim)) == "time":
            fixed = fixed.isel({dim: 0}, drop=True) if size == 1 else fixed.drop_dims([dim])
        elif (length := moving.sizes.get(dim, size)) != size:
            raise grid.error(str(dim), f"expected the length {length} of {file.name}, got {size}")
        elif shared and not np.allclose(file.read(moving[dim]), grid.read(fixed[dim])):
            raise grid.error(str(dim), f"not the same as in {file.name}; expected one grid")
    times = {dim for dim in moving.dims if axis_kind(moving, str(dim)) == "time"}
    kept = {name for name, variable in moving.variables.items() if times & set(variable.dims)}
    # In a mesh of NEMO these repeat the positions of centres; in other files they are needed.
    plotted = {"nav_lon", "nav_lat"} if "glamt" in fixed.variables else set()
    fixed = fixed.reset_coords().drop_vars(kept | plotted | set(moving.indexes), errors="ignore")
    elsewhere = {str(name): grid.name for name in fixed.variables}
    return OceanFile(file.name, moving.assign(fixed.variables), elsewhere)
