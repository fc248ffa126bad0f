"""What is special in NEMO: its dimensions do not say on which points of the grid values stand.

It puts `u` on the eastern sides of the cells and `v` on the northern ones, along the axes of a grid
that is curved, and calls the dimensions alike. The centres are in a file of their own, the mesh.
"""

import dataclasses

import numpy as np
import xarray as xr

from .axes.dimensions import axis_kind
from .conventions import CONVENTIONS, POINTS
from .netcdf import OceanFile
from .sphere import wrapped


# The dimensions of centres and sides, as those of ROMS: in the order y, x.
_DIMS = {"t": ("y_rho", "x_rho"), "u": ("y_rho", "x_u"), "v": ("y_v", "x_rho")}
_OF_THE_MESH = {name: one.point for one in CONVENTIONS if one.point for name in one.names}
# The depths of its levels.
_LEVELS = ("gdept_1d", "gdept_0", "nav_lev")


def on_points(file: OceanFile, u: str, v: str) -> OceanFile:
    """A file of NEMO, on dimensions that say on which points values stand; any other as it is.

    **Arguments:**

    - `file`: an open file, with the mesh.
    - `u`, `v`: the names of the velocities.

    **Raises:** `ValueError` if the velocities stand on the sides of cells whose centres are not in
    the file, or the levels of the mesh are others.
    """
    dataset = file.dataset
    kinds = {axis_kind(dataset, str(dim)): str(dim) for dim in dataset[u].dims}
    y, x, depth = (kinds.get(kind) for kind in ("y", "x", "depth"))
    if y is None or x is None or not _on_sides(file, u, {y, x}):
        return file
    if not {"glamt", "gphit"} <= set(dataset.variables):
        raise file.error(
            u,
            "on the sides of the cells of NEMO's grid, whose centres (glamt, gphit) are in another "
            "file; name mesh_mask.nc, domain_cfg.nc or coordinates.nc with grid",
        )
    placed = {}
    for name, point in {**_OF_THE_MESH, u: "u", v: "v"}.items():
        if name not in dataset.variables:
            continue
        array = dataset[name].drop_vars(dataset[name].coords)
        kinds = {axis_kind(dataset, str(dim)): str(dim) for dim in array.dims}
        across = dict(zip((kinds["y"], kinds["x"]), _DIMS[point], strict=True))
        for dim in array.dims:
            if dim not in across and dim not in (kinds.get("time"), depth):
                array = _levelled(file, array, str(dim), depth)
        placed[name] = array.rename(across)
    flat = [name for name, one in dataset.variables.items() if not {y, x} & set(one.dims)]
    return dataclasses.replace(file, dataset=dataset[flat].assign(placed))


def _on_sides(file: OceanFile, u: str, dims: set[str]) -> bool:
    """Whether a velocity stands on the sides of the cells of NEMO's grid.

    Its depths, dimensions or positions may be called after the points; else it does where it is not
    at the centres of the mesh.
    """
    dataset = file.dataset
    if dims & set(dataset.variables):
        return False
    words = [str(word).lower() for word in (*dataset[u].dims, *file.coordinates(u))]
    points = {found[1] for found in map(POINTS.search, words) if found}
    if points or "depthu" in words:
        return points <= {"u"}
    mesh = {"glamt", "glamu"} <= set(dataset.variables)
    if not mesh or "nav_lon" not in dataset.variables:
        return mesh
    here = file.read(dataset["nav_lon"])
    off = {
        which: np.nanmedian(np.abs(wrapped(here - file.read(dataset[which]))))
        for which in ("glamt", "glamu")
    }
    return bool(off["glamu"] < off["glamt"])


def _levelled(file: OceanFile, array: xr.DataArray, dim: str, depth: str | None) -> xr.DataArray:
    """A part of the mesh at the levels of the velocity, the highest where that has only one."""
    if depth is None:
        return array.isel({dim: 0}, drop=True)
    if array.sizes[dim] == file.dataset.sizes[depth]:
        return array.rename({dim: depth})
    variables = file.dataset.variables
    known = next(
        (name for name in _LEVELS if name in variables and dim in variables[name].dims), ""
    )
    wanted = file.read(file.dataset[depth])
    levels = file.read(file.dataset[known]) if known else np.zeros(0)
    places = np.abs(levels - wanted[:, None]).argmin(axis=1) if levels.ndim == 1 and known else None
    if places is None or (np.abs(levels[places] - wanted) > 0.01 * wanted + 0.01).any():
        raise file.error(
            str(array.name),
            f"expected the {wanted.size} levels of {depth}, got {array.sizes[dim]} ({dim})",
        )
    return array.isel({dim: places}).rename({dim: depth})
