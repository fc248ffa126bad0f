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

from ...base.bundled import bundled
from ...base.optional_modules import import_module
from .netcdf import error_line
from .sphere import wrapped


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
    "The polygons, as objects of shapely, in degrees."

    def within(
        self,
        lon: Float[np.ndarray, "y x"],
        lat: Float[np.ndarray, "y x"],
        chosen: Bool[np.ndarray, "y x"],
    ) -> Bool[np.ndarray, "y x"]:
        """Mark the squares of a grid that contain land, among the `chosen` squares.

        A square that is partly land counts as land, because its velocity is rarely known. Squares
        without a position count as land too. `lon` and `lat` are the centres in degrees.
        """
        marks = chosen & ~np.isfinite(lon + lat)
        centre = np.nonzero(chosen & ~marks)
        tree = shapely.STRtree(shapely.points(lon[centre], lat[centre]))
        inland = np.unique(tree.query(self.polygons, predicate="contains")[1])
        marks[tuple(index[inland] for index in centre)] = True
        row, column = np.nonzero(chosen & ~marks)
        across, along = (
            np.stack([_steps(lon, axis, wraps=True), _steps(lat, axis)], axis=-1)[row, column] / 2
            for axis in (1, 0)
        )
        middle = np.stack([lon, lat], axis=-1)[row, column]
        corners = [middle + i * across + j * along for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
        tree = shapely.STRtree(shapely.polygons(np.stack(corners, axis=1)))
        holds = np.unique(tree.query(self.polygons, predicate="intersects")[1])
        marks[row[holds], column[holds]] = True
        return marks

    def coasts(
        self, west: float, south: float, east: float, north: float
    ) -> Iterator[Float[np.ndarray, "points 2"]]:
        """Yield the lines of the coast within a box of longitude and latitude, in degrees.

        Longitudes of the box may exceed 180 degrees.
        """
        for turn in (-360.0, 0.0, 360.0):
            box = west - turn, south, east - turn, north
            near = self.polygons[shapely.intersects(self.polygons, shapely.box(*box))]
            lines = shapely.get_parts(shapely.clip_by_rect(shapely.get_rings(near), *box))
            for line in lines:
                points = shapely.get_coordinates(line)
                # At the antimeridian and the South pole polygons are cut, but there is no coast.
                cut = (np.abs(points[:, 0]) > 180 - _DIGITS / 2) | (
                    points[:, 1] < -90 + _DIGITS / 2
                )
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
        raise FileNotFoundError(f"{os.fspath(path)}: there is no such file")
    about = os.stat(path)
    return _read_land(os.fspath(path), (about.st_mtime_ns, about.st_size))


@functools.lru_cache(maxsize=2)
def _read_land(path: str, version: tuple[int, int]) -> Land:
    """Read land from a file, once for each `version` of it, which is its time and size."""
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
        raise ValueError(
            f"{path}: cannot be read as GeoJSON or a shapefile: {error_line(error)}"
        ) from error
    # Twice: polygons may be in collections within the collection of the file.
    parts = shapely.get_parts(shapely.get_parts(np.atleast_1d(shapes)))
    polygons = parts[shapely.get_type_id(parts) == shapely.GeometryType.POLYGON]
    if polygons.size == 0:
        raise ValueError(f"{path}: expected polygons of land, got none")
    west, south, east, north = shapely.total_bounds(polygons)
    if not (west >= -360 and east <= 360 and south >= -91 and north <= 91):
        raise ValueError(
            f"{path}: expected longitudes and latitudes in degrees, got {west:g} to {east:g} and "
            f"{south:g} to {north:g}"
        )
    polygons = shapely.get_parts(shapely.make_valid(polygons))
    beyond = [
        shapely.transform(polygons[mask], lambda points, turn=turn: np.add(points, [turn, 0.0]))
        for mask, turn in (
            (shapely.bounds(polygons)[:, 2] > 180, -360.0),
            (shapely.bounds(polygons)[:, 0] < -180, 360.0),
        )
    ]
    return Land(Path(path).name, np.concatenate([polygons, *beyond]))


@functools.cache
def _bundled_polygons() -> np.ndarray:
    with np.load(bundled("ocean/land.npz")) as arrays:
        steps = np.stack([arrays["east"], arrays["north"]], axis=1)
        offsets = arrays["rings"], arrays["polygons"]
    corners = np.cumsum(steps, axis=0) * _DIGITS
    return shapely.from_ragged_array(shapely.GeometryType.POLYGON, corners, offsets)


def _steps(
    values: Float[np.ndarray, "y x"], axis: int, *, wraps: bool = False
) -> Float[np.ndarray, "y x"]:
    """Return the mean step from each centre to its neighbours along an axis, in degrees."""
    steps = np.diff(values, axis=axis)
    steps = wrapped(steps) if wraps else steps
    first, last = steps.take([0], axis), steps.take([-1], axis)
    mean = (np.concatenate([first, steps], axis) + np.concatenate([steps, last], axis)) / 2
    return np.nan_to_num(mean).clip(-2 * _MOST, 2 * _MOST)
