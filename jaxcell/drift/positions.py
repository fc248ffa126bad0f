"""Positions in degrees as columns and rows of a grid, and back."""

import math

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from ..currents.sphere import EARTH_RADIUS, on_sphere, turned, wrapped
from .water import Water, square


_DEGREE = math.radians(1) * EARTH_RADIUS


def on_the_grid(
    water: Water, lon: Float[np.ndarray, "points"], lat: Float[np.ndarray, "points"]
) -> tuple[Float[np.ndarray, "points 2"], Int[np.ndarray, "points"]]:
    """Convert positions in degrees, on or off a grid, to columns and rows of the grid.

    A position is the column and row of the nearest square, plus the offset from the centre of this
    square along the axes of the grid, in multiples of its width and height.

    **Returns:** the columns and rows, and the index of the nearest square in the flattened grid.
    """
    known = np.flatnonzero(np.isfinite(water.lon + water.lat).ravel())
    grid_lon, grid_lat = water.lon.ravel()[known], water.lat.ravel()[known]
    _, near = cKDTree(on_sphere(grid_lon, grid_lat).T).query(on_sphere(lon, lat).T)
    square = known[near]
    row, column = np.unravel_index(square, water.number.shape)
    east = wrapped(lon - grid_lon[near]) * _DEGREE * np.cos(np.radians(grid_lat[near]))
    north = (lat - grid_lat[near]) * _DEGREE
    angle, dx, dy = (values.ravel()[square] for values in (water.angle, water.dx, water.dy))
    cos, sin = np.cos(angle), np.sin(angle)
    x = column + (east * cos + north * sin) / dx
    y = row + (north * cos - east * sin) / dy
    return np.stack([x, y], axis=-1), square


def in_degrees(
    water: Water, x: Float[np.ndarray, "*points"], y: Float[np.ndarray, "*points"]
) -> tuple[Float[np.ndarray, "*points"], Float[np.ndarray, "*points"]]:
    """Convert columns and rows of a grid to longitudes and latitudes, as [`on_the_grid`][] inverts.

    A position is the centre of its square plus an offset in metres.
    """
    rows, columns = water.number.shape
    x = water.on_columns(x)
    row, column = (
        place.clip(0, most - 1) for place, most in zip(square(x, y), (rows, columns), strict=True)
    )
    angle, dx, dy, lon, lat = (
        values[row, column] for values in (water.angle, water.dx, water.dy, water.lon, water.lat)
    )
    east, north = turned((x - column) * dx, (y - row) * dy, angle)
    return wrapped(lon + east / (_DEGREE * np.cos(np.radians(lat)))), lat + north / _DEGREE
