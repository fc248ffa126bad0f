"""The axes of a velocity: its dimensions, and the variables with longitudes and latitudes."""

import dataclasses
from collections.abc import Hashable, Iterable
from typing import Literal, TypeAlias

import xarray as xr

from ..conventions import POINTS, STAGGERED, TERRAIN, find, table
from ..netcdf import OceanFile


Kind: TypeAlias = Literal["time", "depth", "y", "x"]

_AXES: dict[str, Kind] = {"T": "time", "Z": "depth", "Y": "y", "X": "x"}


@dataclasses.dataclass(frozen=True)
class Axes:
    """The names of the dimensions of a velocity, and of the variables with its positions."""

    time: str | None
    depth: str | None
    y: str
    "The dimension along y, over cell centres, or over cell faces if the velocity is `staggered`."
    x: str
    lon: str
    "The variable with the longitudes of the cell centres."
    lat: str

    @property
    def staggered(self) -> bool:
        """True if the velocity is on the cell faces of a C-grid."""
        return self.rho != (self.y, self.x)

    @property
    def between(self) -> int | None:
        """The axis (-2 for y, -1 for x) along which the velocity is between centres, or `None`."""
        return -2 if self.y in ("eta_v", "y_v") else -1 if self.x in ("xi_u", "x_u") else None

    @property
    def rho(self) -> tuple[str, str]:
        """The dimensions `(y, x)` of the cell centres."""
        return STAGGERED.get(self.y, self.y), STAGGERED.get(self.x, self.x)


def without_outer_faces(file: OceanFile) -> OceanFile:
    """Leave out the first face of an axis with a face more than cells; then faces follow cells."""
    sizes, one = file.dataset.sizes, slice(1, None)
    outer = {s: one for s, c in STAGGERED.items() if c in sizes and sizes.get(s) == sizes[c] + 1}
    return dataclasses.replace(file, dataset=file.dataset.isel(outer))


def find_axes(file: OceanFile, name: str) -> Axes:
    """Find the dimensions of the velocity `name` from their names and attributes."""
    _check_structured(file, name)
    dims: dict[Kind, str] = {}
    for dim, size in file.dataset[name].sizes.items():
        kind = axis_kind(file.dataset, str(dim))
        if kind is not None and kind not in dims:
            dims[kind] = str(dim)
        elif size > 1:
            why = "it is unknown" if kind is None else f"{dims[kind]} is {kind} already"
            expected = f"dimension {dim} of length {size}: expected time, depth, y or x; {why}"
            raise file.error(name, f"{expected}; name its axis with dims (--dims {dim}=AXIS)")
    depth = dims.get("depth", "")
    if file.dataset.sizes.get(depth) == 1 and depth not in (*file.dataset.variables, "s_rho"):
        del dims["depth"]  # a single level, whose depth is not known
    for kind in ("y", "x"):
        if kind not in dims:
            got = f"got the dimensions {', '.join(map(str, file.dataset[name].dims)) or 'none'}"
            way_on = f"name it with dims (--dims NAME={kind})"
            raise file.error(name, f"expected a dimension for {kind}, {got}; {way_on}")
    y, x = dims["y"], dims["x"]
    rho = STAGGERED.get(y, y), STAGGERED.get(x, x)
    lon, lat = _position(file, name, "lon", rho), _position(file, name, "lat", rho)
    axes = Axes(dims.get("time"), dims.get("depth"), y, x, lon, lat)
    _check_lengths(file, axes)
    return axes


def is_rectangular(file: OceanFile, axes: Axes) -> bool:
    """Return whether longitude depends on x only, and latitude on y only."""
    lon, lat = file.dataset[axes.lon], file.dataset[axes.lat]
    return lon.dims == (axes.x,) and lat.dims == (axes.y,)


def axis_kind(dataset: xr.Dataset, dim: str) -> Kind | None:
    """Find the axis along which a dimension runs, such as depth, from its name or attributes."""
    rows = {kind: next(table(kind)) for kind in _AXES.values()}
    about = dataset[dim].attrs if dim in dataset.variables else {}
    name, standard_name = POINTS.sub("", dim.lower()), str(about.get("standard_name", ""))
    kinds = [kind for kind, row in rows.items() if name in row.names]
    kinds += [kind for kind, row in rows.items() if standard_name in row.standard_names]
    if not kinds and standard_name.startswith(TERRAIN):
        return "depth"
    return kinds[0] if kinds else _AXES.get(str(about.get("axis", "")))


def _check_structured(file: OceanFile, velocity: str) -> None:
    """Raise for an unstructured grid, whose longitudes and latitudes share one dimension."""
    variables = file.dataset.variables
    for dim in map(str, file.dataset[velocity].dims):
        along = [str(name) for name, variable in variables.items() if variable.dims == (dim,)]
        lon, lat = (find(file.dataset, which, along) for which in ("lon", "lat"))
        together = lon is not None and lat is not None and lon != lat
        if file.dataset.sizes[dim] > 1 and (dim == "nele" or on_nodes((dim,)) or together):
            raise unstructured(file, velocity)


def on_nodes(dims: Iterable[Hashable]) -> bool:
    """Return whether one of the dimensions runs over the nodes or elements of a SCHISM grid."""
    return any(str(dim).lower().startswith("nschism_hgrid") for dim in dims)


def _check_lengths(file: OceanFile, axes: Axes) -> None:
    """Raise if a velocity has too few or too many values along y or x for the number of cells."""
    sizes = file.dataset.sizes
    for axis, dim, rho in zip((-2, -1), (axes.y, axes.x), axes.rho, strict=True):
        if sizes[rho] == 1:
            raise file.error(rho, "expected 2 cells or more along it, got 1")
        # Sides between centres are one fewer than the cells, but files that were cut with equal
        # index ranges have as many sides as cells.
        least = sizes[rho] - (axis == axes.between)
        if not least <= sizes[dim] <= sizes[rho]:
            expected = f"expected a length of {least} with {sizes[rho]} cells ({rho})"
            raise file.error(dim, f"{expected}, got {sizes[dim]}")


def unstructured(file: OceanFile, field: str) -> ValueError:
    """Return the error for unstructured grids, such as the grids of FVCOM and SCHISM."""
    dims = ", ".join(map(str, file.dataset[field].dims)) or "a mesh"
    return file.error(
        field,
        f"on an unstructured grid ({dims}); expected rows and columns: regrid u and v to "
        "longitudes and latitudes first, record by record, with scipy.interpolate.griddata("
        "(lon, lat), u, (new_lon[None], new_lat[:, None])), and write them on the dimensions "
        "(time, lat, lon)",
    )


def _position(
    file: OceanFile, velocity: str, which: Literal["lon", "lat"], dims: tuple[str, str]
) -> str:
    """Find the variable with the longitudes or latitudes of cells on the dimensions `dims`."""
    along = dims[0] if which == "lat" else dims[1]
    variables = ((str(name), v.dims) for name, v in file.dataset.variables.items())
    candidates = [name for name, own in variables if set(own) == set(dims) or own == (along,)]
    asked = file.positions[which == "lat" :][:1]
    if asked and asked[0] in candidates:
        return asked[0]
    # A file may have positions of other points on the same dimensions, as POP does.
    own = [name for name in file.coordinates(velocity) if name in candidates]
    name = find(file.dataset, which, own) or find(file.dataset, which, candidates)
    if name is not None and not asked:
        return name
    word = {"lat": "latitudes", "lon": "longitudes"}[which]
    raise file.error(
        velocity,
        f"no variable gives the {word} of its cells ({dims[0]}, {dims[1]}); name those that do "
        "with coords (--coords LON LAT), or the file that has them with grid (--grid FILE)",
    )
