"""Files of NEMO, whose dimensions do not distinguish cell centres from cell faces.

`u` is on the eastern cell faces and `v` on the northern cell faces, along the axes of a curved
grid. The positions of the cell centres are in another file, the mesh.
"""

import dataclasses

import numpy as np
import xarray as xr

from ..axes.dimensions import axis_kind
from ..conventions import CONVENTIONS, POINTS
from ..netcdf import OceanFile
from ..sphere import wrapped


# The dimensions of centres and sides, as those of ROMS: in the order y, x.
_DIMS = {"t": ("y_rho", "x_rho"), "u": ("y_rho", "x_u"), "v": ("y_v", "x_rho")}
_OF_THE_MESH = {name: row.point for row in CONVENTIONS if row.point for name in row.names}
# The names of the depths of levels in the mesh.
_LEVELS = ("gdept_1d", "gdept_0", "nav_lev")


def on_points(file: OceanFile, u: str, v: str) -> OceanFile:
    """Give the dimensions of a NEMO file the names of ROMS, which distinguish cell faces.

    The variables of the mesh must be in the file. Other files are returned unchanged.
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
            "file; name mesh_mask.nc, domain_cfg.nc or coordinates.nc with grid (--grid FILE)",
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
                array = _at_levels(file, array, str(dim), depth)
        placed[name] = array.rename(across)
    flat = [name for name, v in dataset.variables.items() if not {y, x} & set(v.dims)]
    return dataclasses.replace(file, dataset=dataset[flat].assign(placed))


def _on_sides(file: OceanFile, u: str, dims: set[str]) -> bool:
    """Return whether a velocity is on the cell faces of NEMO's grid.

    The names of its depths, dimensions or positions decide; or else whether its positions are
    nearer to the faces of the mesh than to the centres.
    """
    dataset = file.dataset
    if dims & set(dataset.variables):
        return False
    words = [str(word).lower() for word in (*dataset[u].dims, *file.coordinates(u))]
    points = {match[1] for match in map(POINTS.search, words) if match}
    if points or "depthu" in words:
        return points <= {"u"}
    mesh = {"glamt", "glamu"} <= set(dataset.variables)
    if not mesh or "nav_lon" not in dataset.variables:
        return mesh
    lon = file.read(dataset["nav_lon"])
    centres, sides = (
        np.nanmedian(np.abs(wrapped(lon - file.read(dataset[name])))) for name in ("glamt", "glamu")
    )
    return bool(sides < centres)


def _at_levels(file: OceanFile, array: xr.DataArray, dim: str, depth: str | None) -> xr.DataArray:
    """Select the levels of a mesh variable that the velocity has too, and rename `dim` to `depth`.

    If the velocity has no levels (`depth` is `None`), the highest level is selected.
    """
    if depth is None:
        return array.isel({dim: 0}, drop=True)
    if array.sizes[dim] == file.dataset.sizes[depth]:
        return array.rename({dim: depth})
    wanted, variables = file.read(file.dataset[depth]), file.dataset.variables
    for name in _LEVELS:
        if name in variables and variables[name].dims == (dim,):
            levels = file.read(file.dataset[name])
            places = np.abs(levels - wanted[:, None]).argmin(axis=1)
            if (np.abs(levels[places] - wanted) <= 0.01 * wanted + 0.01).all():
                return array.isel({dim: places}).rename({dim: depth})
    why = f"expected the {wanted.size} levels of {depth}, got {array.sizes[dim]} ({dim})"
    raise file.error(str(array.name), why)
