"""Make the currents of this folder: `python data/ocean/make_currents.py [FOLDER]`.

The file has the same bytes on every machine. README.md describes it.
"""

import sys
from pathlib import Path

import netCDF4
import numpy as np


ROWS, COLUMNS, HOURS = 21, 29, 24
DEPTHS = (0.0, 5.0, 10.0)
CELL = 1000.0  # metres
SOUTH_WEST = (33.4, -118.15)  # latitude and longitude of the centre of the first cell
TIDE = 12.42  # hours

# Eddies of each layer: column, row, radius in cells, and strength, positive counter-clockwise.
EDDIES = (
    ((6.5, 12.0, 3.5, 1.0), (19.5, 14.0, 3.0, -1.2), (23.0, 4.5, 3.0, 1.2)),
    ((6.0, 6.0, 3.0, 1.0), (8.0, 15.0, 2.5, -1.2), (21.0, 5.5, 3.5, -1.0)),
    ((7.0, 10.0, 5.0, -1.0), (21.0, 15.0, 3.0, 1.5)),
)
STRONGEST = (0.45, 0.38, 0.3)  # metres per second in each layer
# The inward part of the current, as a multiple of the part around the eddies.
INWARD = 1.5
# Speeds above this share of the largest are almost equalized.
EVEN = 0.01


def sea_bed() -> np.ndarray:
    """Make the depths in metres, 0 on land: two basins, a strait, an island and a shelf."""
    row, column = np.mgrid[0:ROWS, 0:COLUMNS]
    depth = np.full((ROWS, COLUMNS), 60.0)
    depth[(column >= 23) & (row <= 9)] = 8.0  # the shelf
    depth[:2] = 8.0
    depth[(column >= 13) & (column <= 14) & (np.abs(row - 9.5) > 2)] = 0.0  # the strait is 4 wide
    depth[(np.abs(column - 21) <= 1) & (np.abs(row - 9.5) <= 1)] = 0.0  # the island
    depth[row - 17 > np.abs(column - 25)] = 0.0  # a headland
    depth[-1] = 0.0  # the coast
    return depth


def layer(water: np.ndarray, eddies: tuple, strongest: float) -> tuple[np.ndarray, np.ndarray]:
    """Make a current that follows the coasts and spirals into each eddy.

    Its stream function on the corners of the cells is 0 on land and at the edges, and has the
    eddies as its vorticity. A flow towards the centre of each eddy is added.
    """
    row, column = np.mgrid[0 : ROWS + 1, 0 : COLUMNS + 1] - 0.5
    vorticity = np.zeros(row.shape)
    for x, y, radius, strength in eddies:
        vorticity += strength * np.exp(-((column - x) ** 2 + (row - y) ** 2) / (2 * radius**2))
    inner = np.zeros(row.shape, bool)
    inner[1:-1, 1:-1] = water[1:, 1:] & water[1:, :-1] & water[:-1, 1:] & water[:-1, :-1]
    stream = np.zeros(row.shape)
    for _ in range(3000):
        beside = sum(np.roll(stream, shift, axis) for shift in (1, -1) for axis in (0, 1))
        stream = np.where(inner, (beside - vorticity) / 4, 0.0)

    def slopes(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        across = np.diff(values, axis=1)
        along = np.diff(values, axis=0)
        return (across[1:] + across[:-1]) / 2, (along[:, 1:] + along[:, :-1]) / 2

    x_slope, y_slope = slopes(stream)
    x_uphill, y_uphill = slopes(np.abs(stream))
    u, v = -y_slope + INWARD * x_uphill, x_slope + INWARD * y_uphill
    speed = np.hypot(u, v)
    scale = strongest / np.hypot(speed, EVEN * speed[water].max())
    return u * scale, v * scale


def currents() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Make the velocities to the east and north in m/s, NaN on land, and the depths in m.

    The tide changes the speed by a fifth, and turns the current by up to 9 degrees.
    """
    bed = sea_bed()
    u, v = np.full((2, HOURS, len(DEPTHS), ROWS, COLUMNS), np.nan)
    phase = 2 * np.pi * np.arange(HOURS)[:, None, None] / TIDE
    strength, turn = 1 + 0.2 * np.cos(phase), np.radians(9) * np.sin(phase)
    for k, (depth, eddies, strongest) in enumerate(zip(DEPTHS, EDDIES, STRONGEST, strict=True)):
        water = (bed > 0) & (bed >= depth)
        east, north = layer(water, eddies, strongest)
        cos, sin = strength * np.cos(turn), strength * np.sin(turn)
        u[:, k] = np.where(water, east * cos - north * sin, np.nan)
        v[:, k] = np.where(water, east * sin + north * cos, np.nan)
    return u, v, bed


def write(path: Path) -> None:
    u, v, bed = currents()
    with netCDF4.Dataset(path, "w", format="NETCDF3_CLASSIC") as file:
        file.Conventions = "CF-1.8"
        file.title = "Two basins, a strait and an island: synthetic currents"
        for name, size in (("time", HOURS), ("depth", 3), ("lat", ROWS), ("lon", COLUMNS)):
            file.createDimension(name, size)
        degree = np.pi / 180 * 6371000.0
        lat, lon = SOUTH_WEST
        per_cell = CELL / degree / np.cos(np.radians(lat + ROWS / 2 * CELL / degree))
        for name, values, attributes in (
            ("time", np.arange(HOURS), {"units": "hours since 2011-07-01 00:00:00"}),
            ("depth", DEPTHS, {"units": "m", "positive": "down"}),
            ("lat", lat + CELL / degree * np.arange(ROWS), {"units": "degrees_north"}),
            ("lon", lon + per_cell * np.arange(COLUMNS), {"units": "degrees_east"}),
        ):
            variable = file.createVariable(name, "f8", (name,))
            names = {"lat": "latitude", "lon": "longitude"}
            variable.setncatts({"standard_name": names.get(name, name), **attributes})
            # The last digits of a cosine differ between machines.
            variable[:] = np.round(values, 6)
        variable = file.createVariable("h", "f8", ("lat", "lon"))
        variable.setncatts({"standard_name": "sea_floor_depth_below_sea_level", "units": "m"})
        variable[:] = bed
        for name, values, towards in (("u", u, "eastward"), ("v", v, "northward")):
            variable = file.createVariable(
                name, "i2", ("time", "depth", "lat", "lon"), fill_value=-32767
            )
            variable.setncatts(
                {
                    "standard_name": f"{towards}_sea_water_velocity",
                    "units": "m s-1",
                    "scale_factor": 0.001,
                }
            )
            # A masked array also casts the numbers under its mask.
            variable[:] = np.ma.masked_array(np.nan_to_num(values), np.isnan(values))


def main(folder: Path) -> None:
    write(folder / "gyres.nc")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
