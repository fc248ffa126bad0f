"""Land, sea without data, and the edge of the grid, and the rules for drifters there."""

import json
from pathlib import Path

import jax
import numpy as np
import pytest
import shapely
from drift import products
from hypothesis import given, settings, strategies as st
from seas import land_of_the_channel, sea, water_and_flow

from jaxcell import drift
from jaxcell.base.formatting import format_value
from jaxcell.base.quantities import quantities
from jaxcell.currents.land import read_land
from jaxcell.drift import open_currents
from jaxcell.drift.maps import EDGES, EXITS


# Where two hours of HF radar in the Santa Barbara Channel have a velocity, on one grid of 2 km.
COVERAGE = np.load(Path(__file__).parent / "coverage.npz")
LON, LAT = COVERAGE["lon"].astype(float), COVERAGE["lat"].astype(float)
HOURS = np.unpackbits(COVERAGE["seen"])[: 2 * LON.size * LAT.size]
SEEN = HOURS.reshape(2, LAT.size, LON.size).astype(bool)


def currents_where(seen, lon=LON, lat=LAT, east=0.1, **more):
    """Open currents to the East on longitudes and latitudes, without data elsewhere."""
    u, v = np.where(seen, east, np.nan), np.where(seen, 0.0, np.nan)
    count = 1 if u.ndim == 2 else len(u)
    file = products.regular(values=(u, v), lon=lon, lat=lat, time=products.hours(count=count))
    return open_currents(file.assign(more.pop("variables", {})), **more)


def gaps(currents, layer=0):
    return ~(currents.water | currents.land).values[layer]


@pytest.mark.parametrize("hour", [0, 1])
def test_gaps_of_a_radar_are_sea_where_another_hour_proves_it(hour):
    currents = currents_where(SEEN[hour])
    proven = ~SEEN[hour] & SEEN[1 - hour]
    # Squares of 2 km at the beach hold some land, and radars see parts of them.
    assert (proven & currents.land.values[0]).sum() <= 0.04 * proven.sum()
    assert gaps(currents).sum() > 1400
    assert f"{gaps(currents).sum()} are sea without data" in currents.attrs["notes"]
    assert "Natural Earth" in currents.attrs["notes"]
    assert not (currents.land & currents.water).any()


def test_squares_that_hold_land_are_land():
    currents = currents_where(SEEN[0])
    land = land_of_the_channel()
    dx, dy = np.diff(LON).mean() / 2, np.diff(LAT).mean() / 2
    for row, column in np.argwhere(~SEEN[0])[::17]:
        x, y = LON[column], LAT[row]
        holds = land.intersects(shapely.box(x - dx, y - dy, x + dx, y + dy))
        assert currents.land.values[0, row, column] == holds


@pytest.mark.parametrize("axis", ["row", "column"])
def test_land_of_one_row_or_column_is_that_of_the_whole_grid(axis):
    bounds, part = (-130, LAT[30] - 1e-3, -110, LAT[30] + 1e-3), (slice(30, 31), slice(None))
    if axis == "column":
        bounds, part = (LON[40] - 1e-3, 30, LON[40] + 1e-3, 40), (slice(None), slice(40, 41))
    whole = currents_where(SEEN[0])
    land = currents_where(SEEN[0], bounds=bounds).land.values[0]
    np.testing.assert_array_equal(land, whole.land.values[0][part])
    assert land.any()
    assert gaps(whole)[part].any()


@pytest.mark.parametrize("suffix", ["geojson", "shp"])
def test_a_better_coastline_replaces_that_of_natural_earth(tmp_path, suffix):
    path, west = tmp_path / f"land.{suffix}", shapely.box(-121, 33, -120, 35)
    if suffix == "shp":
        shapefile = pytest.importorskip("shapefile")
        with shapefile.Writer(path, shapeType=shapefile.POLYGON) as writer:
            writer.field("name")
            writer.poly([np.array(west.exterior.coords).tolist()])
            writer.record("west")
    else:
        feature = {"type": "Feature", "properties": {}, "geometry": shapely.geometry.mapping(west)}
        path.write_text(json.dumps({"type": "FeatureCollection", "features": [feature]}))
    currents = currents_where(SEEN[0], land=path)
    near = np.abs(LON + 120) > 0.02
    expected = ~SEEN[0] & (LON < -120)
    np.testing.assert_array_equal(currents.land.values[0][:, near], expected[:, near])
    assert currents.attrs["coastline"] == str(path)
    assert path.name in currents.attrs["notes"]


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("land.geojson", "{", "cannot be read as GeoJSON or a shapefile"),
        ("land.geojson", '{"type": "Point", "coordinates": [0, 0]}', "expected polygons of land"),
        ("land.shp", "x", "cannot be read as GeoJSON or a shapefile"),
        ("land.geojson", shapely.to_geojson(shapely.box(3e5, 3e6, 4e5, 4e6)),
         "longitudes and latitudes in degrees"),
    ],
)  # fmt: skip
def test_a_file_without_land_is_refused(tmp_path, name, text, message):
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(ValueError, match=message):
        currents_where(SEEN[0], land=path)


PACIFIC = {"lon": -140.0 + 0.1 * np.arange(6), "lat": 30.0 + 0.1 * np.arange(5)}
HOLE = np.ones((5, 6), bool)
HOLE[2, 2:4] = False


def test_a_hole_in_the_open_sea_is_land_only_if_a_file_or_the_caller_says_so():
    here = {"seen": HOLE, **PACIFIC}
    np.testing.assert_array_equal(gaps(currents_where(**here)), ~HOLE)
    assert not gaps(currents_where(**here, gaps="land")).any()
    dims = ("latitude", "longitude")
    mask = {"m": (dims, HOLE.astype("i1"), {"standard_name": "sea_binary_mask"})}
    assert not gaps(currents_where(**here, variables=mask)).any()
    wet = {"m": (dims, np.ones_like(HOLE, "i1"), {"standard_name": "sea_binary_mask"})}
    np.testing.assert_array_equal(gaps(currents_where(**here, variables=wet)), ~HOLE)
    bed = {"h": (dims, np.where(HOLE, 50.0, 0.0), {"standard_name": "sea_floor_depth"})}
    assert not gaps(currents_where(**here, variables=bed)).any()


def test_a_square_with_a_velocity_at_some_record_is_sea():
    # Around Santa Cruz Island, and in a square that holds land.
    seen = np.stack([SEEN[0], SEEN[0], SEEN[0]])
    row, column = np.argwhere(currents_where(SEEN[0]).land.values[0])[0]
    seen[1, row, column] = True
    currents = currents_where(seen)
    assert gaps(currents)[row, column]
    assert not currents.water.values[0, row, column]


def test_below_a_square_with_a_velocity_is_the_sea_bed():
    shape = (1, 2, 5, 6)
    seen = np.stack([np.ones((5, 6), bool), HOLE])[None]
    u = np.where(seen, 0.1, np.nan) * np.ones(shape)
    file = products.regular(
        values=(u, u), depth=[0.0, 10.0], time=products.hours(count=1), **PACIFIC,
        dims=("time", "latitude", "longitude"),
    )  # fmt: skip
    for depths in (None, 10):
        currents = open_currents(file, depths=depths)
        np.testing.assert_array_equal(currents.land.values[-1], ~HOLE)


def test_coasts_are_cut_to_a_box_across_the_antimeridian():
    lines = [*read_land().coasts(176.0, -20.0, 184.0, -15.0)]  # Fiji
    points = np.concatenate(lines)
    assert 176 <= points[:, 0].min() < 178 < points[:, 0].max() <= 184
    assert not (np.abs(points[:, 0] - 180) < 1e-6).all()
    assert all(len(line) > 1 for line in lines)
    # No line goes along the cut of the polygons.
    along = [np.abs(line[:, 0] - 180) < 1e-3 for line in lines]
    assert not any((cut[1:] & cut[:-1]).any() for cut in along)


def strait(gap=True, coast="hold", diffusivity=0.0):
    """A sea whose water goes to the East, into a gap in the upper rows, and off the grid."""
    wet = np.ones((4, 6), bool)
    wet[2:, 4] = wet[0, 3] = False
    land = ~wet
    land[2:, 4] = not gap
    currents = sea(np.full(wet.shape, 0.3), np.zeros(wet.shape), wet)
    currents["land"] = ("layer", "y", "x"), land[None]
    flow = drift.Flow.of(currents, coast=coast, diffusivity=diffusivity)
    return drift.Water.of(currents, coast=coast), flow


@pytest.mark.parametrize("coast", ["hold", "slip", "strand"])
@pytest.mark.parametrize("spread", ["sampled", "turned", "all"])
@pytest.mark.parametrize("diffusivity", [0.0, 20.0])
def test_the_ways_out_sum_to_what_leaves(coast, spread, diffusivity):
    if diffusivity and spread != "sampled":
        return
    water, flow = strait(coast=coast, diffusivity=diffusivity)
    step = drift.DriftStep(3000, spread=spread, edge="exit", method="rk4")
    chain = drift.drift_maps(water, flow, step)
    shares = drift.exit_shares(water, flow, step, chain)
    np.testing.assert_allclose(shares.sum(axis=0), np.asarray(chain.leaving), atol=1e-12)
    assert (shares >= 0).all()
    assert shares[0].any()
    assert shares[1].any() == (coast == "strand")
    assert shares[2:].any()


def test_the_ways_out_are_those_of_points_that_are_followed_one_by_one():
    water, flow = strait(coast="strand")
    step = drift.DriftStep(2500, spread="sampled", edge="exit", method="rk4", samples=3)
    shares = drift.exit_shares(water, flow, step, drift.drift_maps(water, flow, step))
    counts = np.zeros_like(shares)
    offsets = np.array([-1, 0, 1]) / 3
    for cell in range(water.cells):
        for right in offsets:
            for up in offsets:
                x, y = drift.advect(
                    flow, water.column[cell] + right, water.row[cell] + up, 2500.0, method="rk4"
                )
                column, row = int(np.floor(x + 0.5)), int(np.floor(y + 0.5))
                if not (0 <= column < 6 and 0 <= row < 4):
                    side = [column > 5, row > 3, column < 0, row < 0].index(True)
                    counts[2 + side, cell] += 1
                elif water.number[row, column] < 0:
                    counts[1 if water.land[row, column] else 0, cell] += 1
    np.testing.assert_allclose(shares, counts / 9, atol=1e-12)


@pytest.mark.parametrize("coast", ["hold", "strand"])
def test_the_probabilities_of_the_ways_out_solve_the_equations_of_the_chain(coast):
    water, flow = strait(coast=coast, diffusivity=20.0)
    step = drift.METHODS["drifters"].lasting(3000)
    layer = drift.Layer.of(water, flow, step)
    matrix, out = layer.behaviour.chain.to_scipy().toarray(), layer.exits
    inside = layer.transient
    solved = np.linalg.solve(
        (np.eye(water.cells) - matrix)[np.ix_(inside, inside)], out[:, inside].T
    )
    np.testing.assert_allclose(layer.leaving_by_way[:, inside].T, solved, atol=1e-8)
    np.testing.assert_allclose(layer.leaving_by_way.sum(axis=0), layer.leaving)
    ways = layer.mean_leaving_into_gaps, layer.mean_leaving_off_edge, layer.mean_stranding
    assert sum(way or 0 for way in ways) == pytest.approx(layer.mean_leaving)
    assert (layer.mean_stranding is None) == (coast == "hold")


def test_the_probability_of_leaving_is_known_if_the_table_of_all_groups_is_too_large(monkeypatch):
    monkeypatch.setattr("jaxcell.drift.results.layer_ends.LARGEST_TABLE", 1)
    water, flow = strait()
    still = np.asarray(flow.rate).copy()
    still[:, :, :, :2] = 0  # groups in the West
    flow = drift.Flow(jax.device_put(still), flow.time)
    layer = drift.Layer.of(water, flow, drift.METHODS["drifters"].lasting(3000))
    assert layer.persistent_groups > 0
    assert layer.ends is None
    assert 0 < layer.mean_leaving < 1
    monkeypatch.setattr("jaxcell.drift.results.layer_ends.LARGE", 1)
    monkeypatch.setattr("jaxcell.drift.results.layer_ends.LARGEST_SOLVE", 1)
    large = drift.Layer.of(water, flow, drift.METHODS["drifters"].lasting(3000))
    assert np.isnan(large.leaving_by_way).any()
    np.testing.assert_allclose(large.leaving, layer.leaving, atol=1e-9)
    np.testing.assert_allclose(large.mean_by_way, layer.leaving_by_way.mean(axis=1), atol=1e-9)


def test_an_unknown_probability_of_leaving_does_not_read_as_none():
    about = quantities(drift.SeaDrift)["mean_leaving"]
    assert format_value(float("nan"), about) == "not known"
    assert format_value(0.0, about) == "0 %"


def test_without_gaps_drifters_that_cannot_cross_a_coast_stay():
    water, flow = strait(gap=False)
    step = drift.METHODS["drifters"].lasting(3000)
    shares = drift.exit_shares(water, flow, step, drift.drift_maps(water, flow, step))
    assert not shares[0].any()
    assert not drift.coast(strait()[0])[water.number[3, 3]]
    assert drift.coast(water)[water.number[3, 3]]


@pytest.mark.parametrize("diffusivity", [0.0, 20.0])
@pytest.mark.parametrize("coast", ["hold", "slip", "strand"])
def test_simulated_drifters_leave_as_the_map_says(coast, diffusivity):
    water, flow = strait(coast=coast, diffusivity=diffusivity)
    chain = drift.drift_maps(water, flow, drift.METHODS["drifters"].lasting(2000))
    everywhere = np.ones(water.cells, bool)
    # A map diffuses once per step; drifters diffuse once per substep.
    substeps = 1 if diffusivity else 8
    moved = drift.simulate_drifters(
        jax.random.key(0), water, flow, everywhere, 2000, 8, drifters=5000, substeps=substeps
    )
    gone = (moved.cell < 0).mean(axis=1)
    # A drifter that left does not come back.
    assert (np.diff((moved.cell < 0).astype(int), axis=0) >= 0).all()
    share = chain.push(np.full(water.cells, 1 / water.cells))
    assert gone[1] == pytest.approx(1 - float(share.sum()), abs=0.02)


def test_water_slips_along_a_coast_and_does_not_cross_it():
    wet = np.ones((4, 5), bool)
    wet[0] = False  # a coast in the South, along which the water goes to the East
    currents = sea(np.full(wet.shape, 0.2), np.full(wet.shape, -0.1), wet)
    hold, slip = (drift.Flow.of(currents, coast=coast) for coast in ("hold", "slip"))
    assert not np.asarray(hold.rate)[0, :, 0].any()
    np.testing.assert_allclose(np.asarray(slip.rate)[0, 0, 0], 0.2 / 1000)
    np.testing.assert_allclose(np.asarray(slip.rate)[0, 1, 0], 0)


def test_water_slips_along_both_sides_of_a_corner_and_round_the_earth():
    wet = np.ones((5, 5), bool)
    wet[2, 2] = False
    currents = sea(np.arange(25.0).reshape(5, 5) / 100, np.full(wet.shape, 0.1), wet)
    rate = np.asarray(drift.Flow.of(currents, coast="slip").rate)[0]
    # Along x the mean of the water in the South and North, along y that in the West and East.
    np.testing.assert_allclose(rate[:, 2, 2], [(0.07 + 0.17) / 2 / 1000, 0.1 / 1000])


def test_water_goes_on_into_sea_without_data():
    _, flow = strait()
    np.testing.assert_allclose(np.asarray(flow.rate)[0, 0, 2:, 4], 0.3 / 1000)


@settings(max_examples=20)
@given(st.integers(0, 2**32 - 1))
def test_gaps_connect_water_and_land_parts_it(seed):
    draw = np.random.default_rng(seed)
    wet = draw.random((5, 6)) < 0.6
    wet[0, 0] = True
    land = ~wet & (draw.random(wet.shape) < 0.5)
    currents = sea(0.1 * wet, 0 * wet, wet)
    currents["land"] = ("layer", "y", "x"), land[None]
    water = drift.Water.of(currents)
    # Flood by brute force.
    piece = np.full(wet.shape, -1)
    for start in zip(*np.nonzero(wet), strict=True):
        if piece[start] >= 0:
            continue
        label, reached = piece.max() + 1, [start]
        while reached:
            row, column = reached.pop()
            if land[row, column] or piece[row, column] >= 0:
                continue
            piece[row, column] = label
            reached += [
                (r, c)
                for r in range(max(row - 1, 0), min(row + 2, 5))
                for c in range(max(column - 1, 0), min(column + 2, 6))
            ]
    np.testing.assert_array_equal(water.piece, piece[wet])


def test_closed_edges_and_unknown_rules_at_the_coast_are_refused():
    water, flow = strait(coast="strand")
    with pytest.raises(ValueError, match="coast: expected the edge 'exit' with 'strand'"):
        drift.drift_map(water, flow, drift.DriftStep(3000))
    with pytest.raises(ValueError, match="coast: expected 'hold', 'slip' or 'strand'"):
        strait(coast="bounce")


@pytest.mark.parametrize("quarters", [0, 1, 2, 3])
@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("sign", [1, -1])
def test_drifters_leave_by_the_edge_that_the_current_leads_to(quarters, axis, sign):
    still, going = np.zeros((3, 4)), np.full((3, 4), 0.3 * sign)
    along = [going, still] if axis == 0 else [still, going]
    # The columns of the grid go to the East, North, West or South, and the current by the compass.
    angle = quarters * np.pi / 2
    water, flow = water_and_flow(sea(*along, angle=angle))
    layer = drift.Layer.of(water, flow, drift.METHODS["drifters"].lasting(3000))
    edge = EDGES[axis + (1 - sign)]
    assert layer.mean_leaving_by_way[EXITS.index(f"edge in the {edge}")] == pytest.approx(1)
