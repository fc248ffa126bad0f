"""Idealised models on a plane, whose positions are in metres."""

import dataclasses

import numpy as np
import xarray as xr

from ...base.doubts import Doubt, warn
from ..axes.dimensions import axis_kind
from ..conventions import LENGTHS, POINTS, STAGGERED, find
from ..netcdf import OceanFile
from ..sphere import EARTH_RADIUS


LON, LAT = "x_as_longitude", "y_as_latitude"
"The names of the longitudes and latitudes of a plane."


def on_earth(file: OceanFile, u: str) -> OceanFile:
    """Put the middle of a plane at 0 N 0 E, with the sides of its cells in metres.

    Files with longitudes or a projection are returned unchanged.
    """
    dataset = file.dataset
    kinds = {axis_kind(dataset, str(dim)): str(dim) for dim in dataset[u].dims}
    if not {"y", "x"} <= set(kinds) or file.positions or "grid_mapping" in dataset[u].attrs:
        return file
    rho = [STAGGERED.get(kinds[kind], kinds[kind]) for kind in ("y", "x")]
    found: dict[str, xr.Variable] = {}
    for name, variable in dataset.variables.items():
        units = str(variable.attrs.get("units", "")).lower()
        if set(variable.dims) <= set(rho) and variable.ndim and units in LENGTHS:
            stem = POINTS.sub("", str(name).lower()).partition("_")[0]
            kind = axis_kind(dataset, str(name)) or stem
            if kind in ("y", "x") and axis_kind(dataset, str(name)) in (None, kind):
                found.setdefault(kind, variable.astype(float) * LENGTHS[units])
    on_cells = [str(name) for name, v in dataset.variables.items() if set(v.dims) <= set(rho)]
    if len(found) < 2 or find(dataset, "lon", [n for n in on_cells if n not in rho]):
        return file
    sizes = {dim: dataset.sizes[dim] for dim in rho}
    x, y = (found[kind].set_dims(sizes).transpose(*rho).values for kind in ("x", "y"))
    middle = [(np.nanmin(values) + np.nanmax(values)) / 2 for values in (x, y)]
    lon, lat = (np.degrees((v - m) / EARTH_RADIUS) for v, m in zip((x, y), middle, strict=True))
    sides = [np.hypot(*(np.gradient(values, axis=axis) for values in (x, y))) for axis in (1, 0)]
    new = {LON: lon, LAT: lat, "pm": 1 / sides[0], "pn": 1 / sides[1]}
    unit = {LON: "degrees_east", LAT: "degrees_north"}
    placed = {n: xr.Variable(rho, v, {"units": unit.get(n, "m-1")}) for n, v in new.items()}
    warn(
        f"{file.name}: on a plane in metres; the middle ({middle[0]:g}, {middle[1]:g}) is put at "
        "0 N 0 E, and squares without a velocity are land",
        Doubt,
    )
    return dataclasses.replace(file, dataset=dataset.assign(placed))
