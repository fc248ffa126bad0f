"""Sea without data inside the water, through which drifters leave the map."""

import jax
import numpy as np
import pytest
from open_ocean import SIDE, eddies, write_currents
from oracles.points import PointDrifters

from jaxcell import drift


def test_drifters_go_where_they_go_outside_the_library(tmp_path):
    path, records = tmp_path / "eddies.nc", np.array([1.0, 0.4, -0.5])[:, None, None]
    write_currents(path, *(records * field for field in eddies(holes=0.0)))
    by_points = PointDrifters(path)
    currents = drift.open_currents(path)
    water, flow = drift.Water.of(currents), drift.Flow.of(currents)
    cell = int(water.number[16, 20])
    moved = drift.simulate_drifters(
        jax.random.key(0), water, flow, cell, 20 * 3600.0, 1, drifters=200, substeps=40
    )
    x, y = np.asarray(moved.x), np.asarray(moved.y)
    lon, lat = by_points.lon[0] + SIDE * x, by_points.lat[0] + SIDE * y
    *there, left = by_points.drift(lon[0], lat[0], 20 * 3600, 120.0)
    assert not left.any()
    assert np.hypot(*(place[1] - place[0] for place in (x, y))).mean() > 3
    np.testing.assert_allclose(lon[1], there[0], atol=0.02 * SIDE)
    np.testing.assert_allclose(lat[1], there[1], atol=0.02 * SIDE)


@pytest.mark.parametrize("hours", [6.0, 24.0])
def test_as_many_drifters_leave_through_holes_as_by_steps_of_a_hundredth_of_a_cell(tmp_path, hours):
    path = tmp_path / "holes.nc"
    write_currents(path, *eddies())
    by_points = PointDrifters(path)
    places = (np.arange(6) + 0.5) / 6 - 0.5
    row, column = np.nonzero(by_points.known)
    up, right = (off.ravel() for off in np.meshgrid(places, places, indexing="ij"))
    lon = by_points.lon[column][:, None] + SIDE * right
    lat = by_points.lat[row][:, None] + SIDE * up
    _, _, left = by_points.drift(lon, lat, hours * 3600, 120.0)
    currents = drift.open_currents(path)
    water, flow = drift.Water.of(currents), drift.Flow.of(currents)
    replay = drift.Replay.of(water, flow, [hours])
    assert left.mean() > 0.15
    assert 1 - replay.share(hours, water.cells).sum() == pytest.approx(left.mean(), abs=0.01)


def test_holes_in_the_water_are_said_and_can_be_filled(tmp_path):
    path, field = tmp_path / "holes.nc", eddies(holes=0.0)
    field[:, 5:7, 6:8] = field[:, 20, 20:22] = field[:, 10, 0] = np.nan
    field[:, 25:29, 10:14] = np.nan
    write_currents(path, *field)
    hidden, known = eddies(holes=0.0), np.isfinite(field[0])
    opened = drift.open_currents(path)
    found = drift.SeaDrift.of(opened, drift.METHODS["drifters"].lasting(7200.0), until=24.0)
    (remark,) = (remark for remark in found.remarks if "inside the water" in remark)
    assert "through 22 squares without data inside the water, in 3 holes" in remark
    assert "--gaps fill fills 6 of them, and --gaps land takes all for land" in remark
    filled = drift.open_currents(path, gaps="fill")
    squares = filled.water.values[0] & ~known
    assert set(zip(*np.nonzero(squares), strict=True)) == {
        *((row, column) for row in (5, 6) for column in (6, 7)),
        *((20, 20), (20, 21)),
    }
    scale = np.hypot(*hidden).mean()
    for name, truth in zip("uv", hidden, strict=True):
        values = filled[name].values[0, 0]
        np.testing.assert_array_equal(values[known], truth[known])
        np.testing.assert_allclose(values[squares], truth[squares], atol=0.5 * scale)
    assert "6 squares without data, in holes of up to 9 squares, are filled" in filled.notes


@pytest.mark.parametrize(("side", "said"), [(0.0015, True), (SIDE, False)])
def test_a_grid_finer_than_the_coastline_is_said(tmp_path, side, said):
    path, field = tmp_path / "fine.nc", eddies(mean=0.02, holes=0.01)
    write_currents(path, *field, side=side)
    opened = drift.open_currents(path)
    found = drift.SeaDrift.of(opened, drift.METHODS["drifters"].lasting(7200.0), until=24.0)
    fine = [remark for remark in found.remarks if "finer than the bundled coastline" in remark]
    assert len(fine) == said
    assert all("--land, or --gaps land" in remark for remark in fine)
