"""The distance of a map from drifters that are released in one cell."""

import numpy as np
import pytest
from open_ocean import SIDE, eddies, write_currents
from oracles.points import PointDrifters

from jaxcell import drift


@pytest.fixture(scope="module")
def closed_eddies(tmp_path_factory):
    """A file of eddies without holes."""
    path = tmp_path_factory.mktemp("release") / "eddies.nc"
    write_currents(path, *eddies(shape=(24, 30), holes=0.0))
    return path


def test_distance_of_one_release_is_that_of_points_that_were_drifted_outside_the_library(
    closed_eddies,
):
    hours, count = 24.0, 20_000
    by_points = PointDrifters(closed_eddies)
    rows, columns = by_points.known.shape
    row, column = 12, 14
    random = np.random.default_rng(0)
    off = random.uniform(-0.5, 0.5, (2, count)) * SIDE
    lon, lat = by_points.lon[column] + off[0], by_points.lat[row] + off[1]
    lon, lat, left = by_points.drift(lon, lat, hours * 3600, 300.0)
    x, y = (np.floor(place + 0.5).astype(int) for place in by_points.places(lon, lat))
    seen = np.bincount((y * columns + x)[~left], minlength=rows * columns) / count

    currents = drift.open_currents(closed_eddies)
    water, flow = drift.Water.of(currents), drift.Flow.of(currents)
    seconds = 2 * 3600.0
    chain = drift.drift_maps(water, flow, drift.METHODS["drifters"].lasting(seconds))
    begin = np.zeros(rows * columns)
    begin[row * columns + column] = 1
    by_map = begin @ np.linalg.matrix_power(chain.to_scipy().toarray(), 12)
    expected = (np.abs(by_map - seen).sum() + abs(by_map.sum() - seen.sum())) / 2

    cell = np.array([row * columns + column])
    found = drift.release_distance(water, flow, chain, seconds, cell, [hours])
    assert found.total_variation[0, 0] == pytest.approx(expected, abs=0.03)
    everywhere = drift.distances(water, flow, [(chain, seconds)], hours=[hours])[0]
    assert found.total_variation[0, 0] > 3 * everywhere.total_variation[0]


def test_a_result_has_the_distance_of_its_start_beside_that_of_a_release_everywhere(closed_eddies):
    currents = drift.open_currents(closed_eddies)
    step = drift.METHODS["drifters"].lasting(7200.0)
    found = drift.SeaDrift.of(currents, step, start=374, until=24.0)
    surface = found.layers[0]
    one = drift.release_distance(
        surface.water, surface.flow, surface.behaviour.chain, 7200.0, np.array([374]), [24.0]
    )
    assert found.release_distance == pytest.approx(one.total_variation[0, 0], abs=0.01)
    sure = next(line for line in found.answer if line.startswith("How sure"))
    assert "released at the start, " in sure
    assert f"{found.release_distance:.0%} after 24 h (by chance" in sure
    assert f"released everywhere, {found.distance_by_time[0]:.0%}" in sure
    typical = drift.SeaDrift.of(currents, step, until=24.0)
    assert any("released in one of 9 cells, median, " in line for line in typical.answer)
