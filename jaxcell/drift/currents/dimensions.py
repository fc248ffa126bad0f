"""Which dimension of a variable is time, depth, y and x, and where its longitudes are."""

import dataclasses
from typing import Literal, TypeAlias

import xarray as xr

from .netcdf import OceanFile


Kind: TypeAlias = Literal["time", "depth", "y", "x"]

# Dimensions of the staggered points of a C-grid, and of the cell centres (rho points) between them,
# as ROMS and CROCO name them, and CROCO where XIOS writes its files.
STAGGERED = {
    "xi_u": "xi_rho",
    "eta_u": "eta_rho",
    "xi_v": "xi_rho",
    "eta_v": "eta_rho",
    "x_u": "x_rho",
    "y_v": "y_rho",
}

_NAMES: dict[Kind, tuple[str, ...]] = {
    "time": ("time", "ocean_time", "scrum_time", "time_counter", "mt", "t"),
    "depth": ("depth", "depthu", "depthv", "z", "lev", "level", "s_rho", "sc_r", "z_slice"),
    "y": ("lat", "latitude", "y", "nj", "j", "eta_rho", "eta_u", "eta_v", "y_rho", "y_v", "rlat"),
    "x": ("lon", "longitude", "x", "ni", "i", "xi_rho", "xi_u", "xi_v", "x_rho", "x_u", "rlon"),
}
_STANDARD_NAMES: dict[str, Kind] = {
    "time": "time",
    "depth": "depth",
    "latitude": "y",
    "longitude": "x",
    "projection_y_coordinate": "y",
    "projection_x_coordinate": "x",
}
_POSITION_NAMES = {
    "lat": ("lat_rho", "nav_lat_rho", "lat", "latitude", "nav_lat"),
    "lon": ("lon_rho", "nav_lon_rho", "lon", "longitude", "nav_lon"),
}
_POSITION_STANDARD_NAMES = {"lat": "latitude", "lon": "longitude"}
_POSITION_UNITS = {
    "lat": ("degrees_north", "degree_north", "degrees_n", "degree_n"),
    "lon": ("degrees_east", "degree_east", "degrees_e", "degree_e"),
}


@dataclasses.dataclass(frozen=True)
class Axes:
    """The dimensions of a velocity.

    **Attributes:**

    - `time`, `depth`: their dimensions, or `None` where the variable has none.
    - `y`, `x`: the dimensions of the grid, on its staggered points where `staggered`.
    - `lon`, `lat`: the variables with the positions of the cell centres.
    """

    time: str | None
    depth: str | None
    y: str
    x: str
    lon: str
    lat: str

    @property
    def staggered(self) -> bool:
        """Whether the variable stands on the sides of the cells of a C-grid."""
        return self.rho != (self.y, self.x)

    @property
    def rho(self) -> tuple[str, str]:
        """The dimensions `(y, x)` of the cell centres."""
        return STAGGERED.get(self.y, self.y), STAGGERED.get(self.x, self.x)


def find_axes(file: OceanFile, name: str) -> Axes:
    """Find the dimensions of a velocity from what they are called and described as.

    **Raises:** `ValueError` if one of them cannot be determined, if there is no y or x, or if no
    longitudes and latitudes belong to them.
    """
    found: dict[Kind, str] = {}
    for dim, size in file.dataset[name].sizes.items():
        kind = axis_kind(file.dataset, str(dim))
        if kind is not None and kind not in found:
            found[kind] = str(dim)
        elif size > 1:
            why = "it is unknown" if kind is None else f"{found[kind]} is {kind} already"
            raise file.error(
                name, f"dimension {dim} of length {size}: expected time, depth, y or x; {why}"
            )
    for kind in ("y", "x"):
        if kind not in found:
            dims = ", ".join(map(str, file.dataset[name].dims)) or "none"
            raise file.error(name, f"expected a dimension for {kind}, got the dimensions {dims}")
    y, x = found["y"], found["x"]
    rho = STAGGERED.get(y, y), STAGGERED.get(x, x)
    lon, lat = (_position(file, name, which, rho) for which in ("lon", "lat"))
    return Axes(found.get("time"), found.get("depth"), y, x, lon, lat)


def is_rectangular(file: OceanFile, axes: Axes) -> bool:
    """Whether x is towards the East and y along a meridian: longitude depends on x only."""
    return all(
        file.dataset[name].dims == (dim,) for name, dim in ((axes.lon, axes.x), (axes.lat, axes.y))
    )


def axis_kind(dataset: xr.Dataset, dim: str) -> Kind | None:
    """By the name of the dimension, then by what its coordinate variable says of itself."""
    for kind, names in _NAMES.items():
        if dim.lower() in names:
            return kind
    if dim not in dataset.variables:
        return None
    attributes = dataset[dim].attrs
    standard_name = str(attributes.get("standard_name", ""))
    if standard_name in _STANDARD_NAMES:
        return _STANDARD_NAMES[standard_name]
    if standard_name.startswith("ocean_s_coordinate"):
        return "depth"
    axis: dict[str, Kind] = {"T": "time", "Z": "depth", "Y": "y", "X": "x"}
    return axis.get(str(attributes.get("axis", "")))


def _position(file: OceanFile, velocity: str, which: str, dims: tuple[str, str]) -> str:
    """The variable of longitudes or latitudes on the given dimensions: by name, then by meaning."""
    one_dimensional = dims[0] if which == "lat" else dims[1]
    candidates = {
        str(name): variable
        for name, variable in file.dataset.variables.items()
        if set(variable.dims) == set(dims) or variable.dims == (one_dimensional,)
    }
    by_name = {name.lower(): name for name in candidates}
    for name in _POSITION_NAMES[which]:
        if name in by_name:
            return by_name[name]
    for name, variable in candidates.items():
        if variable.attrs.get("standard_name") == _POSITION_STANDARD_NAMES[which]:
            return name
    for name, variable in candidates.items():
        if str(variable.attrs.get("units", "")).lower() in _POSITION_UNITS[which]:
            return name
    word = {"lat": "latitudes", "lon": "longitudes"}[which]
    raise file.error(velocity, f"no variable gives the {word} of its cells ({dims[0]}, {dims[1]})")
