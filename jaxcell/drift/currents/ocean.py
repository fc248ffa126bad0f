"""Ocean currents from a file, on cells."""

import dataclasses
from collections.abc import Sequence

import numpy as np
import xarray as xr
from jaxtyping import Shaped

from .axes.depths import choose_layers
from .axes.times import When, choose_records, record_times
from .fields import Field, read_field
from .grid import OceanGrid, read_grid
from .netcdf import OceanFile
from .roms import turned
from .sources import Source, open_source, source_name
from .surface import Push, read_surface
from .velocity_names import Velocity, choose_velocity


# At the end of a grid of 1/1000 degree that ends at a pole it is 1/100,000; in a row whose centres
# are the pole itself, a rounding error.
_LEAST_RATIO_OF_SIDES = 5e-6


def open_currents(
    path: Source,
    *,
    grid: Source | None = None,
    time: When = None,
    depths: float | int | Sequence[float | int] | None = None,
    bounds: Sequence[float | int] | None = None,
    variables: Sequence[str] | None = None,
    mean: bool = False,
    windage: float | int = 0.0,
    stokes: bool = False,
) -> xr.Dataset:
    """Read ocean currents (Alam 2018, section 5.4.1).

    It reads the native output of ROMS, CROCO and NEMO (velocities on the sides of the cells are
    averaged to their centres and turned to East and North, and levels that follow the sea bed are
    interpolated to depths), files on fixed depths or of the surface with the names of CF or of the
    common ocean models and products, and maps of HF radar. Only what is asked for is read from the
    disk, record by record.

    A cell is water where it has a velocity at 80 % of the records that are read or more; what is
    missing there is interpolated in time. Values whose flags of quality say that they are bad are
    missing. If the file has a mask, it must be water by that too: 1 is water in what ROMS, CROCO
    and NEMO call their masks; elsewhere flags or options such as `option_0` say it, or else a
    standard name of CF.

    Where the columns go round the Earth, so that the last is beside the first, columns that are
    repeated at an end are left out; all that is computed from the currents goes on across the seam.
    `notes` says so. With velocities on the sides of cells and no repeated column, that at the seam
    is not in the file, and the cells beside it have the velocity of their other side. Where rows
    repeat others because the grid is folded in the North, they are closed, as land.

    **Arguments:**

    - `path`: a NetCDF file, version 3 or 4; several, whose records go on from one to the next, or
        which have u and v; a pattern of their names such as `"2016_*.nc"`; a Zarr store; an address
        of an OPeNDAP server; or a dataset that is open already.
    - `grid`: the same for positions, masks and depths, if they are in a file of their own.
    - `time`: the index of a record, a moment (text such as `"2016-02-02T12:00"`, a date without an
        hour being its midnight; UTC), a slice of indices, or the first and the last of the records
        as indices or moments, both included. A moment stands for the nearest record (the later of
        two), within half the time between records. All records if left out. Moments are dates of
        the calendar of the file; days of one without leap years, or of years of 360 days, are
        counted on from the first year of its records, and `notes` says so.
    - `depths`: in metres below the surface, positive down. In a file of fixed depths, of either
        sign, they must be among its levels, to the centimetre, and all levels that have water are
        read if they are left out. In one whose levels follow the sea bed they may be any, and are
        0 if left out; the velocity of the highest level holds up to the surface, and that of the
        lowest down to the bed, but no farther than a layer where a file lacks levels there.
    - `bounds`: `(west, south, east, north)` in degrees; longitudes of either kind, across the
        antimeridian if west is more than east. A grid that is turned or curved gives the block
        that holds all cells within them. A part of the globe has edges like any other.
    - `variables`: the names of the velocities towards the East and North (or along the grid, if
        they stand on the sides of its cells or their standard names say so), where the file
        leaves it open.
    - `mean`: whether to read the mean of the records only, as one record at the time of the first;
        any number of them takes the memory of one.
    - `windage`: the share of the speed of the wind that is added to the current of the first layer,
        of a file that has the wind on the cells of the currents: some 0.01 to 0.04 for what sticks
        out of the water.
    - `stokes`: whether to add the Stokes drift of waves to it, of a file that has that.

    **Returns:** a dataset on the dimensions time, layer, y and x, the surface first and, on a grid
    of latitude and longitude, the South and West first:

    - `u`, `v`: velocity towards the East and North in m/s, NaN where there is no water;
    - `water`: whether a cell of a layer is water;
    - `dx`, `dy`: the sides of each cell along the x and y axes of the grid, in metres;
    - `angle`: radians, counter-clockwise from East to the x axis;
    - coordinates `time` (UTC), `depth` of each layer in metres, `lon` and `lat` of the centres;
    - attributes `source`, `east_from`, `north_from`, which say from which variables the velocities
        are and why, `notes`, what else was done, a line each, and `mean_of`, of how many records
        each is the mean.

    **Raises:** `FileNotFoundError`; `ValueError` for a windage below 0 or above 1, and one that
    names the file, the field and the value for a file that is damaged, truncated or not NetCDF, or
    an address that cannot be reached; files that do not fit one another; an unstructured grid; no
    velocity, or one that may be along the grid or not; coordinates out of order, a row at a pole,
    an `angle` that is not that of the grid in radians or degrees; missing parameters of the levels;
    times, depths or bounds that the file does not have; no water, or a mask by which all that moves
    is land; a current above 10 m/s; and more data than 4 GiB; `MemoryError` for more than fits the
    free memory.

    The surface of the bundled sea at its first record:

        >>> from jaxcell import bundled, drift
        >>> currents = drift.open_currents(bundled("ocean/gyres.nc"), time=0, depths=0)
        >>> dict(currents.sizes), int(currents.water.sum()), round(float(currents.u.max()), 2)
        ({'time': 1, 'layer': 1, 'y': 21, 'x': 29}, 538, 0.54)
    """
    if not 0 <= windage <= 1:
        raise ValueError(f"windage: expected a share from 0 to 1, got {windage}")
    with open_source(path, grid) as file:
        file, velocity = choose_velocity(file, variables)
        axes = velocity.u_axes
        for name in (velocity.u, velocity.v, axes.lon, axes.lat):
            if 0 in file.dataset[name].shape:
                raise file.error(name, "it has no values: one of its dimensions has the length 0")
        cells = read_grid(file, axes, bounds)
        times = record_times(file, axes.time)
        records = choose_records(file, times, time)
        layers = choose_layers(file, velocity.u, axes.depth, depths)
        chosen = times.values[records]
        field = read_field(file, velocity, cells, records, chosen, layers, mean)
        _check_positions(file, axes.lon, cells, field)
        shares: dict[Push, float] = {"wind": float(windage), "stokes": float(stokes)}
        pushes = [
            (share, *read_surface(file, role, axes, cells, records, field.water[0]))
            for role, share in shares.items()
            if share
        ]
    gridded = f"{axes.lon}, {axes.lat}: from {source_name(grid)}" if grid is not None else ""
    u, v, notes = field.u, field.v, [times.note, layers.note, *field.notes, *cells.notes]
    notes.append(gridded)
    if velocity.along == "grid" and cells.angle_from:
        u, v = turned(u, v, cells.angle)
        notes.append(f"{velocity.u}, {velocity.v}: turned to East and North by {cells.angle_from}")
    for share, (east, north), names in pushes:
        if mean:
            east, north = east.mean(axis=0, keepdims=True), north.mean(axis=0, keepdims=True)
        u[:, 0], v[:, 0] = u[:, 0] + share * east, v[:, 0] + share * north
        notes.append(f"{names}: {share:g} of it is added to the current of the first layer")
    attributes: dict[str, str | int] = {
        "source": source_name(path),
        "east_from": _origin(velocity, "East", cells),
        "north_from": _origin(velocity, "North", cells),
        "notes": "\n".join(note for note in notes if note),
        "mean_of": len(records) if mean else 1,
    }
    field = dataclasses.replace(field, u=u, v=v)
    return _dataset(field, cells, chosen[:1] if mean else chosen, attributes)


def _check_positions(file: OceanFile, name: str, grid: OceanGrid, field: Field) -> None:
    """A cell of water must be somewhere, and have sides."""
    water = field.water.any(axis=0)
    for values, what in ((grid.lon, "longitude"), (grid.lat, "latitude"), (grid.angle, "angle")):
        bad = water & ~np.isfinite(values)
        if bad.any():
            j, i = np.argwhere(bad)[0]
            raise file.error(
                name, f"no {what} at row {grid.rows[j]}, column {grid.columns[i]}, which is water"
            )
    shorter, longer = np.minimum(grid.dx, grid.dy), np.maximum(grid.dx, grid.dy)
    bad = water & ~((shorter > _LEAST_RATIO_OF_SIDES * longer) & np.isfinite(longer))
    if bad.any():
        j, i = np.argwhere(bad)[0]
        lat = grid.lat[j, i]
        at_pole = f"; the row at latitude {lat:g} is at a pole: leave it out with bounds"
        raise file.error(
            name,
            f"the cell at row {grid.rows[j]}, column {grid.columns[i]} has sides of "
            f"{grid.dx[j, i]:g} and {grid.dy[j, i]:g} m; expected more than 0"
            + at_pole
            * bool(abs(lat) > 89),
        )


def _origin(velocity: Velocity, towards: str, grid: OceanGrid) -> str:
    """From which variables a component is, and why."""
    if velocity.along == "grid" and grid.angle_from:
        return f"{velocity.u} and {velocity.v} along the grid, turned ({velocity.why})"
    return f"{velocity.u if towards == 'East' else velocity.v} ({velocity.why})"


def _dataset(
    field: Field,
    grid: OceanGrid,
    times: Shaped[np.ndarray, " records"],
    attributes: dict[str, str | int],
) -> xr.Dataset:
    cells, moving = ("y", "x"), ("time", "layer", "y", "x")
    speed, metres = {"units": "m s-1"}, {"units": "m"}
    east = {"standard_name": "eastward_sea_water_velocity"}
    north = {"standard_name": "northward_sea_water_velocity"}
    down = {"standard_name": "depth", "positive": "down"}
    longitude = {"standard_name": "longitude", "units": "degrees_east"}
    latitude = {"standard_name": "latitude", "units": "degrees_north"}
    turn = {"units": "radian", "long_name": "angle from East to the x axis, counter-clockwise"}
    return xr.Dataset(
        {
            "u": (moving, field.u, speed | east),
            "v": (moving, field.v, speed | north),
            "water": (moving[1:], field.water, {"long_name": "water at every record"}),
            "dx": (cells, grid.dx, metres | {"long_name": "side of the cell along x"}),
            "dy": (cells, grid.dy, metres | {"long_name": "side of the cell along y"}),
            "angle": (cells, grid.angle, turn),
        },
        coords={
            "time": ("time", times, {"standard_name": "time"}),
            "depth": ("layer", field.depth, metres | down),
            "lon": (cells, grid.lon, longitude),
            "lat": (cells, grid.lat, latitude),
        },
        attrs=attributes,
    )
