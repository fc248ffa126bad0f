"""Land from a coastline: polygons of Natural Earth, or of a file."""

import dataclasses
import functools
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from jaxtyping import Bool, Float

from ..base.bundled import bundled
from ..base.optional_modules import import_module
from ..base.paths import absent
from .grid import OceanGrid
from .netcdf import error_line
from .sphere import EARTH_RADIUS, turned


_BUNDLED = "Natural Earth 1:10 million"
# Precision of the corners of bundled polygons, in degrees.
_DIGITS = 0.001
# The largest half side of a square in degrees; squares near a pole would span more degrees.
_MOST = 10.0


@dataclasses.dataclass(frozen=True, eq=False)
class Land:
    """The land of the Earth, or of a part of the Earth."""

    name: str
    polygons: np.ndarray
    "The polygons in degrees, as shapely objects."

    def within(self, grid: OceanGrid, chosen: Bool[np.ndarray, "y x"]) -> Bool[np.ndarray, "y x"]:
        """Mark the squares of a grid that contain land, among the `chosen` squares.

        A square that is partly land counts as land, because its velocity is rarely known. Squares
        without a position count as land too.
        """
        marks = chosen & ~np.isfinite(grid.lon + grid.lat)
        centre = np.nonzero(chosen & ~marks)
        tree = shapely.STRtree(shapely.points(grid.lon[centre], grid.lat[centre]))
        inland = np.unique(tree.query(self.polygons, predicate="contains")[1])
        marks[tuple(index[inland] for index in centre)] = True
        at = row, column = np.nonzero(chosen & ~marks)
        lon, lat, angle = grid.lon[at], grid.lat[at], np.nan_to_num(grid.angle[at])
        degrees = np.stack([1 / np.cos(np.radians(lat)), np.ones_like(lat)])  # for equal lengths
        corners = []
        for i, j in ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)):
            metres = np.stack(turned(i * grid.dx[at], j * grid.dy[at], angle))
            away = np.nan_to_num(metres * degrees / np.radians(EARTH_RADIUS))
            corners.append(np.stack([lon, lat]) + away.clip(-_MOST, _MOST))
        tree = shapely.STRtree(shapely.polygons(np.stack(corners).transpose(2, 0, 1)))
        holds = np.unique(tree.query(self.polygons, predicate="intersects")[1])
        marks[row[holds], column[holds]] = True
        return marks

    def coasts(
        self, west: float, south: float, east: float, north: float
    ) -> Iterator[Float[np.ndarray, "points 2"]]:
        """Yield the coastlines within a box in degrees, whose longitudes may exceed 180."""
        for turn in (-360.0, 0.0, 360.0):
            box = west - turn, south, east - turn, north
            near = self.polygons[shapely.intersects(self.polygons, shapely.box(*box))]
            lines = shapely.get_parts(shapely.clip_by_rect(shapely.get_rings(near), *box))
            for line in lines:
                points = shapely.get_coordinates(line)
                # At the antimeridian and the South pole polygons are cut, but there is no coast.
                cut = np.abs(points[:, 0]) > 180 - _DIGITS / 2
                cut |= points[:, 1] < -90 + _DIGITS / 2
                for part in np.split(points, np.flatnonzero(cut[1:] & cut[:-1]) + 1):
                    if len(part) > 1:
                        yield np.add(part, [turn, 0.0])


def read_land(path: str | os.PathLike[str] | None = None) -> Land:
    """Read land from a GeoJSON file or a shapefile; by default, the land of Natural Earth.

    **Raises:** `FileNotFoundError`, or `ValueError` for a file without polygons in degrees.
    """
    if path is None:
        return Land(_BUNDLED, _bundled_polygons())
    if not Path(path).is_file():
        raise absent(path)
    about = os.stat(path)
    return _read_land(os.fspath(path), (about.st_mtime_ns, about.st_size))


@functools.lru_cache(maxsize=2)
def _read_land(path: str, version: tuple[int, int]) -> Land:
    """Read land from a file; the cache reads it again if `version`, its time and size, changes."""
    in_shapefile = Path(path).suffix.lower() in (".shp", ".zip")
    reader = import_module("shapefile").Reader if in_shapefile else None
    shapes: Any
    try:
        if reader is None:
            shapes = shapely.from_geojson(Path(path).read_text())
        else:
            with reader(path) as file:
                shapes = [shapely.geometry.shape(one) for one in file.iterShapes()]
    except Exception as error:  # the exceptions for damaged files are not documented
        why = "cannot be read as GeoJSON or a shapefile"
        raise ValueError(f"{path}: {why}: {error_line(error)}") from error
    # Twice: polygons may be in collections within the collection of the file.
    parts = shapely.get_parts(shapely.get_parts(np.atleast_1d(shapes)))
    polygons = parts[shapely.get_type_id(parts) == shapely.GeometryType.POLYGON]
    if polygons.size == 0:
        raise ValueError(f"{path}: expected polygons of land, got none")
    west, south, east, north = shapely.total_bounds(polygons)
    if not (west >= -360 and east <= 360 and south >= -91 and north <= 91):
        got = f"{west:g} to {east:g} and {south:g} to {north:g}"
        raise ValueError(f"{path}: expected longitudes and latitudes in degrees, got {got}")
    polygons = shapely.get_parts(shapely.make_valid(polygons))
    west, _, east, _ = shapely.bounds(polygons).T
    beyond = [
        shapely.transform(polygons[mask], lambda points, turn=turn: np.add(points, [turn, 0.0]))
        for mask, turn in ((east > 180, -360.0), (west < -180, 360.0))
    ]
    return Land(Path(path).name, np.concatenate([polygons, *beyond]))


@functools.cache
def _bundled_polygons() -> np.ndarray:
    with np.load(bundled("ocean/land.npz")) as arrays:
        steps = np.stack([arrays["east"], arrays["north"]], axis=1)
        offsets = arrays["rings"], arrays["polygons"]
    corners = np.cumsum(steps, axis=0) * _DIGITS
    return shapely.from_ragged_array(shapely.GeometryType.POLYGON, corners, offsets)
