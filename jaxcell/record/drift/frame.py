"""The frame of the maps of a sea: coastline, degrees at the edges, scale bar and North arrow."""

import math
from collections.abc import Iterator

import numpy as np
import rerun as rr
from jaxtyping import Float

from ...currents.land import read_land
from ...currents.sphere import EARTH_RADIUS, wrapped
from ...drift import Water
from ...drift.positions import on_the_grid
from ..canvas.marks import log_arrows, log_labels, log_lines
from ..canvas.palette import TEXT, Color


COAST: Color = (24, 24, 28)
# The least number of lines of longitude or latitude that are marked at an edge.
_LEAST_TICKS = 3
# The possible distances between marks, in degrees.
_STEPS = (*(n * 10.0**k for k in (1, 0, -1, -2) for n in (5, 2, 1)),)


def log_frame(
    stream: rr.RecordingStream, water: Water, side: Float[np.ndarray, "2"], coastline: str
) -> None:
    """Log the coastline, degrees at the edges, a scale bar and a North arrow.

    `side` contains the mean width and height of a cell in kilometres. `coastline` is a file of
    coasts, or "" for those of Natural Earth.
    """
    rows, columns = water.number.shape
    width, height = (np.array([columns, rows]) * side).tolist()
    margin = 0.04 * max(width, height)
    coasts = [(place + 0.5) * side for place in _coasts(water, coastline)]
    log_lines(stream, "map/frame/coast", coasts, COAST, 1.2, order=5.0)
    low, length = -2.2 * margin, round_below(0.25 * width)
    log_lines(stream, "map/frame/scale", [[[0, low], [length, low]]], TEXT, order=50.0)
    angle = float(water.angle[water.row, water.column].mean())
    north = 1.5 * margin * np.array([math.sin(angle), math.cos(angle)])
    foot = np.array([0.42 * width, low]) - north / 2
    log_arrows(stream, "map/frame/north", [foot], [north], TEXT, 0.1 * margin, order=50.0)
    beside_x, beside_y = (foot + north / 2 + [0.7 * margin, 0.3 * margin]).tolist()
    labels = [(f"{length:g} km", 0.5 * length, low), ("N", beside_x, beside_y)]
    ticks = []
    for name, place, axis in _ticks(water, side):
        # The viewer centres a label below its place.
        if axis == 0:
            ticks.append([[place, 0.0], [place, -0.4 * margin]])
            labels.append((name, place, -0.4 * margin))
        else:
            ticks.append([[0.0, place], [-0.4 * margin, place]])
            labels.append((name, -1.6 * margin, place + 0.4 * margin))
    log_lines(stream, "map/frame/ticks", ticks, TEXT, 1.0, order=50.0)
    log_labels(stream, "map/frame/labels", labels)


def _coasts(water: Water, coastline: str) -> Iterator[Float[np.ndarray, "points 2"]]:
    """Yield the lines of the coast, as columns and rows of the grid."""
    rows, columns = water.number.shape
    lon, lat = water.lon, water.lat
    known = np.isfinite(lon + lat)
    middle = float(lon[known][known.sum() // 2])
    east = wrapped(lon[known] - middle)
    room = float(np.degrees(water.reach[known].max() / EARTH_RADIUS))
    wide = room / max(0.1, math.cos(math.radians(float(np.abs(lat[known]).max()))))
    west, south = middle + east.min() - wide, max(-90.0, lat[known].min() - room)
    box = west, south, middle + east.max() + wide, min(90.0, lat[known].max() + room)
    lines = [*read_land(coastline or None).coasts(*box)]
    if not lines:
        return
    places, _ = on_the_grid(water, *np.concatenate(lines).T)
    limits = np.array([columns, rows]) - 0.5
    for place in np.split(places, np.cumsum([len(line) for line in lines])[:-1]):
        on = np.all((place >= -0.5) & (place <= limits), axis=1)
        # A line ends at the edge of the map, and at the seam of a grid that goes round the Earth.
        jump = np.abs(np.diff(place, axis=0)).max(axis=1) > max(columns, rows) / 2
        breaks = np.flatnonzero(jump | ~(on[1:] | on[:-1])) + 1
        yield from (part.clip(-0.5, limits) for part in np.split(place, breaks) if len(part) > 1)


def _ticks(water: Water, side: Float[np.ndarray, "2"]) -> Iterator[tuple[str, float, int]]:
    """Yield the text, the position in km, and the axis (0 for x, 1 for y) of each degree mark."""
    for axis, values, name in ((0, water.lon[0], longitude), (1, water.lat[:, 0], latitude)):
        at = np.flatnonzero(np.isfinite(values))
        if at.size < 2:
            continue
        values = np.unwrap(values[at], period=360)
        # The degrees at the outer edges of the grid.
        ends = 1.5 * values[[0, -1]] - 0.5 * values[[1, -2]]
        values = np.concatenate([ends[:1], values, ends[1:]])
        places = np.concatenate([[at[0] - 0.5], at, [at[-1] + 0.5]])
        if values[0] > values[-1]:
            values, places = values[::-1], places[::-1]
        if not (np.diff(values) > 0).all():
            continue
        step = next((s for s in _STEPS if (values[-1] - values[0]) / s >= _LEAST_TICKS), _STEPS[-1])
        digits = max(0, -math.floor(math.log10(step) + 1e-9))
        first, last = math.ceil(values[0] / step), math.floor(values[-1] / step)
        for tick in range(first, last + 1):
            place = float((np.interp(tick * step, values, places) + 0.5) * side[axis])
            yield name(tick * step, digits), place, axis


def longitude(value: float, digits: int = 2) -> str:
    """Format a longitude in degrees with its hemisphere."""
    value = (value + 180) % 360 - 180
    return f"{abs(value):.{digits}f}°{'' if value in (0, -180) else ' W' if value < 0 else ' E'}"


def latitude(value: float, digits: int = 2) -> str:
    """Format a latitude in degrees with its hemisphere."""
    return f"{abs(value):.{digits}f}°{'' if value == 0 else ' S' if value < 0 else ' N'}"


def place_name(lon: float, lat: float) -> str:
    """Format a position in degrees with its hemispheres."""
    return f"{latitude(lat)}, {longitude(lon)}"


def round_below(length: float) -> float:
    """Round a length down to 1, 2 or 5 times a power of ten."""
    size = 10.0 ** math.floor(math.log10(length))
    return next(size * n for n in (5, 2, 1) if size * n <= length * (1 + 1e-9))
