import datetime
import runpy
from pathlib import Path

import netCDF4
import numpy as np
import pytest
from drift import products
from drift.products import refused, write
from hypothesis import given, strategies as st

from jaxcell.drift import open_currents


DATA = Path(__file__).parents[2] / "data" / "ocean"
FORMATS = ("NETCDF4", "NETCDF3_CLASSIC", "NETCDF3_64BIT_OFFSET")
LON, LAT = -118.0 + 0.01 * np.arange(6), 33.5 + 0.01 * np.arange(5)
DEPTH, HOURS = np.array([0.0, 5.0, 10.0]), np.arange(4)
SHAPE = (4, 3, 5, 6)


def field():
    """A current whose components tell record, level, row and column; land in two cells."""
    t, k, j, i = np.indices(SHAPE)
    u = 0.1 + 0.01 * t + 0.05 * k + 0.001 * j + 0.0001 * i
    v = -0.2 + 0.01 * i - 0.02 * j + 0.003 * t
    land = ((j == 0) & (i == 5)) | ((j == 4) & (i == 0) & (k == 2))
    return np.where(land, np.nan, u), np.where(land, np.nan, v)


def regular(u=None, v=None, names=("u", "v")):
    """A dataset on time, depth, lat and lon, to be changed and written by a test."""
    values = [a if b is None else b for a, b in zip(field(), (u, v), strict=True)]
    time = products.hours(count=4, since="2011-07-01")
    dims = "time", "lat", "lon"
    return products.regular(*names, values, lon=LON, lat=LAT, depth=DEPTH, time=time, dims=dims)


def same(found, expected):
    for name in ("u", "v"):
        np.testing.assert_allclose(found[name], expected[name], atol=1e-6)
    for name in ("water", "land", "time", "depth"):
        np.testing.assert_array_equal(found[name], expected[name])
    for name in ("lon", "lat", "dx", "dy", "angle"):
        np.testing.assert_allclose(found[name], expected[name], rtol=1e-5, atol=1e-9)


def plain(tmp_path, **choice):
    return open_currents(write(tmp_path, regular(), "plain.nc"), **choice)


@pytest.mark.parametrize("format", FORMATS)
def test_written_currents_are_read(tmp_path, format):
    currents = open_currents(write(tmp_path, regular(), format=format))
    u, v = field()
    land = np.isnan(u).any(axis=0)
    np.testing.assert_array_equal(currents.u, u)
    np.testing.assert_array_equal(currents.v, v)
    np.testing.assert_array_equal(currents.water, ~land)
    np.testing.assert_array_equal(currents.depth, DEPTH)
    np.testing.assert_array_equal(
        currents.time, np.datetime64("2011-07-01") + HOURS.astype("timedelta64[h]")
    )
    np.testing.assert_allclose(currents.lon, np.broadcast_to(LON, (5, 6)))
    np.testing.assert_allclose(currents.lat, np.broadcast_to(LAT[:, None], (5, 6)))
    assert (currents.angle == 0).all()
    assert currents.u.dims == ("time", "layer", "y", "x")
    assert currents.attrs["source"] == "sea.nc"
    assert not currents.isnull()[["dx", "dy", "angle", "lon", "lat"]].any().to_array().any()


CF = ("eastward_sea_water_velocity", "northward_sea_water_velocity")
SURFACE = ("surface_eastward_sea_water_velocity", "surface_northward_sea_water_velocity")


@pytest.mark.parametrize(
    ("names", "standard_names", "why"),
    [
        (("a", "b"), CF, "standard names eastward_sea_water_velocity"),
        (("a", "b"), SURFACE, "standard names surface_eastward"),
        (("v", "u"), CF, "standard names"),  # the dissertation's slip cannot mislead
        (("U", "V"), None, "grid of latitude and longitude"),
        (("x_current", "y_current"), ("sea_water_x_velocity", "sea_water_y_velocity"), "standard"),
    ],
)
def test_a_current_to_the_east_comes_out_east_by_any_name(tmp_path, names, standard_names, why):
    east, north = np.full(SHAPE, 0.5), np.zeros(SHAPE)
    dataset = regular(east, north, names)
    for name, standard_name in zip(names, standard_names or (), strict=False):
        dataset[name].attrs["standard_name"] = standard_name
    dataset["temperature"] = dataset[names[0]].drop_attrs(deep=False) + 15
    currents = open_currents(write(tmp_path, dataset))
    assert (currents.u == 0.5).all()
    assert (currents.v == 0).all()
    assert names[0] in currents.attrs["east_from"]
    assert names[1] in currents.attrs["north_from"]
    assert why in currents.attrs["east_from"]


def turned_about(dataset):
    return dataset.isel(lat=slice(None, None, -1), depth=slice(None, None, -1))


@pytest.mark.parametrize(
    "change",
    [
        turned_about,
        lambda d: d.isel(lon=slice(None, None, -1)),
        lambda d: d.transpose("lon", "lat", "depth", "time"),
        lambda d: d.assign_coords(depth=("depth", -DEPTH, {"units": "m", "positive": "up"})),
        lambda d: d.assign_coords(depth=("depth", -DEPTH)),
        lambda d: d.rename(lat="LATITUDE", lon="LONGITUDE", time="TIME", depth="DEPTH"),
        lambda d: d.expand_dims(member=1),
        lambda d: (100 * d).assign(u=(100 * d.u).assign_attrs(units="cm s-1"),
                                   v=(100 * d.v).assign_attrs(units="cm/s")),
        lambda d: d.fillna(1e37),
        # The layout of the dissertation has longitudes to 360, and an undeclared -9999 on land.
        lambda d: d.fillna(-9999.0).assign_coords(lon=LON + 360),
        lambda d: d.assign_coords(lon2=(("lat", "lon"), np.zeros((5, 6)))),
    ],
)  # fmt: skip
def test_other_layouts_of_one_current_are_read_alike(tmp_path, change):
    same(open_currents(write(tmp_path, change(regular()))), plain(tmp_path))


def test_packed_values_and_two_fill_values(tmp_path):
    packed = {"dtype": "i2", "scale_factor": 1e-4, "_FillValue": -32767}
    path = write(tmp_path, regular(), encoding={"u": packed, "v": packed})
    currents = open_currents(path)
    np.testing.assert_array_equal(currents.water, plain(tmp_path).water)
    np.testing.assert_allclose(currents.u, plain(tmp_path).u, atol=0.6e-4)
    with netCDF4.Dataset(path, "a") as file:
        file["u"].missing_value = np.int16(-32768)
        file["u"].set_auto_maskandscale(False)
        file["u"][0, 0, 2, 2] = -32768
    assert int(plain(tmp_path).water.sum()) == int(open_currents(path).water.sum()) + 1


def test_longitudes_across_the_antimeridian_stay_in_order(tmp_path):
    both = [np.nan_to_num(values, nan=0.5) for values in field()]
    across = regular(*both).assign_coords(lon=np.array([179.7, 179.8, 179.9, 180, 180.1, 180.2]))
    currents = open_currents(write(tmp_path, across))
    np.testing.assert_allclose(currents.lon[0], [179.7, 179.8, 179.9, -180, -179.9, -179.8])
    assert "lon: 179.7 to 180.2 wrapped" in currents.attrs["notes"]
    np.testing.assert_array_equal(currents.u, both[0])
    assert float(np.ptp(currents.dx.values[0])) < 1e-6
    part = open_currents(write(tmp_path, across), bounds=(179.85, 33, -179.95, 34))
    np.testing.assert_allclose(part.lon[0], [179.9, -180])


def great_circle(lon1, lat1, lon2, lat2):
    lon1, lat1, lon2, lat2 = (np.radians(a) for a in (lon1, lat1, lon2, lat2))
    half = np.sin((lat2 - lat1) / 2) ** 2
    half += np.cos(lat1) * np.cos(lat2) * np.sin((lon2 - lon1) / 2) ** 2
    return 2 * 6371000 * np.arcsin(np.sqrt(half))


def test_sides_are_distances_between_centres(tmp_path):
    lat = np.array([33.5, 33.51, 33.53, 33.54, 33.58])
    currents = open_currents(write(tmp_path, regular().assign_coords(lat=lat)))
    for j in range(5):
        expected = great_circle(LON[0], lat[j], LON[1], lat[j])
        np.testing.assert_allclose(currents.dx[j], expected, rtol=1e-6)
    row = great_circle(LON[0], lat[:-1], LON[0], lat[1:])
    assert float(currents.dy[0, 0]) == pytest.approx(row[0])
    assert float(currents.dy[4, 0]) == pytest.approx(row[3])


def test_variables_are_chosen_by_name(tmp_path):
    dataset = regular(names=("p", "q"))
    dataset["uo"], dataset["vo"] = dataset.p * 0, dataset.q * 0
    currents = open_currents(write(tmp_path, dataset), variables=("p", "q"))
    same(currents, plain(tmp_path))


@pytest.mark.parametrize(
    ("time", "records"),
    [
        (None, [0, 1, 2, 3]),
        (2, [2]),
        (-1, [3]),
        (slice(1, 3), [1, 2]),
        (slice(None, None, 2), [0, 2]),
        ("2011-07-01T02:00", [2]),
        ("2011-07-01T02:20Z", [2]),
        ("2011-07-01T04:20+02:00", [2]),
        ("2011-06-30T23:40", [0]),
        ("2011-07-01T01:30", [2]),
        (np.datetime64("2011-07-01T01"), [1]),
        (datetime.datetime(2011, 7, 1, 3), [3]),
        (("2011-07-01T01:00", "2011-07-01T02:00"), [1, 2]),
        ((1, 3), [1, 2, 3]),
        ((None, "2011-07-01T01:00"), [0, 1]),
        (slice("2011-07-01T01:00", None), [1, 2, 3]),
        ((1, 1), [1]),
    ],
)
def test_records_are_chosen_by_index_and_moment(tmp_path, time, records):
    currents = plain(tmp_path, time=time)
    np.testing.assert_array_equal(currents.u[:, 0, 1, 1], field()[0][records, 0, 1, 1])
    np.testing.assert_array_equal(currents.time, plain(tmp_path).time[records])


def test_files_without_time_or_date(tmp_path):
    still = open_currents(write(tmp_path, regular().isel(time=0, drop=True)))
    assert still.u.shape == (1, *SHAPE[1:])
    assert "1970" in still.attrs["notes"]
    dataset = regular()
    dataset["time"] = ("time", HOURS * 3600.0, {"units": "second"})
    path = write(tmp_path, dataset)
    currents = open_currents(path)
    hours = np.diff(currents.time) / np.timedelta64(1, "h")
    np.testing.assert_array_equal(hours, 1)
    assert "without a date" in currents.attrs["notes"]
    refused(path, r"time: expected the index of a record", time="2011-07-01")
    assert open_currents(path, time=1).sizes["time"] == 1


def test_depths_are_chosen_among_the_levels(tmp_path):
    same(plain(tmp_path, depths=(10, 0)), plain(tmp_path).isel(layer=[0, 2]))
    same(plain(tmp_path, depths=5.004), plain(tmp_path).isel(layer=[1]))
    surface = write(tmp_path, regular().isel(depth=0, drop=True))
    for depths in (None, 0, [0.0]):
        same(open_currents(surface, depths=depths), plain(tmp_path).isel(layer=[0]))


def test_a_layer_ends_where_the_sea_does(tmp_path):
    dataset = regular(*(np.nan_to_num(a) + 0.5 for a in field()))
    bed = np.full((5, 6), 7.0)
    bed[2:, 3:] = 30
    dataset["bathymetry"] = (
        ("lat", "lon"), bed, {"standard_name": "sea_floor_depth_below_geoid"}
    )  # fmt: skip
    currents = open_currents(write(tmp_path, dataset))
    np.testing.assert_array_equal(currents.water[:2], np.ones((2, 5, 6)))
    np.testing.assert_array_equal(currents.water[2], bed >= 10)
    shallow = {"bounds": (-118, 33.5, -117.98, 33.51)}
    currents = open_currents(write(tmp_path, dataset), **shallow)
    np.testing.assert_array_equal(currents.depth, [0, 5])
    assert "left out, as no cell has water there: 10 m" in currents.attrs["notes"]
    with pytest.raises(ValueError, match=r"depths: 10 m is below the sea bed everywhere: .* 7 m"):
        open_currents(write(tmp_path, dataset), depths=10, **shallow)


@given(st.data())
def test_a_part_is_a_part_of_the_whole(data):
    whole = open_currents(regular())
    i, j = (sorted(data.draw(st.tuples(*[st.integers(0, n)] * 2))) for n in (5, 4))
    shift = data.draw(st.sampled_from([0, 360]))
    bounds = (LON[i[0]] - 0.004 + shift, LAT[j[0]] - 0.004, LON[i[1]] + 0.004 + shift,
              LAT[j[1]] + 0.004)  # fmt: skip
    time = data.draw(st.integers(0, 3))
    expected = whole.isel(time=[time], y=slice(j[0], j[1] + 1), x=slice(i[0], i[1] + 1))
    expected = expected.isel(layer=[0])
    if not expected.water.any():
        return
    same(open_currents(regular(), bounds=bounds, time=time, depths=0), expected)


def without_record(dataset):
    """No velocity at record 3."""
    return dataset.assign(u=dataset.u.where(dataset.time.values[:, None, None, None] < 3))


def in_turns(dataset):
    """A velocity in a quarter of the columns at each record."""
    t, _, _, i = np.indices(SHAPE)
    return dataset.assign(u=dataset.u.where(i % 4 == t))


def with_value(name, value):
    def change(dataset):
        dataset[name][1, 0, 2, 3] = value
        return dataset

    return change


@pytest.mark.parametrize(
    ("change", "choice", "message"),
    [
        (lambda d: d.drop_vars("u"), {}, r"variables: no velocity found; the file has v"),
        (lambda d: d.drop_vars(["u", "v"]), {}, r"no velocity found; the file has no variables"),
        (lambda d: d * np.nan, {}, r"u, v: every cell is land"),
        (without_record, {}, r"time: record 3 has no velocity anywhere"),
        (in_turns, {}, r"time: no cell has a velocity at each of the 4 records"),
        (with_value("u", 15.5), {}, r"u: expected currents up to 10 m/s, got 15.5 at record 1, "
         r"level 0, row 2, column 3"),
        (with_value("v", -999.0), {}, r"v: expected currents up to 10 m/s, got -999"),
        (lambda d: d.assign(u=d.u.assign_attrs(units="furlongs")), {}, r"u: units: .*--units cm/s"),
        (lambda d: d.assign_coords(lon=LON[[0, 1, 3, 2, 4, 5]]), {},
         r"lon: expected longitudes in order, got -117.97 then -117.98 at index 3"),
        (lambda d: d.assign_coords(lat=LAT[[0, 1, 1, 2, 3]]), {}, r"lat: expected latitudes in"),
        (lambda d: d.assign_coords(lat=LAT + 60), {}, r"lat: expected degrees .* got 93.54"),
        (lambda d: d.assign_coords(lon=np.where(LON > -117.96, np.nan, LON)), {},
         r"lon: .* no number at index 5"),
        (lambda d: d.assign_coords(depth=[0.0, 10, 5]), {}, r"depth: expected levels in order"),
        (lambda d: d.assign_coords(depth=("depth", DEPTH, {"units": "level"})), {}, r"'level'"),
        (lambda d: d.drop_vars("depth"), {}, r"depth: the depths of the levels are missing"),
        (lambda d: d.drop_vars("time"), {}, r"time: no variable gives the times"),
        (lambda d: d.isel(time=[0, 2, 1, 3]), {}, r"time: expected times in order.*record 2"),
        (lambda d: d.isel(time=slice(0, 0)), {}, r"u: it has no values: one of its dimensions"),
        (lambda d: d.assign_coords(time=("time", HOURS, {"units": "hours since Tuesday"})), {},
         r"time: its times in 'hours since Tuesday' cannot be read; .*--time-units"),
        (lambda d: d.assign_coords(time=("time", HOURS, {"units": "moons"})), {}, r"got 'moons'"),
        (lambda d: d.assign_coords(time=("time", HOURS, {"units": "days since 2011-01-01",
         "calendar": "maya"})), {}, r"time: calendar: 'maya' is unknown; .*--calendar standard"),
        (lambda d: d.drop_vars("lon"), {}, r"u: no variable gives the longitudes of its cells"),
        (lambda d: d.isel(lat=[0]), {}, r"lat: expected 2 cells or more along it, got 1"),
        (lambda d: d.isel(lat=0), {}, r"u: expected a dimension for y"),
        (lambda d: d.rename(depth="wave"), {}, r"u: dimension wave of length 3"),
        (lambda d: d.assign(v=d.v[0]), {}, r"v: expected the dimensions of u"),
        (lambda d: d.assign(u=d.u.astype(str)), {}, r"u: expected numbers"),
        (lambda d: d.assign(w=d.u.assign_attrs(standard_name=CF[0])), {},
         r"standard_name: expected one variable that is northward_.*got none"),
        (lambda d: d.assign(a=d.u.assign_attrs(standard_name=CF[0]), b=d.u.assign_attrs(
         standard_name=CF[0])), {}, r"expected one variable that is eastward_.*got a, b"),
        (lambda d: d, {"variables": ("u", "w")}, r"variables: 'w' is not in the file"),
        (lambda d: d, {"variables": "uv"}, r"variables: expected the names of u and v"),
        (lambda d: d, {"time": 4}, r"time: record 4: the file has 0 to 3"),
        (lambda d: d, {"time": slice(4, 9)}, r"time: slice\(4, 9, None\) holds none of the 4"),
        (lambda d: d, {"time": "2011-07-01T03:40"}, r"time: 2011-07-01T03:40: the nearest"),
        (lambda d: d, {"time": "2011-07-02"}, r"time: 2011-07-02: the nearest .*T03:00"),
        (lambda d: d, {"time": "noon"}, r"time: expected an index or a date .*'noon'"),
        (lambda d: d, {"time": "NaT"}, r"time: expected .*'NaT'"),
        # 64 bits of nanoseconds would have it on 2011-07-01.
        (lambda d: d, {"time": "2596-01-19T01:00"}, r"time: expected a date from 1678 to 2261"),
        (lambda d: d, {"time": slice(None, None, -1)}, r"time: expected a step of 1 or more"),
        (lambda d: d.assign_coords(time=("time", HOURS * 1e12, {"units": "hours"})), {},
         r"time: the time of record 1 is missing, or not from 1678 to 2261"),
        (lambda d: d, {"time": (0, "2012-01-01")}, r"time: 2012-01-01: the nearest"),
        (lambda d: d, {"time": (2, 1)}, r"time: expected the earlier time first"),
        (lambda d: d, {"time": (0, 1, 2)}, r"time: expected the first and the last"),
        (lambda d: d, {"time": slice("2011-07-01", None, 2)}, r"without a step"),
        (lambda d: d, {"depths": 7.5}, r"depths: 7.5 m is not one of the levels 0, 5, 10 m"),
        (lambda d: d, {"depths": [0, -5]}, r"depths: expected metres, positive down"),
        (lambda d: d, {"depths": []}, r"depths: expected metres, positive down"),
        (lambda d: d, {"depths": [0, 0]}, r"depths: expected different depths"),
        (lambda d: d, {"depths": float("nan")}, r"depths: expected metres"),
        (lambda d: d.isel(depth=0, drop=True), {"depths": 5}, r"depths: u has a single level"),
        (lambda d: d.where(d.depth < 10), {"depths": 10}, r"depths: 10 m: no cell has water"),
        (lambda d: d, {"bounds": (0, 33, 1, 34)}, r"bounds: .*no cell is within them; the file "
         r"goes from -118 to -117.95 East and 33.5 to 33.54 North"),
        (lambda d: d, {"bounds": (-118, 34, -117, 33)}, r"bounds: expected .*south < north"),
        (lambda d: d, {"bounds": (-118, 33, -118, 34)}, r"bounds: expected"),
        (lambda d: d, {"bounds": (-118, 33, -117)}, r"bounds: expected \(west, south"),
        (lambda d: d, {"bounds": (-118, 33, float("nan"), 34)}, r"bounds: expected west"),
    ],
)  # fmt: skip
def test_damaged_files_and_wrong_choices_are_refused(tmp_path, change, choice, message):
    refused(write(tmp_path, change(regular())), message, **choice)


def test_the_bundled_file_is_that_of_its_script(tmp_path):
    runpy.run_path(str(DATA / "make_currents.py"))["main"](tmp_path)
    assert (tmp_path / "gyres.nc").read_bytes() == (DATA / "gyres.nc").read_bytes()
    assert "`gyres.nc`" in (DATA / "README.md").read_text()


def test_dates_beyond_64_bits_of_nanoseconds_are_refused():
    dates = np.datetime64("2596-01-19T00", "s") + np.arange(SHAPE[0])
    with pytest.raises(ValueError, match=r"record 0 is missing, or not from 1678 to 2261"):
        open_currents(regular().assign_coords(time=dates))
