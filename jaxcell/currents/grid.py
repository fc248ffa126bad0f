"""The cells of a file: their positions, sizes and angles, and the choice of a block."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from ..base.doubts import Doubt, warn
from . import sphere
from .axes.dimensions import Axes, is_rectangular
from .netcdf import OceanFile


@dataclasses.dataclass(frozen=True)
class OceanGrid:
    """A block of cells of a file."""

    rows: Int[np.ndarray, " y"]
    columns: Int[np.ndarray, " x"]
    "The indices of the rows and columns of the block in the file."
    lon: Float[np.ndarray, "y x"]
    "Longitude of each centre in degrees, from -180 to 180."
    lat: Float[np.ndarray, "y x"]
    dx: Float[np.ndarray, "y x"]
    dy: Float[np.ndarray, "y x"]
    "Sides of each cell along the x and y axes, in metres."
    angle: Float[np.ndarray, "y x"]
    "Angle from East to the x axis, counter-clockwise, in radians."
    closed: Bool[np.ndarray, " y"]
    "The mask of rows that count as land because they repeat other rows across the northern fold."
    wraps: bool
    "True if the last column is beside the first, because the grid goes round the Earth."
    angle_from: str
    "A phrase that names the source of `angle`; empty on a grid of latitude and longitude."
    notes: tuple[str, ...] = ()
    "Changes that were made to the grid of the file, in words."

    def place(self, row: int | np.integer, column: int | np.integer) -> str:
        """The place of a cell in the file, in words."""
        return f"row {self.rows[row]}, column {self.columns[column]}"


def read_grid(file: OceanFile, axes: Axes, bounds: Sequence[float | int] | None) -> OceanGrid:
    """Read the positions of cells in the smallest block that contains all cells within `bounds`."""
    box = None if bounds is None else _bounds(file, bounds)
    make = _rectangular if is_rectangular(file, axes) else _curvilinear
    return make(file, axes, box)


# The largest difference, in degrees, of the angle in a file from the angle of the positions.
_MAX_ERROR_OF_ANGLE = 5.0

_Box = tuple[float, float, float, float]


def _rectangular(file: OceanFile, axes: Axes, box: _Box | None) -> OceanGrid:
    lon_in_file, lat_in_file = (
        _in_degrees(file, name, file.read(file.dataset[name])) for name in (axes.lon, axes.lat)
    )
    notes = []
    if again := sphere.repeated_columns(lon_in_file):
        lon_in_file = lon_in_file[:-again]
        notes.append(f"{axes.lon}: {_columns(again)} at the end repeated the first; left out")
    name = axes.lon
    try:
        columns = sphere.eastward_order(lon_in_file)
        name = axes.lat
        rows = sphere.northward_order(lat_in_file)
    except ValueError as error:
        raise file.error(name, str(error)) from error
    lon, lat = sphere.wrapped(lon_in_file[columns]), lat_in_file[rows]
    whole = sphere.goes_round(lon[None], np.zeros((1, lon.size)))
    if (lon_in_file >= 180).any():
        notes.append(f"{axes.lon}: {lon_in_file.min():g} to {lon_in_file.max():g} wrapped")
    if columns[0] > columns[1] or (np.diff(columns) < 0).any():
        notes.append(f"{axes.lon}: columns put in order to the East")
    if rows[0] > rows[1]:
        notes.append(f"{axes.lat}: rows turned to begin in the South")
    y, x = np.arange(len(rows)), np.arange(len(columns))
    if box is not None:
        x = np.flatnonzero(sphere.inside(lon, np.full_like(lon, box[1]), box))
        y = np.flatnonzero(sphere.inside(np.full_like(lat, box[0]), lat, box))
        if x.size == 0 or y.size == 0:
            raise _outside(file, box, lon, lat)
        if whole and x.size < lon.size:  # bounds across the seam: begin at the western bound
            x = x[np.argsort((lon[x] - box[0] + 1e-9) % 360)]
    wraps = whole and x.size == lon.size
    notes += [_round(axes.lon)] * wraps
    file.check_size(axes.lon, {axes.y: len(y), axes.x: len(x)}, arrays=5)
    dx, dy = sphere.rectangular_sides(lon, lat, y, x, wraps=whole)
    lon_grid, lat_grid = np.meshgrid(lon[x], lat[y])
    return OceanGrid(
        rows[y], columns[x], lon_grid, lat_grid, dx, dy,
        np.zeros_like(lon_grid), np.zeros(len(y), bool), wraps, "", tuple(notes),
    )  # fmt: skip


def _curvilinear(file: OceanFile, axes: Axes, box: _Box | None) -> OceanGrid:
    sizes = {name: file.dataset.sizes[name] for name in axes.rho}
    # Positions, directions and sides of all cells are in memory at once.
    file.check_size(axes.lon, sizes, arrays=24)

    kept = slice(None)

    def read(name: str) -> np.ndarray:
        values = file.read(file.dataset[name], axes.rho)
        return np.broadcast_to(values, tuple(sizes.values()))[:, kept]

    lon, lat = (_in_degrees(file, name, read(name)) for name in (axes.lon, axes.lat))
    lon = sphere.wrapped(lon)
    notes = []
    null = (lon == 0) & (lat == 0)
    holes = ~np.isfinite(lon + lat) | (null & (1 < null.sum() < null.size))
    if holes.any():
        lon, lat = (np.where(holes, np.nan, values) for values in (lon, lat))
        doubt = f"{axes.lon}: {holes.sum():,} squares have no position, or 0 N 0 E, and are land"
        notes.append(doubt)
        warn(f"{file.name}: {doubt}", Doubt)
    rows, columns = (np.arange(size) for size in sizes.values())
    # Of two repeated columns one at each end is left out, so that kept columns have both sides.
    again = sphere.overlapping_columns(lon, lat)
    inner = slice(again // 2, columns.size - (again - again // 2))
    wraps = sphere.goes_round(lon[:, inner], lat[:, inner])
    if wraps and again:
        kept = inner
        lon, lat, columns = lon[:, kept], lat[:, kept], columns[kept]
        notes.append(f"{axes.lon}: {_columns(again)} at the ends repeated others; left out")
    dx, dy, angle, turn = sphere.curvilinear_sides(*sphere.continued(lon, lat), wraps=wraps)
    turn[np.isnan(lon)] = np.nan
    closed = rows >= rows.size - sphere.folded_rows(lon, lat)
    turn[closed] = np.nan
    if (turn < 0).any() and (turn > 0).any():
        j, i = np.argwhere((turn < 0) != (np.nanmedian(turn) < 0))[0]
        at = f"row {j}, column {columns[i]} ({lon[j, i]:g}, {lat[j, i]:g})"
        raise file.error(axes.lon, f"expected positions in order; the grid folds at {at}")
    if (turn < 0).any():
        if axes.staggered:
            raise file.error(axes.lat, "the grid is a mirror image: y is to the right of x")
        rows = rows[::-1]
        notes.append("rows turned, as y was to the right of x")
    angle_from = f"the angle of the grid, computed from {axes.lon} and {axes.lat}"
    if _on_grid(file, "angle", axes):
        angle, angle_from = _angle(file, axes, read("angle"), angle)
    if _on_grid(file, "pm", axes) and _on_grid(file, "pn", axes):
        with np.errstate(divide="ignore", over="ignore"):
            dx, dy = 1 / read("pm"), 1 / read("pn")
    if _on_grid(file, "e1t", axes) and _on_grid(file, "e2t", axes):
        dx, dy = read("e1t"), read("e2t")
    part = np.arange(columns.size)
    if box is not None:
        within = sphere.inside(lon, lat, box)
        if not within.any():
            raise _outside(file, box, lon, lat)
        y, x = (np.flatnonzero(within.any(axis=axis)) for axis in (1, 0))
        rows = rows[(rows >= y[0]) & (rows <= y[-1])]
        part = np.arange(x[0], x[-1] + 1)
        wraps = wraps and part.size == columns.size
        if not within.all():
            notes.append("bounds: the block of the grid that holds all cells within them")
    notes += [_round(axes.lon)] * wraps
    if closed[rows].any():
        folded = f"{closed[rows].sum()} rows there repeat others and are closed, as land"
        notes.append(f"{axes.lat}: the grid is folded in the North; {folded}")
    block = np.ix_(rows, part)
    return OceanGrid(
        rows, columns[part], lon[block], lat[block], dx[block], dy[block], angle[block],
        closed[rows], wraps, angle_from, tuple(notes),
    )  # fmt: skip


def _angle(
    file: OceanFile, axes: Axes, angle: Float[np.ndarray, "y x"], computed: Float[np.ndarray, "y x"]
) -> tuple[Float[np.ndarray, "y x"], str]:
    """Convert the variable `angle` to radians; return it, and a phrase that names its source.

    Radians that agree with the angle `computed` from the positions are believed. Otherwise the unit
    that agrees better is chosen: some files omit it, and some of CROCO declare the wrong one.
    """
    known = np.isfinite(angle + computed)
    if not known.any():
        return angle, "the variable angle"
    units = {"radians": angle, "degrees": np.radians(angle)}
    off = {
        unit: float(np.median(np.abs(sphere.wrapped(np.degrees(values - computed))[known])))
        for unit, values in units.items()
    }
    unit = min(off, key=lambda unit: off[unit])
    declared = _declares_radians(file, "angle") and off["radians"] <= _MAX_ERROR_OF_ANGLE
    if unit == "degrees" and declared:
        return angle, "the variable angle, in radians as the file says"
    if off[unit] > _MAX_ERROR_OF_ANGLE:
        raise file.error(
            "angle",
            f"expected the angle from East to the x axis within {_MAX_ERROR_OF_ANGLE:g} degrees "
            f"of that from {axes.lon} and {axes.lat}; its median is off by {off['radians']:.3g} "
            f"degrees if it is in radians, and by {off['degrees']:.3g} if it is in degrees",
        )
    return units[unit], f"the variable angle, in {unit} as {axes.lon} and {axes.lat} show"


def _declares_radians(file: OceanFile, name: str) -> bool:
    return str(file.dataset[name].attrs.get("units", "")).lower() in ("radian", "radians", "rad")


def _in_degrees(file: OceanFile, name: str, values: np.ndarray) -> np.ndarray:
    """Convert positions to degrees if the file declares that they are in radians."""
    return np.degrees(values) if _declares_radians(file, name) else values


def _columns(count: int) -> str:
    return "a column" if count == 1 else f"{count} columns"


def _round(lon: str) -> str:
    return f"{lon}: the grid goes round the Earth; its last column is beside its first"


def _on_grid(file: OceanFile, name: str, axes: Axes) -> bool:
    return name in file.dataset.variables and set(file.dataset[name].dims) == set(axes.rho)


def _bounds(file: OceanFile, bounds: Sequence[float | int]) -> _Box:
    try:
        west, south, east, north = (float(value) for value in bounds)
    except (TypeError, ValueError) as error:
        why = f"expected (west, south, east, north) in degrees, got {bounds!r}"
        raise file.error("bounds", why) from error
    if not np.isfinite([west, south, east, north]).all() or south >= north or west == east:
        why = f"expected west, south, east, north with south < north, got {bounds!r}"
        raise file.error("bounds", why)
    sphere.warn_if_wide(bounds)
    return west, south, east, north


def _outside(file: OceanFile, box: _Box, lon: np.ndarray, lat: np.ndarray) -> ValueError:
    west, east = lon[0], lon[-1]
    if lon.ndim > 1:
        eastward = sphere.wrapped(lon - lon[0, 0])
        ends = np.array([np.nanmin(eastward), np.nanmax(eastward)])
        west, east = sphere.wrapped(lon[0, 0] + ends)
    goes = f"from {west:g} to {east:g} East and {np.nanmin(lat):g} to {np.nanmax(lat):g} North"
    return file.error("bounds", f"{box}: no cell is within them; the file goes {goes}")
