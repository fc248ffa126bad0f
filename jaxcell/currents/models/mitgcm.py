"""Files of MITgcm and ECCO, whose velocities are on the western and southern cell faces, and of
MOM6, whose velocities are on the eastern and northern faces, or on all (symmetric memory)."""

import dataclasses

import numpy as np
import xarray as xr

from ..netcdf import OceanFile


# The dimensions of sides, and of the centres beside them, as named by diagnostics, ECCO and mnc.
_CENTRES = {"XG": "XC", "YG": "YC", "i_g": "i", "j_g": "j", "Xp1": "X", "Yp1": "Y",
            "xq": "xh", "yq": "yh"}  # fmt: skip
_POSITIONS = {"lon_rho": ("XC", "X", "geolon", "xh"), "lat_rho": ("YC", "Y", "geolat", "yh")}
# The last letter of the names of masks, or of open shares of cells or sides.
_MASKS = {"mask_rho": "C", "mask_u": "W", "mask_v": "S"}
_FACES = ("tile", "face")


def on_points(file: OceanFile, u: str, v: str) -> OceanFile:
    """Rename the dimensions of an MITgcm file and order its cell faces as in a file of ROMS.

    In a file of MITgcm the first face lies before the first cell centre, in a file of ROMS after
    it. So the first face moves to the end, or is left out if there are more faces than centres.
    Other files are returned unchanged.
    """
    dataset = file.dataset
    faces = [dim for dim in _FACES if dataset[u].sizes.get(dim, 1) > 1]
    if faces:
        raise file.error(
            u,
            f"on {dataset[u].sizes[faces[0]]} faces ({faces[0]}), each with axes of its own; take "
            f"one face, dataset.isel({faces[0]}=0), or a product on longitudes and latitudes (of "
            "ECCO those of half a degree, with EVEL and NVEL)",
        )
    across = {dim: _CENTRES[str(dim)] for dim in dataset[u].dims if dim in _CENTRES}
    along = {dim: _CENTRES[str(dim)] for dim in dataset[v].dims if dim in _CENTRES}
    if len(across) != 1 or len(along) != 1:
        return file
    [(x_side, x)], [(y_side, y)] = across.items(), along.items()
    if not {x, y} <= set(dataset.dims):
        raise file.error(u, f"on the sides of cells, whose centres ({x}, {y}) are in another file; "
                         "name it with grid (--grid FILE)")  # fmt: skip
    names = {x: "x_rho", y: "y_rho", x_side: "x_u", y_side: "y_v"}

    def placed(array: xr.DataArray) -> xr.Variable:
        """Rename the dimensions of a variable, and order cell faces to follow their centres."""
        for side, centre in ((x_side, x), (y_side, y)):
            if side in array.dims:
                count = dataset.sizes[centre]
                first = int(side not in ("xq", "yq") or dataset.sizes[side] > count)
                after = np.arange(first, count + first) % dataset.sizes[side]
                array = array.isel({side: after})
        levels = {"k": "Z"} if "k" in array.dims and "Z" in dataset.variables else {}
        kept = {old: new for old, new in {**names, **levels}.items() if old in array.dims}
        return array.drop_vars(array.coords).rename(kept).variable.to_base_variable()

    variables = {
        str(name): placed(dataset[name]) for name in dataset.variables if name not in names
    }
    for name, known in _POSITIONS.items():
        position = next((axis for axis in known if axis in dataset.variables), None)
        if position is None or str(dataset[position].attrs.get("units", "")).lower().startswith(
            "m"
        ):
            raise file.error(
                u, "expected longitudes and latitudes of its cells (XC, YC) in degrees; if another "
                "file has them, name it with grid (--grid FILE)",
            )  # fmt: skip
        variables[name] = placed(dataset[position])
    for name, mask in {"mask_rho": "wet", "mask_u": "wet_u", "mask_v": "wet_v"}.items():
        if mask in dataset.variables:
            variables[name] = placed(dataset[mask])
    for name, letter in _MASKS.items():
        for prefix in ("mask", "hFac"):
            if (open_share := f"{prefix}{letter}") in dataset.variables:
                array = dataset[open_share]
                variables.setdefault(name, placed(array.copy(data=file.read(array) > 0)))
    return dataclasses.replace(file, dataset=xr.Dataset(variables))
