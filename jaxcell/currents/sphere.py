"""Geometry of cells on the Earth: order of coordinates, sides in metres, angle of the x axis."""

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from ..base.doubts import Doubt, warn


_Cells: TypeAlias = Float[np.ndarray, "y x"]

EARTH_RADIUS = 6371000.0

# A grid goes round the Earth if the spacing across its seam is between the spacings on both sides,
# within the first relative tolerance. Columns are the same if they differ by less than the second
# share of their spacing.
_SEAM, _SAME = 0.1, 0.01
# The largest number of repeated columns, and the spacing of columns below which a row is at a pole.
_MAX_REPEATED, _POLE = 4, 1e-9
# A grid is folded if more than this share of the last row repeats another row.
_FOLDED = 0.9


def wrapped(lon: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    """Wrap longitudes to the interval from -180 to 180 degrees; 180 becomes -180."""
    return (lon + 180.0) % 360.0 - 180.0


def warn_if_wide(bounds: Sequence[float | int]) -> None:
    """Warn if bounds cross the date line and most of the Earth: west and east may be exchanged."""
    west, _, east, _ = bounds
    if west > east and (width := (east - west) % 360) > 180:
        wide = f"from {west:g} eastward to {east:g} degrees goes {width:g} degrees round the Earth"
        way_on = f"for {360 - width:g} degrees give {east:g} first"
        warn(f"`bounds`: {wide}, across the date line; {way_on}", Doubt)


def repeated_columns(lon: Float[np.ndarray, " x"]) -> int:
    """Count the longitudes at the end that repeat the first ones after a turn of 360 degrees."""
    steps = wrapped(np.diff(lon))
    place = np.abs(np.append(0.0, np.cumsum(steps)))
    same = _SAME * np.abs(steps).min(initial=np.inf)
    again = int((place >= 360 - same).sum())
    # A column is dropped only if the column that it repeats is kept.
    apart = np.abs(place[lon.size - again :] - 360 - place[:again])
    return again if 2 * again <= lon.size and (apart <= same).all() else 0


def overlapping_columns(lon: _Cells, lat: _Cells) -> int:
    """Count the columns at the end of a grid that repeat its first columns, often one or two."""
    most = min(_MAX_REPEATED, lon.shape[1] // 2)
    first = on_sphere(lon[:, : most + 1], lat[:, : most + 1])
    last = on_sphere(lon[:, -most:], lat[:, -most:])
    apart = np.linalg.norm(np.diff(first, axis=2), axis=0).min(axis=1)
    for count in range(most, 0, -1):
        off = np.linalg.norm(last[:, :, -count:] - first[:, :, :count], axis=0).max(axis=1)
        known = np.isfinite(off + apart) & (apart > _POLE)
        if known.any() and (off <= _SAME * apart)[known].all():
            return count
    return 0


def folded_rows(lon: _Cells, lat: _Cells) -> int:
    """Count the rows at the end of a grid that repeat other rows, because the grid is folded there.

    If the fold is between two rows, the last row repeats the previous row, reversed. If the fold is
    on a row, this row is its own mirror image, and the last row repeats the row before the fold.
    """
    rows, columns = lon.shape
    if rows < 6 or columns < 3:
        return 0
    centres = on_sphere(lon[-3:], lat[-3:])
    last = centres[:, -1][:, np.isfinite(centres[:, -1]).all(axis=0)]
    for count, other in ((1, -2), (2, -3)):
        row = centres[:, other]
        known = np.isfinite(row).all(axis=0)
        if known.sum() < 3 or last.shape[1] < 3:
            continue
        spacing = np.nanmedian(np.linalg.norm(np.diff(row, axis=1), axis=0))
        off, _ = cKDTree(row[:, known].T).query(last.T)
        if spacing > _POLE and (off <= _SAME * spacing).mean() > _FOLDED:
            return count
    return 0


def goes_round(lon: _Cells, lat: _Cells) -> bool:
    """Return whether rows go once round the Earth, with a seam as wide as the spacing beside it."""
    if lon.shape[1] < 3:
        return False
    turn = wrapped(np.diff(lon, axis=1, append=lon[:, :1])).sum(axis=1)
    near = [-2, -1, 0, 1]
    before, seam, after = np.linalg.norm(
        np.diff(on_sphere(lon[:, near], lat[:, near]), axis=2), axis=0
    ).T
    least, most = np.minimum(before, after), np.maximum(before, after)
    known = np.isfinite(before + seam + after) & (least > _POLE)
    closes = (seam >= (1 - _SEAM) * least) & (seam <= (1 + _SEAM) * most)
    once = np.abs(np.abs(turn) - 360) < 1e-6
    return bool(once.any() and known.any() and closes[known].all())


def eastward_order(lon: Float[np.ndarray, " x"]) -> Int[np.ndarray, " x"]:
    """Return the indices that sort longitudes from West to East, from the western end of the grid.

    The longitudes must ascend, or descend, over less than 360 degrees. They may also jump by 360
    degrees anywhere; then all gaps between columns must be less than 180 degrees. A grid that goes
    round the Earth begins at -180 degrees; other grids begin after their widest gap, so that a grid
    across the antimeridian stays whole.
    """
    steps = np.diff(lon)
    if not (((steps > 0).all() or (steps < 0).all()) and np.ptp(lon) < 360):
        steps = wrapped(steps)
    _check_order("longitudes", lon, steps)
    if np.abs(steps).sum() >= 360 - 1e-9:
        raise ValueError(f"expected less than a turn, got {lon[0]:g} to {lon[-1]:g}")
    order = np.argsort(wrapped(lon))
    gaps = np.diff(wrapped(lon)[order], append=wrapped(lon)[order[0]] + 360)
    widest = int(gaps.argmax())
    return np.roll(order, -widest - 1) if gaps[widest] > 1.5 * np.median(gaps) else order


def northward_order(lat: Float[np.ndarray, " y"]) -> Int[np.ndarray, " y"]:
    """Return the indices that sort latitudes from South to North."""
    steps = np.diff(lat)
    _check_order("latitudes", lat, steps)
    if np.abs(lat).max() > 90:
        raise ValueError(f"expected degrees from -90 to 90, got {lat[np.abs(lat).argmax()]:g}")
    return np.arange(len(lat)) if steps[0] > 0 else np.arange(len(lat))[::-1]


def inside(
    lon: Float[np.ndarray, "*shape"],
    lat: Float[np.ndarray, "*shape"],
    bounds: tuple[float, float, float, float],
) -> Bool[np.ndarray, "*shape"]:
    """Mark the points within bounds `(west, south, east, north)` in degrees, edges included.

    If west is more than east, the bounds cross the antimeridian.
    """
    west, south, east, north = bounds
    width = (east - west) % 360 if east - west < 360 else 360.0
    # A rounding error could put a point of the western edge 360 degrees to the East of this edge.
    eastward = (lon - west + 1e-9) % 360
    return (eastward <= width + 2e-9) & (lat >= south - 1e-9) & (lat <= north + 1e-9)


def rectangular_sides(
    lon: Float[np.ndarray, " all_x"],
    lat: Float[np.ndarray, " all_y"],
    rows: Int[np.ndarray, " y"],
    columns: Int[np.ndarray, " x"],
    *,
    wraps: bool = False,
) -> tuple[_Cells, _Cells]:
    """Compute the sides in metres of cells between meridians and parallels.

    A cell extends half way to its neighbours; at the edge of the grid, it extends as far outward as
    inward. `lon` and `lat` are the ascending coordinates of the whole grid; `rows` and `columns`
    select the cells.

    **Returns:** `dx` along the parallel of the centre, and `dy` along the meridian.
    """
    around = np.pad(lon, 1, mode="wrap") if wraps else lon
    across = np.radians(np.gradient(np.unwrap(around, period=360)))
    across = (across[1:-1] if wraps else across)[columns]
    along = np.radians(np.gradient(lat))[rows]
    dx = EARTH_RADIUS * np.cos(np.radians(lat[rows]))[:, None] * across
    return dx, np.broadcast_to(EARTH_RADIUS * along[:, None], dx.shape).copy()


def continued(lon: _Cells, lat: _Cells) -> tuple[_Cells, _Cells]:
    """Continue a grid, at the steps beside it, into the holes where it has no position.

    It is continued by two cells or more, so that all cells beside a hole have sides.
    """
    eastward, northward = lon.copy(), lat.copy()
    for values in 2 * (eastward, northward):
        for axis in (0, 1):
            for step in (1, -1):
                near, far = (np.roll(values, k * step, axis) for k in (1, 2))
                inner = [slice(None), slice(None)]
                inner[axis] = slice(2, None) if step == 1 else slice(None, -2)
                at = np.zeros(values.shape, bool)
                at[tuple(inner)] = True
                guess = near + wrapped(near - far)
                at &= np.isnan(values) & np.isfinite(guess)
                values[at] = guess[at]
    return eastward, northward


def curvilinear_sides(
    lon: _Cells, lat: _Cells, *, wraps: bool = False
) -> tuple[_Cells, _Cells, _Cells, _Cells]:
    """Compute the sides and directions of the cells of any grid of at least 2 x 2 centres.

    Along each axis, a side is half the straight-line distance between the two neighbours of a cell;
    at the edge of the grid, it is the distance between the cell and its only neighbour.

    **Returns:** `dx` and `dy`, the sides in metres along the x and y axes; `angle`, radians
    counter-clockwise from East to the x axis; `turn`, the sine of the angle from the x axis to the
    y axis, which is negative where the grid is a mirror image.
    """
    longitude, latitude = np.radians(lon), np.radians(lat)
    cos_lon, sin_lon, sin_lat = np.cos(longitude), np.sin(longitude), np.sin(latitude)
    east = np.stack([-sin_lon, cos_lon, np.zeros_like(lon)])
    north = np.stack([-sin_lat * cos_lon, -sin_lat * sin_lon, np.cos(latitude)])
    around = on_sphere(lon, lat)
    around = np.pad(around, ((0, 0), (0, 0), (1, 1)), mode="wrap") if wraps else around
    along_y, along_x = np.gradient(around, axis=(1, 2))
    if wraps:
        along_y, along_x = along_y[:, :, 1:-1], along_x[:, :, 1:-1]
    dx = np.linalg.norm(along_x, axis=0)
    dy = np.linalg.norm(along_y, axis=0)
    (x_east, x_north), (y_east, y_north) = (
        ((along * east).sum(axis=0), (along * north).sum(axis=0)) for along in (along_x, along_y)
    )
    with np.errstate(invalid="ignore", divide="ignore"):
        turn = (x_east * y_north - x_north * y_east) / (dx * dy)
    return EARTH_RADIUS * dx, EARTH_RADIUS * dy, np.arctan2(x_north, x_east), turn


def on_sphere(
    lon: Float[np.ndarray, "*shape"], lat: Float[np.ndarray, "*shape"]
) -> Float[np.ndarray, "3 *shape"]:
    """Return the unit vectors from the centre of the Earth to points in degrees."""
    east, north = np.radians(lon), np.radians(lat)
    return np.stack([np.cos(north) * np.cos(east), np.cos(north) * np.sin(east), np.sin(north)])


def distances(
    points: Float[np.ndarray, "3 *all"], others: Float[np.ndarray, "3 *any"]
) -> Float[np.ndarray, "*all"]:
    """Compute great-circle distances in metres between unit vectors; `others` are broadcast."""
    chord = np.linalg.norm(points - others, axis=0)
    return 2 * EARTH_RADIUS * np.arcsin(np.minimum(chord / 2, 1))


def turned(
    x: Float[Any, "*any"], y: Float[Any, "*any"], angle: Float[np.ndarray, "..."]
) -> tuple[Float[Any, "*all"], Float[Any, "*all"]]:
    """Turn vectors counter-clockwise by an angle in radians.

    The angle from East to the x axis turns components along x and y to East and North."""
    cos, sin = np.cos(angle), np.sin(angle)
    return x * cos - y * sin, x * sin + y * cos


def _check_order(what: str, values: np.ndarray, steps: np.ndarray) -> None:
    """Raise if `values` are not finite, or if their differences `steps` change sign."""
    if not np.isfinite(values).all():
        got = f"no number at index {int((~np.isfinite(values)).argmax())}"
    elif (steps > 0).all() or (steps < 0).all():
        return
    else:
        k = int((np.sign(steps) != np.sign(steps[0])).argmax()) if steps[0] else 0
        got = f"{values[k]:g} then {values[k + 1]:g} at index {k + 1}"
    raise ValueError(f"expected {what} in order, got {got}")
