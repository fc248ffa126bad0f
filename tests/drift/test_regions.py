"""Regions of a sea, and how drifters go between them."""

import json
import warnings

import jax
import numpy as np
import pytest
import scipy.stats
import shapely
from seas import sea

from jaxcell import drift
from jaxcell.base.doubts import Doubt
from jaxcell.mapping import Chain, ChainSequence


def write(path, polygons):
    features = [
        {"type": "Feature", "properties": {"name": name}, "geometry": shapely.geometry.mapping(one)}
        for name, one in polygons.items()
    ]
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    return path


@pytest.fixture
def currents():
    east = np.full((9, 12), 0.3)
    north = 0.2 * np.sin(np.arange(12) / 2) * np.ones((9, 1))
    return sea(east, north)


def halves(water, turn=0.0):
    west, south = water.lon.min() - 0.005 + turn, water.lat.min() - 0.0045
    middle = west + 5 * 0.0107
    north = south + 9 * 0.009
    return {
        "west": shapely.box(west, south, middle, north),
        "east": shapely.box(middle, south, middle + 4 * 0.0107, north),
    }


@pytest.mark.parametrize("turn", [0.0, 360.0])
def test_cells_are_in_the_polygon_of_their_centre(tmp_path, currents, turn):
    water = drift.Water.of(currents)
    path = write(tmp_path / "regions.geojson", halves(water, turn))
    names, inside = drift.read_regions(path, water)
    assert names.tolist() == ["west", "east"]
    np.testing.assert_array_equal(inside[0], water.column < 5)
    np.testing.assert_array_equal(inside[1], (water.column >= 5) & (water.column < 9))


def test_residence_times_are_those_of_dense_solves():
    random = np.random.default_rng(5)
    matrices = [random.dirichlet(np.ones(7), 7) * 0.95 for _ in range(2)]
    tide = ChainSequence.of([Chain.from_scipy(one) for one in matrices])
    inside = np.zeros((2, 7), bool)
    inside[0, :3] = inside[1, 2:6] = True
    exchange = drift.Exchange(np.array(["a", "b"]), inside, tide, 2.0, 3)
    for here, hours in zip(inside, exchange.residence_hours, strict=True):
        first, second = (one[here][:, here] for one in matrices)
        ones = np.ones(here.sum())
        # A step at each phase, and then again.
        steps = np.linalg.solve(np.eye(here.sum()) - first @ second, ones + first @ ones)
        assert hours == pytest.approx(2 * steps.mean())
    after = matrices[0] @ matrices[1] @ matrices[0]
    expected = [[after[a][:, b].sum() / a.sum() for b in inside] for a in inside]
    np.testing.assert_allclose(exchange.share, expected)


def test_a_region_that_is_never_left_has_infinite_residence():
    matrix = np.array([[1.0, 0, 0, 0], [0.5, 0, 0.5, 0], [0, 0, 0, 1], [0, 0, 0, 0]])
    inside = np.array([[True, True, False, False], [False, False, True, True]])
    exchange = drift.Exchange(np.array(["a", "b"]), inside, Chain.from_scipy(matrix), 1.0, 1)
    assert exchange.residence_hours.tolist() == [np.inf, 1.5]
    assert exchange.left.tolist() == [0.0, 0.5]


def test_invalid_regions_are_refused(tmp_path, currents):
    water, path = drift.Water.of(currents), tmp_path / "regions.geojson"
    far, line = shapely.box(0, 0, 1, 1), shapely.LineString([[0, 0], [1, 1]])
    for polygons, wrong in (
        ({"far": far}, "'far': no centre of a water cell"),
        ({"way": line}, "'way': expected a polygon, got LineString"),
        ({}, "features: expected one or more, got none"),
    ):
        write(path, polygons)
        with warnings.catch_warnings(action="ignore"), pytest.raises(ValueError, match=wrong):
            drift.read_regions(path, water)
    given = {"far": far, "way": line, **halves(water)}
    with pytest.warns(Doubt) as said:
        names, _ = drift.read_regions(write(path, given), water)
    assert names.tolist() == ["west", "east"]
    assert ["'way'" in str(said[0].message), "'far'" in str(said[1].message)] == [True, True]
    for text in ('{"type": "Feature"}', '{"features": ' + "[" * 50_000):
        path.write_text(text)
        with pytest.raises(ValueError, match="expected a GeoJSON FeatureCollection"):
            drift.read_regions(path, water)


def test_intervals_of_simulated_drifters_are_those_of_scipy(currents):
    water, flow = drift.Water.of(currents), drift.Flow.of(currents)
    chain = drift.drift_map(water, flow, drift.METHODS["drifters"].lasting(3600.0))
    inside = np.stack([water.column < 5, (water.column >= 5) & (water.column < 9)])
    exchange = drift.Exchange(np.array(["west", "east"]), inside, chain, 1.0, 4)
    assert exchange.share_of_drifters is exchange.low is exchange.high is None
    found = exchange.with_drifters(water, flow, 500)
    for row, (seen, low, high) in enumerate(zip(found.arrived, found.low, found.high, strict=True)):
        for column, count in enumerate(seen.tolist()):
            interval = scipy.stats.binomtest(count, 500).proportion_ci(0.95, "exact")
            np.testing.assert_allclose([low[column], high[column]], interval, atol=1e-9)
            assert found.share_of_drifters[row, column] == count / 500
    for region, low, high in zip(inside, found.low, found.high, strict=True):
        moved = drift.simulate_drifters(
            jax.random.key(0), water, flow, region, 3600.0, 4, drifters=100_000
        )
        expected = moved.share(water.cells)[-1] @ inside.T
        assert ((low - 0.005 < expected) & (expected < high + 0.005)).all()
