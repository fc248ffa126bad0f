"""The drifters of one release: where they are, how sure that is, and when they arrive."""

import dataclasses
import json

import numpy as np
import pytest
import scipy.stats
import shapely
from open_ocean import SIDE, eddies, write_currents
from oracles.points import RADIUS, PointDrifters
from seas import sea, water_and_flow

from jaxcell import bundled, drift, record, study
from jaxcell.base.doubts import Doubt
from jaxcell.base.intervals import clopper_pearson, drifters_for
from jaxcell.currents.sphere import wrapped
from jaxcell.drift.positions import in_degrees, on_the_grid
from jaxcell.drift.results.sentences import name_place


HOUR = 3600.0


@pytest.fixture(scope="module")
def spill(tmp_path_factory):
    """A release in a file of eddies that change, in the middle of a square, after six hours."""
    path, times = tmp_path_factory.mktemp("release") / "eddies.nc", np.array([1, 0.5, 1.3, 0.8, 1])
    field = eddies(shape=(24, 30), holes=0.0)
    write_currents(path, *(times[:, None, None] * along for along in field))
    points = PointDrifters(path)
    place = points.lon[14], points.lat[12]
    start = ",".join(map(str, place))
    half, south = 0.025 * SIDE, place[1] - 5 * SIDE
    small = shapely.box(place[0] - half, south, place[0] + half, south + 10 * SIDE)
    far = shapely.geometry.mapping(shapely.box(0, 0, 1, 1))
    shapes = {"gate": shapely.geometry.mapping(small), "point": {"type": "Point"}, "far": far}
    features = [
        {"type": "Feature", "properties": {"name": name}, "geometry": shape}
        for name, shape in shapes.items()
    ]
    regions = path.with_suffix(".geojson")
    regions.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    given = {"start": start, "on": "2020-01-01T06:00", "until": 1.0, "at": (0.5,)}
    given |= {"regions": regions}
    with pytest.warns(Doubt, match="feature 'point': expected a polygon"):
        return path, points, place, study.Release(file=(path,), **given).run()


def test_place_spread_and_cells_are_those_of_points_drifted_outside_the_library(spill):
    _, points, (east, north), found = spill
    off = np.random.default_rng(5).uniform(-0.5, 0.5, (2, 20_000)) * SIDE
    for row, hours in enumerate((12, 24)):
        lon, lat, left = points.drift(east + off[0], north + off[1], hours * HOUR, 300.0, 6 * HOUR)
        assert found.hours[row] == hours
        assert found.left[row] == pytest.approx(left.mean(), abs=0.01)
        lon, lat = lon[~left], lat[~left]
        metres = np.radians(1) * RADIUS
        x, y = (lon - lon.mean()) * np.cos(np.radians(lat)) * metres, (lat - lat.mean()) * metres
        away = np.hypot(x, y) / 1000
        error = 3 * away.std() / np.sqrt(found.released) + 0.01 * away.mean()
        side = SIDE * metres / 1000
        assert found.spread[row] == pytest.approx(np.sqrt(np.mean(away**2)), abs=error)
        assert found.radius[row] == pytest.approx(np.quantile(away, 0.9), rel=0.05)
        assert found.centre_lon[row] == pytest.approx(lon.mean(), abs=0.05 * SIDE)
        assert found.centre_lat[row] == pytest.approx(lat.mean(), abs=0.05 * SIDE)
        cell = np.stack(np.floor(np.array(points.places(lon, lat)) + 0.5))
        count = -np.sort(-np.unique(cell, axis=1, return_counts=True)[1])
        fewest = 1 + int(np.searchsorted(np.cumsum(count), 0.9 * count.sum()))
        assert abs(found.likely_cells[row] - fewest) <= 1
        # The grid spreads the drifters of the chain, by a part of a cell in each step.
        assert found.chain_spread[row] < found.spread[row] + 2 * side


def test_a_gate_of_a_twentieth_of_a_cell_is_met_between_looks(spill):
    """Points drifted outside the library for five minutes at a time."""
    _, points, (east, north), found = spill
    off = np.random.default_rng(6).uniform(-0.5, 0.5, (2, 4000)) * SIDE
    lon, lat, seen = east + off[0], north + off[1], np.zeros((2, 4000), bool)
    for step in range(24 * 12 + 1):
        within = np.abs(lon - east) <= 0.025 * SIDE
        seen |= within & np.array([[True], [step % 12 == 0]])
        lon, lat, _ = points.drift(lon, lat, 300.0, 300.0, 6 * HOUR + 300.0 * step)
    assert found.names.tolist() == ["gate", "far", "a square at the coast"]
    assert found.arrival_begin[0] == pytest.approx(0.05, abs=0.01)
    ever, hourly = seen.mean(axis=1)
    assert found.arrival[0] == pytest.approx(ever, abs=0.03)
    assert hourly < 0.5 * ever
    assert found.arrival[1] == 0


def test_a_picture_across_the_date_line_is_as_wide_as_the_grid(spill, tmp_path):
    *_, found = spill
    turn = 180 - found.water.lon.mean()
    water = dataclasses.replace(found.water, lon=wrapped(found.water.lon + turn))
    there = dataclasses.replace(found, water=water, place=(180.0, found.place[1]))
    assert np.ptp(there.lon) > 300
    widths = [np.ptp(one.plot().get_xlim()) for one in (there, found)]
    assert widths[0] == pytest.approx(widths[1])
    record.save_sea(there, tmp_path / "there.png")
    assert name_place(357.0, 1.0) == "1.00° N 3.00° W"


def test_the_first_and_the_last_record_hold_for_half_a_step(spill):
    """Records every twelve hours, such as means, of which the first is at midnight."""
    path, points, (east, north), _ = spill
    given = {"file": (path,), "start": f"{east},{north}", "precision": 0.1}
    found = study.Release(**given, on="2019-12-31T21:30", until=0.2).run()
    assert "The first record is held for 2.5 h beyond its time." in found.remarks
    off = np.random.default_rng(3).uniform(-0.5, 0.5, (2, 500)) * SIDE
    lon, lat = east + off[0], north + off[1]
    for _ in range(30):
        lon, lat, _ = points.drift(lon, lat, 300.0, 300.0, 0.0)
    lon, lat, _ = points.drift(lon, lat, 2.3 * HOUR, 300.0, 0.0)
    assert found.hours[-1] == pytest.approx(4.8)
    assert found.centre_lon[-1] == pytest.approx(lon.mean(), abs=0.1 * SIDE)
    with pytest.raises(ValueError, match="expected a time of the records, 2019-12-31T18:00 to"):
        study.Release(**given, on="2019-12-31T17:00", until=0.1).run()


def test_intervals_are_those_of_clopper_and_pearson(spill):
    *_, found = spill
    for seen in (0, 1, 40, 99, 100):
        limits = scipy.stats.binomtest(seen, 100).proportion_ci(0.95, method="exact")
        np.testing.assert_allclose(np.ravel(clopper_pearson(np.array([seen]), 100)), limits)
    for width in (0.1, 0.01):
        count = drifters_for(width)
        low, high = scipy.stats.binomtest(count // 2, count).proportion_ci(0.95, method="exact")
        assert 0.95 * width < (high - low) / 2 <= width
    inside = np.isfinite(found.share)
    assert (found.low[inside] <= found.share[inside]).all()
    assert (found.share[inside] <= found.high[inside]).all()


def test_drifters_arrive_when_the_stream_brings_them():
    """A stream of a kilometre an hour to a coast; the last square of water has half its speed."""
    wet = np.ones((5, 12), bool)
    wet[:, -1] = False
    water, flow = water_and_flow(sea(np.full((5, 12), 1 / 3.6), np.zeros((5, 12)), wet))
    points = np.stack([np.full(200, 2.0), np.full(200, 2.0)])
    lon, lat = water.lon[2], water.lat[:, 0]
    strait = shapely.box((lon[5] + lon[6]) / 2, lat[0], (lon[6] + lon[7]) / 2, lat[-1])
    regions = np.array(["strait"]), np.array([strait])
    found = drift.Released.of(
        water, flow, points, [8 * HOUR, 48 * HOUR], regions=regions, afloat=2 * HOUR
    )
    assert found.names.tolist() == ["strait", "a square at the coast"]
    assert found.arrival.tolist() == [1, 1]
    # From column 2 to the edge of column 6 are 3.5 km, to that of the coast 7.5 km.
    assert found.arrival_median[0] == pytest.approx(3.5, rel=1e-3)
    assert found.arrival_median[1] == pytest.approx(7.5, abs=0.3)
    # Half of the drifters at the coast strand in two hours: the first look is after 8 h.
    assert found.ashore[0] == pytest.approx(1 - 0.5**0.5, abs=0.1)
    assert found.ashore[1] == 1
    np.testing.assert_allclose(found.stretch_share, [1])
    assert found.stretch_lon[0] == pytest.approx(water.lon[0, 10])
    assert "100 % are stranded, 0 % have left the map" in found.answer[0]


def test_stranded_drifters_are_not_off_the_map():
    wet = np.ones((5, 12), bool)
    wet[:, -1] = False
    currents = sea(np.full((5, 12), 1 / 3.6), np.zeros((5, 12)), wet)
    water, flow = drift.Water.of(currents, 0, "strand"), drift.Flow.of(currents, 0, coast="strand")
    points = np.stack([np.full(50, 8.0), np.full(50, 2.0)])
    found = drift.Released.of(water, flow, points, [72 * HOUR])
    assert (found.ashore[0], found.left[0]) == (1, 0)
    assert found.share[0, 2, 10] == 1


def test_positions_in_degrees_are_inverted_on_a_turned_grid():
    currents = sea(np.zeros((6, 8)), np.zeros((6, 8)), angle=0.3)
    water = drift.Water.of(currents)
    x, y = np.random.default_rng(0).uniform(0.6, 4.4, (2, 50))
    lon, lat = in_degrees(water, np.rint(x), np.rint(y))
    np.testing.assert_allclose(on_the_grid(water, lon, lat)[0].T, [np.rint(x), np.rint(y)])


def test_the_file_has_the_cells_that_hold_nine_tenths(spill, tmp_path):
    *_, found = spill
    record.save_release(found, tmp_path / "release.geojson")
    features = json.loads((tmp_path / "release.geojson").read_text())["features"]
    assert [one["properties"]["hours"] for one in features] == [12, 12, 24, 24]
    shape, about = shapely.geometry.shape(features[-1]["geometry"]), features[-1]["properties"]
    assert shape.area == pytest.approx(found.likely_cells[-1] * SIDE**2, rel=0.01)
    assert about["probability"] >= 0.9 * (1 - found.left[-1])


def test_areas_across_the_date_line_are_cut_there(spill, tmp_path):
    *_, found = spill
    middle = float(np.degrees(np.angle(np.exp(1j * np.radians(found.centre_lon[-1])))))
    for name, turn in (("here", 0.0), ("there", 180 - middle)):
        water = dataclasses.replace(found.water, lon=wrapped(found.water.lon + turn))
        record.save_release(dataclasses.replace(found, water=water), tmp_path / name)
    here, there = (
        [
            shapely.geometry.shape(one["geometry"])
            for one in json.loads((tmp_path / name).read_text())["features"]
        ]
        for name in ("here", "there")
    )
    sides = []
    for one, cut in zip(here, there, strict=True):
        assert cut.is_valid
        assert cut.area == pytest.approx(one.area, rel=1e-3)
        for part in getattr(cut, "geoms", [cut]):
            west, _, east, _ = part.bounds
            assert -180 <= west < east <= 180
            assert east - west < 1
            sides.append(east > 0)
    assert {*sides} == {True, False}


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"until": 900.0}, "until: the records end on "),
        ({"on": "1999-01-01"}, "on: expected a time of the records, "),
        ({"on": "tomorrow"}, "on: expected a date such as 2020-03-01, got tomorrow"),
        ({"at": (3.0,)}, "at: expected times up to 0.5 days, got 3"),
        ({"start": "0,80"}, "start 0,80: place .* is off the grid"),
    ],
)
def test_a_release_beyond_the_records_or_the_grid_is_refused(options, message):
    given = {"start": "-117.93,33.5", "until": 0.5, **options}
    with pytest.raises(ValueError, match=message):
        study.Release(file=(bundled("ocean/gyres.nc"),), **given).run()
