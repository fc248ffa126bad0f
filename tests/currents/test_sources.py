"""Currents in several files, stores, addresses and datasets in hand."""

import tracemalloc

import netCDF4
import numpy as np
import pytest
import xarray as xr
from drift import products
from drift.products import refused, write

from jaxcell.base.doubts import Doubt
from jaxcell.drift import open_currents


def months(folder):
    """A file of three records for each of three months, counted from its own beginning."""
    for month in (1, 2, 3):
        since = f"2020-{month:02}-01"
        dataset = products.regular("uo", "vo", time=products.hours(since=since))
        dataset["uo"] = dataset.uo + month
        write(folder, dataset, f"sea_{month}.nc")
    return [folder / f"sea_{month}.nc" for month in (1, 2, 3)]


def check_months(currents, several):
    """Check the records of some months, as `months` wrote them."""
    for name, values, more in zip("uv", products.numbers(), (1, 0), strict=True):
        expected = np.concatenate([values + more * month for month in several])
        np.testing.assert_array_equal(currents[name].values[:, 0], expected)
    first = [np.datetime64(f"2020-{month:02}-01", "ns") for month in several]
    hour = np.timedelta64(1, "h")
    expected = [time + k * hour for time in first for k in range(products.RECORDS)]
    np.testing.assert_array_equal(currents.time.values, expected)
    lon, lat = np.meshgrid(products.LON, products.LAT)
    np.testing.assert_allclose(currents.lon, lon, atol=1e-12)
    np.testing.assert_allclose(currents.lat, lat, atol=1e-12)


def test_records_continue_from_file_to_file(tmp_path):
    paths = months(tmp_path)
    for source in (paths, paths[::-1], str(tmp_path / "sea_*.nc"), tmp_path / "sea_[123].nc"):
        currents = open_currents(source)
        check_months(currents, (1, 2, 3))
    assert currents.attrs["source"] == "sea_1.nc to sea_3.nc (3 files)"
    asked = open_currents(paths, time="2020-02-01T01:00")
    u, v = (values[1] for values in products.numbers())
    np.testing.assert_array_equal(asked.u.values[:, 0], [u + 2])
    np.testing.assert_array_equal(asked.v.values[:, 0], [v])
    check_months(open_currents(paths, time="2020-02"), (2,))
    check_months(open_currents(paths, time="2020-02-01/2020-03-01T02:00"), (2, 3))
    with pytest.raises(
        ValueError, match="time: 2020-12: the records are from 2020-01-01 to 2020-03"
    ):
        open_currents(paths, time="2020-12")


@pytest.mark.parametrize("calendar", ["noleap", "360_day"])
def test_calendars_continue_from_file_to_file(tmp_path, calendar):
    """The records cross the end of a leap year of the common calendar."""
    for year in (2020, 2021):
        time = np.arange(3) * 100, {"units": f"days since {year}-05-01", "calendar": calendar}
        write(tmp_path, products.regular("uo", "vo", time=time), f"{year}.nc")
    currents = open_currents(tmp_path / "202?.nc")
    year = {"noleap": 365, "360_day": 360}[calendar]
    days = (currents.time - currents.time[0]).values / np.timedelta64(1, "D")
    np.testing.assert_array_equal(days, [0, 100, 200, year, year + 100, year + 200])


def test_stores_and_open_datasets_are_read_alike(tmp_path):
    path = months(tmp_path)[0]
    with xr.open_dataset(path, decode_times=False) as dataset:
        for version in (2, 3):
            dataset.to_zarr(
                tmp_path / f"sea_{version}.zarr", zarr_format=version, consolidated=False
            )
    in_store = [open_currents(tmp_path / f"sea_{version}.zarr") for version in (2, 3)]
    assert in_store[0].attrs["source"] == "sea_2.zarr"
    with xr.open_dataset(path) as dataset:
        in_hand = open_currents(dataset)
        assert open_currents(dataset.drop_encoding()).attrs["source"] == "dataset"
    assert in_hand.attrs["source"] == "sea_1.nc"
    for found in (*in_store, in_hand):
        check_months(found, (1,))


def test_one_record_at_a_time_is_read(tmp_path):
    """Of 160 GB on paper, in two files of which almost nothing was written."""
    for number in (0, 1):
        with netCDF4.Dataset(tmp_path / f"sea_{number}.nc", "w") as file:
            for name, size in (("time", 100), ("lat", 10000), ("lon", 10000)):
                file.createDimension(name, size)
                variable = file.createVariable(name, "f8", (name,))
                variable[:] = np.arange(size) * (0.001 if name in ("lat", "lon") else 1)
            file["time"].units = f"hours since 202{number}-01-01"
            for name in ("uo", "vo"):
                variable = file.createVariable(
                    name, "f4", ("time", "lat", "lon"), chunksizes=(1, 50, 50)
                )
                variable[7, 500:503, 600:604] = 0.25 + number
    message = (
        r"sea_1.nc: uo, vo: 200 \(time\) x 1 \(layer\) x 10000 \(y\) x 10000 \(x\) values would "
        r"take 298\.0 GiB"
    )
    with pytest.raises(ValueError, match=message):
        open_currents(tmp_path / "sea_*.nc")
    tracemalloc.start()
    currents = open_currents(
        tmp_path / "sea_*.nc", time="2021-01-01T07:00", bounds=(0.6, 0.5, 0.603, 0.502)
    )
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    np.testing.assert_array_equal(currents.u, np.full((1, 1, 3, 4), 1.25))
    assert peak < 50e6


def test_the_grid_of_croco_may_be_in_another_file(tmp_path):
    wet, turn = products.island(), np.radians(20.0)
    whole = products.croco(wet, turn_deg=20.0)
    fixed = [name for name, array in whole.data_vars.items() if array.dims == products.RHO]
    grid = write(tmp_path, whole[fixed], "grid.nc", format="NETCDF3_64BIT_OFFSET")
    moving = write(tmp_path, whole.drop_vars(fixed), "his.nc", format="NETCDF3_64BIT_OFFSET")
    currents = open_currents(moving, grid=grid, depths=(0, 10))
    np.testing.assert_array_equal(currents.water, [wet, wet])
    np.testing.assert_allclose(currents.lon, whole.lon_rho, atol=1e-9)
    np.testing.assert_allclose(currents.lat, whole.lat_rho, atol=1e-9)
    around = np.pad(wet, 1, constant_values=True)
    coast = ~(around[1:-1, :-2] & around[1:-1, 2:] & around[:-2, 1:-1] & around[2:, 1:-1])
    open_sea = wet & ~coast
    assert open_sea.sum() > 15
    east = 0.3 * np.cos(turn) + 0.2 * np.sin(turn)
    north = 0.3 * np.sin(turn) - 0.2 * np.cos(turn)
    np.testing.assert_allclose(currents.u.values[..., open_sea], east)
    np.testing.assert_allclose(currents.v.values[..., open_sea], north)
    assert "lon_rho, lat_rho: from grid.nc" in currents.attrs["notes"]
    refused(moving, r"u: no variable gives the longitudes .*--coords LON LAT.*--grid FILE")
    short = write(tmp_path, whole[fixed].isel(xi_rho=slice(1, None)), "short.nc")
    wrong = whole[fixed].assign(angle=np.radians(90) + whole.angle)
    with pytest.raises(ValueError, match=r"short.nc: xi_rho: expected the length 9 of .*his.nc"):
        open_currents(moving, grid=short)
    with pytest.raises(ValueError, match=r"dataset: angle: expected the angle from East"):
        open_currents(moving, grid=wrong)


def averages(dataset, name):
    """Describe one component as XIOS writes it: with a second variable of time beside `time`."""
    middle = dataset.time.variable.copy()
    bounds = np.stack([middle.values - 0.5, middle.values + 0.5], axis=1)
    more = {"time_centered": middle, "time_centered_bounds": (("time", "axis_nbounds"), bounds)}
    return dataset[[name]].assign_coords(more).rename(time="time_counter")


def test_components_in_two_files_with_two_variables_of_time_are_joined(tmp_path):
    dataset = products.regular("uo", "vo")
    paths = [write(tmp_path, averages(dataset, name), f"{name}.nc") for name in ("uo", "vo")]
    currents = open_currents(paths)
    for name, values in zip("uv", products.numbers(), strict=True):
        np.testing.assert_array_equal(currents[name].values[:, 0], values)


def test_forecasts_that_overlap_are_joined_and_the_last_to_begin_is_used(tmp_path):
    """Four runs of three hours, one an hour; the current tells the run."""
    for run in range(4):
        dataset = products.regular("uo", "vo", time=products.hours(run))
        write(tmp_path, dataset.assign(uo=0 * dataset.uo + run + 1), f"run_{run}.nc")
    with pytest.warns(Doubt, match=r"\(4 files\): records until 2020-01-01T04.* are in more than"):
        currents = open_currents(tmp_path / "run_?.nc")
    assert currents.u.values[:, 0, 2, 2].tolist() == [1, 2, 3, 4, 4, 4]
    hours = (currents.time - currents.time[0]).values / np.timedelta64(1, "h")
    np.testing.assert_array_equal(hours, np.arange(6))


def moved(dataset):
    return dataset.assign_coords(longitude=dataset.longitude + 1)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (moved, r"b.nc: longitude: not the same as in .*a.nc; expected one grid"),
        (lambda d: d.assign(uo=2 * d.uo), r"uo: two files that begin at 2020-01-01T00.* different"),
        (
            lambda d: d.isel(time=[0, 2]),
            r"a.nc, .*b.nc: uo: expected records in order from file to",
        ),
        (lambda d: d.assign_coords(time=("time", [0, 1, 2], {"units": "moons"})), r"b.nc: time: u"),
    ],
)
def test_files_that_do_not_fit_are_refused(tmp_path, change, message):
    dataset = products.regular("uo", "vo")
    paths = [write(tmp_path, dataset, "a.nc"), write(tmp_path, change(dataset), "b.nc")]
    with pytest.raises(ValueError, match=message) as caught:
        open_currents(paths)
    assert "\n" not in str(caught.value)


def test_velocities_at_other_times_are_refused(tmp_path):
    dataset = products.regular("uo", "vo")
    later = dataset.drop_vars("uo").assign_coords(time=("time", [9, 10, 11], dataset.time.attrs))
    paths = [write(tmp_path, dataset.drop_vars("vo"), "u.nc"), write(tmp_path, later, "v.nc")]
    message = r"u.nc, .*v.nc: time: no variable is at each of the 6 records of these files"
    with pytest.raises(ValueError, match=message):
        open_currents(paths)


def test_missing_sources_are_refused(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"other_\*.nc: no file matches this pattern"):
        open_currents(tmp_path / "other_*.nc")
    with pytest.raises(FileNotFoundError, match=r"other.nc: there is no such file"):
        open_currents([*months(tmp_path), tmp_path / "other.nc"])
    with pytest.raises(ValueError, match="path: expected a file or more, got none"):
        open_currents([])
    refused(tmp_path, "cannot be read as a Zarr store")
    # No server listens at this address.
    address = "http://127.0.0.1:9/dodsC/sea.nc"
    message = f"^{address}: cannot be reached by OPeNDAP .no network, or no such dataset.: "
    with pytest.raises(ValueError, match=message):
        open_currents(address)
