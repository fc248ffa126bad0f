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
# The names of masks of MOM6, and of masks or open shares of cells and sides of MITgcm.
_MASKS = {"mask_rho": ("wet", "maskC", "hFacC"), "mask_u": ("wet_u", "maskW", "hFacW"),
          "mask_v": ("wet_v", "maskS", "hFacS")}  # fmt: skip


def on_points(file: OceanFile, u: str, v: str) -> OceanFile:
    """Rename the dimensions of an MITgcm file and order its cell faces as in a file of ROMS.

    In a file of MITgcm the first face lies before the first cell centre, in a file of ROMS after
    it. So the first face moves to the end, or is left out if there are more faces than centres.
    Other files are returned unchanged.
    """
    dataset = file.dataset
    for dim in ("tile", "face"):
        if (faces := dataset[u].sizes.get(dim, 1)) > 1:
            raise file.error(
                u,
                f"on {faces} faces ({dim}), each with axes of its own; take one face, "
                f"dataset.isel({dim}=0), or a product on longitudes and latitudes (of ECCO those "
                "of half a degree, with EVEL and NVEL)",
            )
    sides = [[str(dim) for dim in dataset[name].dims if dim in _CENTRES] for name in (u, v)]
    if list(map(len, sides)) != [1, 1]:
        return file
    [x_side], [y_side] = sides
    x, y = _CENTRES[x_side], _CENTRES[y_side]
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
        position = next((dataset[axis] for axis in known if axis in dataset.variables), None)
        if position is None or str(position.attrs.get("units", "")).lower().startswith("m"):
            raise file.error(
                u, "expected longitudes and latitudes of its cells (XC, YC) in degrees; if another "
                "file has them, name it with grid (--grid FILE)",
            )  # fmt: skip
        variables[name] = placed(position)
    for name, masks in _MASKS.items():
        for mask in masks:
            if mask in dataset.variables:
                array = dataset[mask]
                variables.setdefault(name, placed(array.copy(data=file.read(array) > 0)))
    return dataclasses.replace(file, dataset=xr.Dataset(variables))
