"""The frame of the maps of a sea, and squares of sea without data in recordings."""

import re

import numpy as np
import pytest
import shapely
from recordings import read_back
from seas import drift_of, land_of_the_channel, sea

from jaxcell import drift
from jaxcell.currents.sphere import EARTH_RADIUS
from jaxcell.drift.positions import on_the_grid
from jaxcell.record.drift.frame import (
    _coasts,
    _ticks,
    latitude,
    longitude,
    place_name,
    round_below,
)
from jaxcell.record.drift.map import Clock


DEGREE = np.radians(1) * EARTH_RADIUS


def degrees(column, row, angle=0.6, side=2000.0, lon=-119.7, lat=34.1):
    """The longitude and latitude of places on a turned grid, relative to its middle, in squares."""
    y = lat + side * (column * np.sin(angle) + row * np.cos(angle)) / DEGREE
    east = side * (column * np.cos(angle) - row * np.sin(angle))
    return lon + east / DEGREE / np.cos(np.radians(y)), y


def turned(angle=0.6, rows=20, columns=30, side=2000.0, **middle):
    """A grid of squares that is turned by an angle in radians."""
    row, column = np.indices((rows, columns)) - np.array([rows, columns])[:, None, None] / 2
    whole = np.ones((rows, columns))
    number = np.arange(rows * columns, dtype=np.int32).reshape(rows, columns)
    x, y = degrees(column, row, angle, side, **middle)
    return drift.Water(number, side * whole, side * whole, angle * whole, x, y, 0.0)


@pytest.mark.parametrize("angle", [0.0, 0.6, -2.0])
def test_places_in_degrees_are_found_on_turned_grids(angle):
    grid = turned(angle)
    place, square = on_the_grid(grid, grid.lon.ravel(), grid.lat.ravel())
    row, column = np.indices(grid.number.shape)
    np.testing.assert_allclose(place, np.stack([column.ravel(), row.ravel()], axis=1), atol=1e-9)
    np.testing.assert_array_equal(square, np.arange(grid.number.size))
    # Between four centres.
    middle = [(v[1:, 1:] + v[:-1, :-1] + v[1:, :-1] + v[:-1, 1:]) / 4 for v in (grid.lon, grid.lat)]
    place, _ = on_the_grid(grid, *(values.ravel() for values in middle))
    expected = np.stack([column[1:, 1:].ravel(), row[1:, 1:].ravel()], axis=1) - 0.5
    np.testing.assert_allclose(place, expected, atol=0.01)


def test_coasts_on_the_map_are_those_of_the_land():
    grid = turned()
    coasts = list(_coasts(grid, ""))
    assert sum(map(len, coasts)) > 20
    near = land_of_the_channel()
    rows, columns = grid.number.shape
    for x, y in np.concatenate(coasts):
        assert -0.5 <= x <= columns - 0.5
        assert -0.5 <= y <= rows - 0.5
        if min(x, y, columns - 1 - x, rows - 1 - y) < 0.5:
            continue  # cut at the edge
        place = shapely.Point(degrees(x - columns / 2, y - rows / 2))
        assert near.boundary.distance(place) < 0.003


def test_far_from_land_there_is_no_coast():
    assert not list(_coasts(turned(lon=-150.0, lat=40.0), ""))


def test_degrees_are_marked_at_the_edges():
    currents = sea(np.ones((21, 29)), np.zeros((21, 29)))
    grid = drift.Water.of(currents)
    side = np.array([1.0, 1.0])
    marks = list(_ticks(grid, side))
    for name, place, axis in marks:
        degrees = float(re.match(r"[\d.]+", name)[0]) * (-1 if name[-1] in "WS" else 1)
        first, step = ((-118, 0.0107), (33, 0.009))[axis]
        assert place == pytest.approx((degrees - first) / step + 0.5, abs=1e-6)
    assert {axis for *_, axis in marks} == {0, 1}
    assert sum(axis == 0 for *_, axis in marks) >= 3


def test_places_have_their_hemispheres():
    assert longitude(-118.25) == "118.25° W"
    assert longitude(181.5, 1) == "178.5° W"
    assert longitude(0.0, 0) == "0°"
    assert latitude(-33.5, 1) == "33.5° S"
    assert latitude(67.0, 0) == "67° N"
    assert place_name(5.0, -0.5) == "0.50° S, 5.00° E"


def test_the_recording_tells_land_from_sea_without_data(few_drifters):
    wet = np.ones((4, 6), bool)
    wet[1:3, 3] = False
    currents = sea(np.where(wet, 0.3, 0), np.zeros(wet.shape), wet)
    land = np.zeros_like(wet)
    land[1, 3] = True
    currents["land"] = ("layer", "y", "x"), land[None]
    found = drift_of(currents, drift.METHODS["drifters"].lasting(3000), mean=False)
    np.testing.assert_array_equal(found.land[0], land)
    np.testing.assert_array_equal(found.sea_without_data[0], ~wet & ~land)
    assert found.land_squares == 1
    assert found.gap_squares == 1
    assert found.mean_leaving == pytest.approx(
        found.mean_leaving_into_gaps + found.mean_leaving_off_edge
    )
    shown = read_back(found, {})
    for name in ("water_0", "groups_0"):
        assert shown.labels(f"/map/grid/{name}")[1:3, 3].tolist() == ["land", "sea without data"]
    speeds = shown.static("/map/key/speed", "Points2D:labels")
    assert re.fullmatch(r"[\d.]+ m/s", speeds[0])
    length = np.array(shown.static("/map/key/arrow", "Arrows2D:vectors"))[0, 0]
    # The current of 0.3 m/s, whose arrows are 0.9 of a cell of 1 km.
    assert length == pytest.approx(0.9 * float(speeds[0].split()[0]) / 0.3)


@pytest.mark.usefixtures("few_drifters")
@pytest.mark.parametrize(
    ("duration", "hours", "unit", "frame"),
    [
        (4 * 86400, 24, "day", 1),
        (4 * 3600, 1, "hour", 1),
        (40, 0.01, "second", 10),
        (2400, 24, "minute", 18),
        (9, 1, "second", 45),
    ],
)
def test_the_clock_is_as_fine_as_the_steps(duration, hours, unit, frame):
    currents = sea(*np.full((2, 3, 3, 4), 0.2), hours=hours)
    clock = Clock(drift_of(currents, drift.DriftStep(duration, spread="all")))
    assert (clock.unit, clock.frame) == (unit, frame)
    # It goes on for 40 steps, and until the current of three records begins again.
    wanted = max(40 * duration, 3 * hours * 3600)
    assert wanted <= clock.last * clock.seconds <= wanted + clock.frame * clock.seconds
    assert clock.frames <= 241


def test_lengths_are_round():
    assert [round_below(one) for one in (7.2, 1.9, 0.05, 99.0)] == [5, 1, 0.05, 50]
