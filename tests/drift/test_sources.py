"""Tests of the sources of drifters that are found at a place, and of repeated releases."""

import json

import numpy as np
import pytest
import shapely
from open_ocean import SIDE, eddies, write_currents
from oracles.points import RADIUS, PointDrifters

from jaxcell import bundled, study
from jaxcell.drift import sources


HOUR = 3600.0
METRES = np.radians(1) * RADIUS


@pytest.fixture(scope="module")
def ocean(tmp_path_factory):
    """A file of eddies that change, as drifted outside the library, and a place in the middle."""
    path, times = tmp_path_factory.mktemp("sources") / "eddies.nc", np.array([1, 0.5, 1.3, 0.8, 1])
    write_currents(path, *(times[:, None, None] * a for a in eddies(shape=(24, 30), holes=0.0)))
    points = PointDrifters(path)
    return path, points, points.lon[14], points.lat[12]


def _shares(points, lon, lat):
    x, y = (np.floor(place + 0.5).astype(int) for place in points.places(lon, lat))
    share = np.zeros((24, 30))
    np.add.at(share, (y, x), 1 / lon.size)
    return share


def test_sources_are_those_of_points_that_are_drifted_forward_from_everywhere(ocean):
    path, points, east, north = ocean
    given = {"start": f"{east},{north}", "on": "2020-01-02T06:00", "radius": 3000.0}
    given |= {"until": 1.0, "at": (0.5,), "precision": 0.03, "backward": True}
    found = study.Release(file=(path,), **given).run()
    assert found.date.tolist() == ["2020-01-01T18:00", "2020-01-01T06:00"]

    random, count = np.random.default_rng(1), 50_000
    lon = random.uniform(points.lon[0] - SIDE / 2, points.lon[-1] + SIDE / 2, count)
    south, top = np.sin(np.radians([points.lat[0] - SIDE / 2, points.lat[-1] + SIDE / 2]))
    lat = np.degrees(np.arcsin(random.uniform(south, top, count)))
    half = points.drift(lon, lat, 12 * HOUR, 1800.0, 6 * HOUR)
    end = points.drift(*half[:2], 12 * HOUR, 1800.0, 18 * HOUR)
    right, up = (end[0] - east) * np.cos(np.radians(north)), end[1] - north
    here = (np.hypot(right, up) * METRES <= 3000) & ~half[2] & ~end[2]
    assert here.sum() > 400
    error = 4 / np.sqrt(here.sum())
    for row, (x, y) in enumerate((half[:2], (lon, lat))):
        spread = found.spread[row] * 1000 / METRES
        assert found.centre_lon[row] == pytest.approx(x[here].mean(), abs=error * spread * 1.2)
        assert found.centre_lat[row] == pytest.approx(y[here].mean(), abs=error * spread)
        apart = np.abs(_shares(points, x[here], y[here]) - found.share[row]).sum() / 2
        assert apart < 0.15 < 0.5 * np.abs(found.share[row] - found.share[1 - row]).sum()


def test_water_of_a_convergence_comes_from_a_larger_area(tmp_path):
    """In a stream whose speed falls along it, what is found in an hour came from farther apart."""
    rate, hours = -1e-5, 6.0
    columns = np.arange(40)
    metres = SIDE * METRES * np.cos(np.radians(-30))
    east = np.tile(0.5 + rate * metres * columns, (9, 1))
    path = tmp_path / "stream.nc"
    write_currents(path, east, np.zeros((9, 40)))
    points = PointDrifters(path)
    west, edge = np.interp([19.2, 19.3], columns, points.lon)
    gate = shapely.geometry.mapping(shapely.box(west, -31, edge, -29))
    regions = tmp_path / "gate.geojson"
    feature = {"type": "Feature", "properties": {"name": "gate"}, "geometry": gate}
    regions.write_text(json.dumps({"type": "FeatureCollection", "features": [feature]}))
    given = {"start": f"{points.lon[20]},{points.lat[4]}", "on": "2020-01-01T06:00"}
    given |= {"regions": regions}
    found = study.Release(
        file=(path,), **given, until=hours / 24, precision=0.03, backward=True
    ).run()
    stretch = np.exp(-rate * hours * HOUR)
    wide = found.drifters.x[-1]
    assert wide.std() * np.sqrt(12) == pytest.approx(stretch, rel=0.03)
    # Water passed the gate when it was as much faster as the stretch since then.
    there, here = (0.5 + rate * metres * column for column in (19.3, 20))
    assert found.arrival[0] == 1
    assert found.arrival_median[0] == pytest.approx(np.log(there / here) / -rate / HOUR, rel=0.03)


def test_repeated_releases_are_the_mean_of_single_ones(ocean):
    path, _, east, north = ocean
    given = {"file": (path,), "start": f"{east},{north}", "until": 0.25, "precision": 0.05}
    every = study.Release(on="2020-01-01/2020-01-02T00:00", every=0.5, **given).run()
    single = [study.Release(on=on, **given).run() for on in ("2020-01-01", "2020-01-01T12:00")]
    assert every.start_date.tolist() == ["2020-01-01T00:00", "2020-01-01T12:00"]
    assert every.date is None
    for name, within in (("by_chain", 1e-12), ("_shares", 0.1)):
        mean = np.mean([getattr(one, name) for one in single], axis=0)
        np.testing.assert_allclose(getattr(every, name), mean, atol=within)
    assert every.answer[0].startswith(
        "Released on 2020-01-01 00:00 and 1 time more, the last 12 h later, in the 1.93 x"
    )


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"every": 0.1, "until": 0.1}, "every: expected a month or a period"),
        ({"backward": True, "until": 0.1}, "on: expected the time of the find, got None"),
        ({"backward": True, "until": 0.1, "on": "2011-07-01", "every": 1.0}, "every"),
        (
            {"backward": True, "until": 0.1, "on": "2011-07-01T06:00", "coast": "strand"},
            "coast: expected hold or slip",
        ),
        (
            {"backward": True, "until": 1.0, "on": "2011-07-01T06:00"},
            "on: expected a time of the records",
        ),
    ],
)
def test_a_question_without_its_times_is_refused(options, message):
    with pytest.raises(ValueError, match=message):
        study.Release(file=(bundled("ocean/gyres.nc"),), start="-117.93,33.5", **options).run()


def test_a_place_that_the_water_leaves_has_no_source(monkeypatch):
    monkeypatch.setattr(sources, "BATCH", 100)
    given = {"start": "-117.93,33.5", "on": "2011-07-01T18:00", "until": 0.5, "backward": True}
    with pytest.raises(ValueError, match="start: no"):
        study.Release(file=(bundled("ocean/gyres.nc"),), **given).run()
