"""Read ocean currents from files, as velocities on grid cells."""

import dataclasses
import os
from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Shaped

from ..base.doubts import Doubt, warn
from .axes.depths import choose_layers
from .axes.times import When, choose_records, record_times
from .fields import Field, FieldReader
from .grid import OceanGrid, read_grid
from .holes import fill_holes
from .land import Land, read_land
from .models import plane
from .netcdf import OceanFile
from .said import Said
from .sources import Source, open_source, source_name
from .sphere import turned
from .surface import Push, read_surface
from .velocity import Velocity, choose_velocity


# The least ratio of the sides of a cell. Beside a pole on a grid of 1/1000 degree it is 1/100,000;
# in a row whose centres are the pole it is a rounding error.
_LEAST_RATIO_OF_SIDES = 5e-6


def read_moments(
    path: Source,
    *,
    grid: Source | None = None,
    variables: Sequence[str] | None = None,
    **said: Any,
) -> Shaped[np.ndarray, " records"]:
    """Read the time of each record of currents; the arguments are those of [`open_currents`][]."""
    with open_source(path, grid, Said(**said)) as file:
        file, velocity = choose_velocity(file, variables)
        return record_times(file, velocity.u_axes.time).values


def open_currents(
    path: Source,
    *,
    grid: Source | None = None,
    time: When = None,
    depths: float | int | Sequence[float | int] | None = None,
    bounds: Sequence[float | int] | None = None,
    variables: Sequence[str] | None = None,
    dims: Sequence[str] | None = None,
    coords: Sequence[str] | None = None,
    time_units: str | None = None,
    calendar: str | None = None,
    mask: str | None = None,
    units: str | None = None,
    group: str | None = None,
    mean: bool = False,
    windage: float | int = 0.0,
    stokes: bool = False,
    land: str | os.PathLike[str] | None = None,
    gaps: str = "open",
) -> xr.Dataset:
    """Read ocean currents (Alam 2018, section 5.4.1).

    Supported files are native output of ROMS, CROCO, NEMO, MITgcm, MOM6 and POP, files at fixed
    depths or of the surface with the names of CF or of common models and products, and maps of HF
    radar. Velocities on cell faces are averaged to the cell centres and rotated to East and North,
    and levels that follow the sea bed are interpolated to depths. Only the chosen part is read,
    record by record.

    If the columns go round the Earth, repeated columns are left out, and the last column is beside
    the first. Rows that repeat other rows because the grid is folded in the North count as land.

    **Arguments:**

    - `path`: a NetCDF file, version 3 or 4; several files, with consecutive records, or one for
        u and one for v; a pattern of names such as `"2016_*.nc"`; a Zarr store; an OPeNDAP address;
        or an open dataset.
    - `grid`: a second source of positions, masks and depths, if `path` lacks them.
    - `time`: the index of a record, a moment (text such as `"2016-02-02T12:00"`, UTC, or a date for
        its midnight), a slice of indices, a month `"2016-02"`, or a pair of the first and the last
        record, as indices or moments, both included, or as a text `"2016-02-01/2016-02-11"`; by
        default all records. A moment selects the nearest record, the later of two, within half the
        time between records. Moments are dates of the calendar of the file. If its years have 360
        days, or no leap days, days are counted from the first record's year, as `notes` says.
    - `depths`: the depths of the layers in metres below the surface. In a file of fixed depths they
        must be among its levels, to the centimetre; by default all levels with water are read. If
        levels follow the sea bed, any depth is possible, by default 0; beyond the levels, the
        velocity is that of the nearest, which must be within the thickness of a layer.
    - `bounds`: `(west, south, east, north)` in degrees, across the antimeridian if west is more
        than east. On a turned or curved grid the smallest block with all these cells is read.
    - `variables`: the names of the velocities towards the East and North, for an ambiguous file.
        They are along x and y if they are on cell faces, or if their standard names are those of
        velocities along x and y. A speed and a direction can be named in their place.
    - `dims`: axes of dimensions whose names are unknown, such as `["k=depth", "j=y", "i=x"]`. The
        axes are `time`, `depth`, `y` and `x`; on a C-grid `y_rho` and `x_rho` of the centres, and
        `x_u` and `y_v` of the sides.
    - `coords`: the names of the variables with the longitudes and latitudes of the cells, and of
        that with the depths of the levels if it is unknown too.
    - `time_units`, `calendar`: the unit of the times, such as `"days since 2000-01-01"`, and their
        calendar by its name in CF. If a dimension of time has no variable, its records are counted.
    - `mask`: the land, as `VAR=VALUE`: squares in which the variable has this value at all records,
        such as `"KMT=0"` or `"uo=0"`.
    - `units`: the unit of the velocities, such as `"cm/s"` or `"knots"`.
    - `group`: the group of the file that has the velocities, if it has several.
    - `mean`: whether to compute only the mean of the records, with one record in memory at a time.
    - `windage`: the share of the speed of the wind that is added to the current of the first layer,
        about 0.01 to 0.04 for objects that project from the water; the file must have the wind.
    - `stokes`: whether to add the Stokes drift of waves in the file to the first layer.
    - `land`: a GeoJSON file or shapefile of land, for files without a mask; by default the bundled
        land of Natural Earth, whose coasts have errors of some kilometres.
    - `gaps`: `"open"` if squares without a velocity may be sea; `"land"` if all of them are land;
        or `"fill"` to fill holes of up to nine squares in the water with the velocity around.

    **Returns:** a dataset in the normal form of `jaxcell.currents`: `u`, `v`, `water`, `land`,
    `dx`, `dy` and `angle` on the dimensions time, layer, y and x; times, depths and positions.

    **Raises:** `FileNotFoundError`; `ValueError`, with the file, the field and the value, for
    damaged or contradictory files, choices that do not exist in the file, and more data than 4 GiB;
    `MemoryError` if the data do not fit into the free memory.

    The surface of the bundled sea at its first record:

        >>> from jaxcell import bundled, drift
        >>> currents = drift.open_currents(bundled("ocean/gyres.nc"), time=0, depths=0)
        >>> dict(currents.sizes), int(currents.water.sum()), round(float(currents.u.max()), 2)
        ({'time': 1, 'layer': 1, 'y': 21, 'x': 29}, 538, 0.54)
    """
    if not 0 <= windage <= 1:
        raise ValueError(f"windage: expected a share from 0 to 1, got {windage}")
    if gaps not in ("open", "land", "fill"):
        raise ValueError(f"gaps: expected 'open', 'land' or 'fill', got {gaps!r}")
    coast = None if land is None else read_land(land)
    said = Said(
        dims=dims, coords=coords, time_units=time_units, calendar=calendar, mask=mask, units=units,
        group=group,
    )  # fmt: skip
    with open_source(path, grid, said) as file:
        file, velocity = choose_velocity(file, variables)
        if units is not None:
            for name in (velocity.u, velocity.v):
                file.dataset[name] = file.dataset[name].assign_attrs(units=units)
        axes = velocity.u_axes
        for name in (velocity.u, velocity.v, axes.lon, axes.lat):
            if 0 in file.dataset[name].shape:
                raise file.error(name, "it has no values: one of its dimensions has the length 0")
        if axes.lon == plane.LON:
            gaps, coast = "land", Land("a plane, which has no coastline", np.array([], object))
        cells = read_grid(file, axes, bounds)
        times = record_times(file, axes.time)
        records = choose_records(file, times, time)
        layers = choose_layers(file, velocity.u, axes.depth, depths)
        chosen = times.values[records]
        field = FieldReader(file, velocity, cells, records, chosen, layers, coast, gaps).read(mean)
        if gaps == "fill":
            field = fill_holes(field)
        _check_positions(file, axes.lon, cells, field)
        u, v, notes = field.u, field.v, [times.note, layers.note, *field.notes, *cells.notes]
        notes += [f"{axes.lon}, {axes.lat}: from {source_name(grid)}"] if grid is not None else []
        if velocity.along == "grid" and cells.angle_from:
            u, v = turned(u, v, cells.angle)
            turn = f"turned to East and North by {cells.angle_from}"
            notes.append(f"{velocity.u}, {velocity.v}: {turn}")
        shares: dict[Push, float] = {"wind": windage, "stokes": float(stokes)}
        for role, share in shares.items():
            if not share:
                continue
            push, names = read_surface(file, role, axes, cells, records, field.water[0])
            for values, extra in zip((u, v), push, strict=True):
                values[:, 0] += share * (extra.mean(axis=0) if mean else extra)
            notes.append(f"{names}: {share:g} of it is added to the current of the first layer")
    attributes: dict[str, str | int] = {
        "source": source_name(path),
        "east_from": _origin(velocity, velocity.u, cells),
        "north_from": _origin(velocity, velocity.v, cells),
        "notes": "\n".join(note for note in notes if note),
        "mean_of": len(records) if mean else 1,
        "coastline": "" if land is None else os.fspath(land),
    }
    for doubt in field.doubts:
        warn(f"{source_name(path)}: {doubt}", Doubt)
    field = dataclasses.replace(field, u=u, v=v)
    return _dataset(field, cells, chosen[:1] if mean else chosen, attributes)


def _check_positions(file: OceanFile, name: str, grid: OceanGrid, field: Field) -> None:
    """Raise if a water cell has no position, angle or sides."""
    water = field.water.any(axis=0)
    for values, what in ((grid.lon, "longitude"), (grid.lat, "latitude"), (grid.angle, "angle")):
        for cell in np.argwhere(water & ~np.isfinite(values)):
            raise file.error(name, f"no {what} at {grid.place(*cell)}, which is water")
    shorter, longer = np.minimum(grid.dx, grid.dy), np.maximum(grid.dx, grid.dy)
    sides = (shorter > _LEAST_RATIO_OF_SIDES * longer) & np.isfinite(longer)
    for j, i in np.argwhere(water & ~sides):
        lat = grid.lat[j, i]
        at_pole = f"; the row at latitude {lat:g} is at a pole: leave it out with bounds"
        raise file.error(
            name,
            f"the cell at {grid.place(j, i)} has sides of {grid.dx[j, i]:g} and {grid.dy[j, i]:g} "
            f"m; expected more than 0{at_pole if abs(lat) > 89 else ''}",
        )


def _origin(velocity: Velocity, name: str, grid: OceanGrid) -> str:
    """Describe the variables of the component `name`, and why they were chosen."""
    if velocity.along == "grid" and grid.angle_from:
        name = f"{velocity.u} and {velocity.v} along the grid, turned"
    return f"{name} ({velocity.why})"


def _dataset(
    field: Field,
    grid: OceanGrid,
    times: Shaped[np.ndarray, " records"],
    attributes: dict[str, str | int],
) -> xr.Dataset:
    cells, moving = ("y", "x"), ("time", "layer", "y", "x")
    turn = {"units": "radian", "long_name": "angle from East to the x axis, counter-clockwise"}
    down = {"standard_name": "depth", "units": "m", "positive": "down"}
    east, north = (
        {"units": "m s-1", "standard_name": f"{towards}ward_sea_water_velocity"}
        for towards in ("east", "north")
    )
    return xr.Dataset(
        {
            "u": (moving, field.u, east),
            "v": (moving, field.v, north),
            "water": (moving[1:], field.water, {"long_name": "water at every record"}),
            "land": (moving[1:], field.land, {"long_name": "land or sea bed"}),
            "dx": (cells, grid.dx, {"units": "m", "long_name": "side of the cell along x"}),
            "dy": (cells, grid.dy, {"units": "m", "long_name": "side of the cell along y"}),
            "angle": (cells, grid.angle, turn),
        },
        coords={
            "time": ("time", times, {"standard_name": "time"}),
            "depth": ("layer", field.depth, down),
            "lon": (cells, grid.lon, {"standard_name": "longitude", "units": "degrees_east"}),
            "lat": (cells, grid.lat, {"standard_name": "latitude", "units": "degrees_north"}),
        },
        attrs=attributes,
    )
