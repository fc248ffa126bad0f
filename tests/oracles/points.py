"""Drifters at points, from a NetCDF file of currents on latitudes and longitudes without land.

The file is read with netCDF4, and interpolation, steps and the test for sea without data are those
of this module.
"""

import netCDF4
import numpy as np


RADIUS = 6_371_000.0


class PointDrifters:
    """A current at points: bilinear between squares, and linear between records."""

    def __init__(self, path, u="uo", v="vo"):
        with netCDF4.Dataset(path) as file:
            self.lon, self.lat, self.time = (
                np.asarray(file[name][:], float) for name in ("longitude", "latitude", "time")
            )
            fields = [np.ma.filled(file[name][:].astype(float), np.nan) for name in (u, v)]
        self.known = np.isfinite(fields[0]).all(axis=0)
        self.speed = np.stack([self._filled(field) for field in fields], axis=1)
        self.sides = self.lon[1] - self.lon[0], self.lat[1] - self.lat[0]

    def _filled(self, field):
        """Give sea without data the velocity of the nearest square that has one."""
        rows, columns = np.nonzero(self.known)
        field = field.copy()
        for row, column in np.argwhere(~self.known):
            nearest = np.argmin((rows - row) ** 2 + (columns - column) ** 2)
            field[:, row, column] = field[:, rows[nearest], columns[nearest]]
        return field

    def places(self, lon, lat):
        return (lon - self.lon[0]) / self.sides[0], (lat - self.lat[0]) / self.sides[1]

    def gone(self, lon, lat):
        """Mark the points beyond the outermost squares, or in a square without data."""
        x, y = self.places(lon, lat)
        column, row = (np.floor(place + 0.5).astype(int) for place in (x, y))
        rows, columns = self.known.shape
        inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
        return ~inside | ~self.known[row.clip(0, rows - 1), column.clip(0, columns - 1)]

    def rate(self, lon, lat, time):
        """The drift at points, in degrees per second."""
        x, y = self.places(lon, lat)
        i = np.floor(x).astype(int).clip(0, self.lon.size - 2)
        j = np.floor(y).astype(int).clip(0, self.lat.size - 2)
        a, b = (x - i).clip(0, 1), (y - j).clip(0, 1)
        field = self.speed[0]
        if self.time.size > 1:
            k = int(np.clip(np.searchsorted(self.time, time) - 1, 0, self.time.size - 2))
            share = np.clip((time - self.time[k]) / (self.time[k + 1] - self.time[k]), 0, 1)
            field = (1 - share) * self.speed[k] + share * self.speed[k + 1]
        east, north = (
            (1 - b) * ((1 - a) * one[j, i] + a * one[j, i + 1])
            + b * ((1 - a) * one[j + 1, i] + a * one[j + 1, i + 1])
            for one in field
        )
        metres = np.radians(1) * RADIUS
        return east / (metres * np.cos(np.radians(lat))), north / metres

    def drift(self, lon, lat, seconds, step, begin=0.0):
        """Move points; return their places, and whether they have met sea without data."""
        lon, lat = np.array(lon, float), np.array(lat, float)
        left = self.gone(lon, lat)
        count = int(np.ceil(seconds / step))
        h = seconds / count
        for number in range(count):
            now = begin + number * h
            a = self.rate(lon, lat, now)
            b = self.rate(lon + h / 2 * a[0], lat + h / 2 * a[1], now + h / 2)
            c = self.rate(lon + h / 2 * b[0], lat + h / 2 * b[1], now + h / 2)
            d = self.rate(lon + h * c[0], lat + h * c[1], now + h)
            along = [h / 6 * (p + 2 * q + 2 * r + s) for p, q, r, s in zip(a, b, c, d, strict=True)]
            lon, lat = (
                np.where(left, old, old + new) for old, new in zip((lon, lat), along, strict=True)
            )
            left |= self.gone(lon, lat)
        return lon, lat, left
