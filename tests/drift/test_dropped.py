"""Cells for drops, beside points drifted, and cells chosen, outside the library."""

import csv
import json

import numpy as np
import pytest
from open_ocean import SIDE, eddies, write_currents
from oracles.points import PointDrifters
from seas import sea, water_and_flow

from jaxcell import bundled, drift, record, study


HOUR, DROPS = 3600.0, 4


@pytest.fixture(scope="module")
def drops(tmp_path_factory):
    """Four drops for a day in a file of eddies that change, to cover its middle."""
    folder = tmp_path_factory.mktemp("drops")
    path, times = folder / "eddies.nc", np.array([1, 0.5, 1.3, 0.8])
    field = eddies(shape=(20, 24), holes=0.0)
    write_currents(path, *(times[:, None, None] * along for along in field))
    points = PointDrifters(path)
    west, south, east, north = (
        points.lon[6] - SIDE / 2, points.lat[5] - SIDE / 2,
        points.lon[17] + SIDE / 2, points.lat[14] + SIDE / 2,
    )  # fmt: skip
    ring = [[west, south], [east, south], [east, north], [west, north], [west, south]]
    shape = {"type": "Polygon", "coordinates": [ring]}
    feature = {"type": "Feature", "properties": {"name": "middle"}, "geometry": shape}
    cover = folder / "middle.geojson"
    cover.write_text(json.dumps({"type": "FeatureCollection", "features": [feature]}))
    given = {"cover": cover, "on": "2020-01-01T06:00/2020-01-02T06:00", "avoid": ("edge",)}
    found = study.Deploy(file=(path,), drop=DROPS, **given).run()
    inside = np.zeros((20, 24), bool)
    inside[5:15, 6:18] = True
    return points, inside.ravel(), found


def visits_of_points(points, lon, lat):
    """The cells that points visit from 6 h to 30 h after the first record, and those that leave."""
    rows, columns = points.known.shape
    seen = np.zeros((lon.size, rows * columns), bool)
    gone = np.zeros(lon.size, bool)
    for look in range(24 * 12 + 1):
        x, y = (np.floor(place + 0.5).astype(int) for place in points.places(lon, lat))
        at = np.flatnonzero(~gone)
        seen[at, y[at] * columns + x[at]] = True
        lon, lat, left = points.drift(lon, lat, 300.0, 300.0, 6 * HOUR + 300.0 * look)
        gone |= left
    return seen, gone


def test_the_choice_is_that_of_points_drifted_outside_the_library(drops):
    points, inside, found = drops
    grid_lon, grid_lat = (axis.ravel() for axis in np.meshgrid(points.lon, points.lat))
    off = SIDE * np.array([(k, m) for k in (-1, 0, 1) for m in (-1, 0, 1)]) / 3
    lon, lat = (grid_lon[:, None] + off[:, 0]).ravel(), (grid_lat[:, None] + off[:, 1]).ravel()
    seen, gone = visits_of_points(points, lon, lat)
    share = seen.reshape(grid_lon.size, 9, -1).mean(axis=1)[:, inside]
    allowed = ~gone.reshape(-1, 9).any(axis=1)
    assert (found.allowed_cells != allowed).sum() <= 2
    missing, gained = np.ones(inside.sum()), []
    for _ in range(DROPS):
        gain = np.where(allowed, share @ missing, 0)
        gained.append(gain.max())
        missing *= 1 - share[gain.argmax()]
    assert found.gained[0] == pytest.approx(gained[0], rel=0.03)
    assert found.chosen_by == pytest.approx(sum(gained), rel=0.03)
    its_own = (1 - np.prod(1 - share[found.cell], axis=0)).sum()
    assert its_own == pytest.approx(found.chosen_by, rel=0.03)
    assert sum(gained) <= found.bound * 1.01
    assert found.asked == inside.sum()
    # Other points, anywhere in the cells that were chosen.
    off = np.random.default_rng(8).uniform(-0.5, 0.5, (2, DROPS, 200)) * SIDE
    lon, lat = grid_lon[found.cell, None] + off[0], grid_lat[found.cell, None] + off[1]
    seen, gone = visits_of_points(points, lon.ravel(), lat.ravel())
    share = seen.reshape(DROPS, 200, -1).mean(axis=1)[:, inside]
    assert found.visited == pytest.approx((1 - np.prod(1 - share, axis=0)).sum(), rel=0.05)
    np.testing.assert_allclose(found.left, gone.reshape(DROPS, -1).mean(axis=1), atol=0.08)
    assert found.stranded.tolist() == [0] * DROPS
    end = points.drift(grid_lon[found.cell], grid_lat[found.cell], 24 * HOUR, 300.0, 6 * HOUR)
    np.testing.assert_allclose(found.end_lon, end[0], atol=0.05 * SIDE)
    np.testing.assert_allclose(found.end_lat, end[1], atol=0.05 * SIDE)


def test_the_files_have_the_drops(drops, tmp_path):
    *_, found = drops
    record.save_deployment(found, tmp_path / "drops.csv")
    with (tmp_path / "drops.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [int(row["cell"]) for row in rows] == found.cell.tolist()
    np.testing.assert_allclose([float(row["end_lon"]) for row in rows], found.end_lon, atol=1e-6)
    record.save_sea(found, tmp_path / "drops.png")
    assert (tmp_path / "drops.png").read_bytes()[1:4] == b"PNG"


def test_drifters_that_strand_are_avoided():
    """A stream to a coast in the East: only what begins far from it is afloat after 6 h."""
    wet = np.ones((5, 12), bool)
    wet[:, -1] = False
    currents = sea(np.full((5, 12), 1 / 3.6), np.zeros((5, 12)), wet)
    water, flow = drift.Water.of(currents, 0, "strand"), drift.Flow.of(currents, 0, coast="strand")
    every = np.ones(water.cells, bool)
    near = drift.Dropped.of(water, flow, every, 1, 6 * HOUR)
    assert near.allowed == water.cells
    found = drift.Dropped.of(water, flow, every, 1, 48 * HOUR, avoid=("edge",))
    with pytest.raises(ValueError, match="avoid: drifters from every cell are lost"):
        drift.Dropped.of(water, flow, every, 1, 48 * HOUR, avoid=("land",))
    assert found.stranded.tolist() == [1]
    assert "1 strand, none leave the map" in found.answer[0]
    with pytest.raises(ValueError, match="cover: no drifter from a place"):
        drift.Dropped.of(water, flow, ~every, 1, HOUR)


def test_a_drifter_that_moves_by_a_cell_an_hour_visits_a_cell_an_hour():
    water, flow = water_and_flow(sea(np.full((3, 12), 1 / 3.6), np.zeros((3, 12))))
    found = drift.Dropped.of(water, flow, water.row == 1, 1, 5 * HOUR)
    assert found.chosen_by == pytest.approx(6)


def test_the_bound_is_at_most_the_cells_and_one_drop_is_said_in_the_singular():
    water, flow = water_and_flow(sea(np.full((3, 12), 1 / 3.6), np.zeros((3, 12))))
    found = drift.Dropped.of(water, flow, water.column < 2, 6, 5 * HOUR)
    assert found.bound == found.asked == 6
    one = drift.Dropped.of(water, flow, water.row == 1, 1, 5 * HOUR)
    assert one.answer[0].startswith("Dropped, 1 drifter visits 6 of the 12 cells")
    assert "it is 6, and for no cell more than 6: at least 100 % of the most" in one.answer[1]


def test_too_many_drops_are_refused_before_drifters_are_followed(monkeypatch):
    gyres = (bundled("ocean/gyres.nc"),)
    with pytest.raises(ValueError, match="drop: expected at most 538, the number of cells"):
        study.Deploy(file=gyres, drop=1000, depth=0.0, until=0.5).run()
    monkeypatch.setattr("jaxcell.base.memory.NEGLIGIBLE", 0)
    monkeypatch.setattr("jaxcell.base.memory.free", lambda: 10**6)
    with pytest.raises(MemoryError, match=r"drifters from 538 cells for 0\.9 days"):
        study.Deploy(file=gyres, drop=500, depth=0.0, until=0.9).run()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, "until: expected days, or a month or a period as `on`, got nothing"),
        ({"on": "2011-07", "until": 1.0}, "until: expected days, or .* got 1 and `on` 2011-07"),
        ({"on": "2011-07-02/2011-07-01"}, "on: expected a period that ends after it begins"),
        ({"on": "2011-08"}, "on: expected a time of the records"),
        ({"on": "2011-07"}, "until: the records end on .* expected at most that, got 31"),
        ({"until": 0.5, "avoid": ("land",), "coast": "hold"}, "avoid: expected land only with"),
    ],
)
def test_a_window_beyond_the_records_is_refused(options, message):
    with pytest.raises(ValueError, match=message):
        study.Deploy(file=(bundled("ocean/gyres.nc"),), drop=1, **options).run()
