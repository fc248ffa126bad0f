"""Published products: the choice of velocities, gaps, calendars, and grids."""

import numpy as np
import pytest
import xarray as xr
from drift import products
from drift.products import refused, write

from jaxcell.drift import Water, open_currents


def reads(currents, u, v):
    """Check that the velocities are exactly these, row by row from the South."""
    np.testing.assert_array_equal(currents.u.values[:, 0], u)
    np.testing.assert_array_equal(currents.v.values[:, 0], v)
    assert currents.water.values.all()


EARTH = [
    *("uo vo", "ugos vgos", "utotal vtotal", "ucur vcur", "UCUR VCUR", "EWCT NSCT", "EVEL NVEL"),
    *("water_u water_v", "u_eastward v_northward", "u_sur_eastward v_sur_northward"),
]
BY_DIMS = ["u v", "uos vos", "ssu ssv", "vozocrtx vomecrty", "sozocrtx somecrty", "ug vg"]


@pytest.mark.parametrize("names", EARTH + BY_DIMS)
@pytest.mark.parametrize("dims", [("time", "latitude", "longitude"), ("time_counter", "y", "x")])
def test_velocities_are_known_by_name_on_longitudes_and_latitudes(tmp_path, names, dims):
    u, v = names.split()
    currents = open_currents(products.regular(u, v, dims=dims))
    reads(currents, *products.numbers())
    assert currents.attrs["east_from"].startswith(f"{u} (by their ")
    assert currents.attrs["north_from"].startswith(f"{v} (by their ")


def test_a_wave_or_tide_beside_the_current_is_not_taken():
    dataset = products.regular("uo", "vo")
    for one in ("utide", "vtide", "vsdx", "vsdy"):
        dataset[one] = 3 * dataset.uo
    reads(open_currents(dataset), *products.numbers())


def test_oscar_is_read(tmp_path):
    currents = open_currents(write(tmp_path, products.oscar_old()))
    assert currents.u.shape == (1, 1, 9, 18)
    assert Water.of(currents).wraps
    i = (currents.lon.values - 20) % 360 / 20 + 1
    row = (80 - currents.lat.values) / 20
    reads(currents, (i / 32 + row / 64)[None], -(i / 32 + row / 64)[None])
    assert float(currents.depth[0]) == 15
    u, v = products.numbers(1, 5, 8)
    order = [4, 5, 6, 7, 0, 1, 2, 3]  # from -180 degrees
    for geostrophic in (False, True):
        currents = open_currents(write(tmp_path, products.oscar_new(geostrophic)))
        reads(currents, u[..., order], v[..., order])
        assert currents.time.values[0] == np.datetime64("2020-01-01")
        assert "calendar julian" in currents.attrs["notes"]
        assert Water.of(currents).wraps


def test_rtofs_is_read(tmp_path):
    currents = open_currents(write(tmp_path, products.rtofs()))
    reads(currents, *products.numbers(1, 5, 7))
    assert currents.time.values[0] == np.datetime64("2024-01-01")
    assert float(currents.lon.max()) < 180


# Radar.


def test_gaps_of_a_radar_are_filled_where_most_records_are_there(tmp_path):
    u, v = products.numbers(10)
    currents = open_currents(write(tmp_path, products.radar(flags=False)))
    water = np.ones((5, 6), bool)
    water[3, 3] = False  # 3 of 10 are missing
    np.testing.assert_array_equal(currents.water[0], water)
    # One hour after the first it holds the first; between, it is on a line.
    u[0, 2, 2] = u[1, 2, 2]
    u[4, 1, 1] = 5
    both = np.where(water, u, np.nan), np.where(water, v, np.nan)
    # v[0] and v[7] exist, but u is missing in these records.
    both[1][0, 2, 2] = v[1, 2, 2]
    np.testing.assert_allclose(currents.u[:, 0], both[0], atol=1e-15)
    np.testing.assert_allclose(currents.v[:, 0], both[1], atol=1e-15)
    assert "1 cells lack a velocity at up to 20% of the 10 records" in currents.attrs["notes"]
    assert "1 cells have a velocity at some of the 10 records only" in currents.attrs["notes"]


def test_bad_flags_of_a_radar_are_gaps(tmp_path):
    u, _ = products.numbers(10)
    currents = open_currents(write(tmp_path, products.radar()))
    water = np.ones((5, 6), bool)
    water[3, 3] = water[0, 0] = False
    np.testing.assert_array_equal(currents.water[0], water)
    np.testing.assert_allclose(currents.u[4, 0, 1, 1], u[4, 1, 1], atol=1e-15)
    assert "UCUR_quality_control: values with 3 (bad_data_that" in currents.attrs["notes"]
    named = products.radar().rename(UCUR_quality_control="a", VCUR_quality_control="b")
    named.UCUR.attrs["ancillary_variables"] = named.VCUR.attrs["ancillary_variables"] = "a, c"
    xr.testing.assert_equal(open_currents(named), currents)
    del named.a.attrs["flag_values"]
    unheeded = open_currents(named)
    assert unheeded.water[0, 0, 0]
    assert "a: its values have no flag_meanings; the flag is ignored" in unheeded.attrs["notes"]


# Calendars.


@pytest.mark.parametrize("calendar", ["noleap", "360_day", "standard"])
def test_calendars_keep_the_days_between_records(tmp_path, calendar):
    """Dates continue by the days between records, in every calendar."""
    time = np.array([58, 59, 60]), {"units": "days since 2020-01-01", "calendar": calendar}
    path = write(tmp_path, products.regular("uo", "vo", time=time))
    currents = open_currents(path)
    dates = np.array(["2020-02-28", "2020-02-29", "2020-03-01"], "M8[ns]")
    np.testing.assert_array_equal(currents.time, dates)
    assert ("calendar" in currents.attrs["notes"]) == (calendar != "standard")
    decoded = xr.open_dataset(path)
    xr.testing.assert_identical(
        open_currents(decoded).drop_attrs(deep=False), currents.drop_attrs(deep=False)
    )
    # The day of the last record in its own calendar.
    asked = {"noleap": "2020-03-02", "360_day": "2020-03-01", "standard": "2020-03-01"}[calendar]
    assert open_currents(path, time=asked).time.values[0] == np.datetime64("2020-03-01")
    if calendar == "360_day":
        assert open_currents(path, time="2020-02-30").time.values[0] == np.datetime64("2020-02-29")
    refused(path, "time: expected an index or a date", time="2020-02-31")


# NEMO.


def nemo(tmp_path, names=("vozocrtx", "vomecrty"), surface=False, **mesh):
    """The three files, the velocities along the grid on the sides, and the mesh."""
    grid = products.nemo_mesh(**mesh)
    u, v = (values[:, None] for values in products.numbers())
    files = [
        write(tmp_path, products.nemo(grid, *one, surface=surface), f"{one[0]}.nc")
        for one in (("u", names[0], u), ("v", names[1], v))
    ]
    return files, write(tmp_path, grid, "mesh_mask.nc"), (u[:, 0], v[:, 0]), grid


@pytest.mark.parametrize("names", [("vozocrtx", "vomecrty"), ("uo", "vo"), ("a", "b")])
@pytest.mark.parametrize("surface", [False, True])
def test_nemo_is_averaged_from_its_sides(tmp_path, names, surface):
    files, grid_file, sides, grid = nemo(tmp_path, names, surface)
    asked = {"variables": names} if names == ("a", "b") else {}
    currents = open_currents(files[::-1], grid=grid_file, **asked)
    wet = grid.tmask.values[0].astype(bool)
    np.testing.assert_array_equal(currents.water, wet[:1] if surface else wet)
    np.testing.assert_allclose(currents.depth, [0] if surface else [5, 15])
    # That of the positions: on the Earth the grid is not turned by exactly that everywhere.
    angle = currents.angle.values
    np.testing.assert_allclose(np.degrees(angle), 30, atol=0.4)
    cos, sin = np.cos(angle), np.sin(angle)
    for layer in range(currents.sizes["layer"]):
        u, v = sides[0] * grid.umask.values[0, layer], sides[1] * grid.vmask.values[0, layer]
        x, y = products.to_centres(u[..., :-1], 2), products.to_centres(v[:, :-1], 1)
        for name, expected in (("u", x * cos - y * sin), ("v", x * sin + y * cos)):
            expected = np.where(wet[layer], expected, np.nan)
            np.testing.assert_allclose(currents[name][:, layer], expected, atol=1e-15)
    np.testing.assert_array_equal(currents.dx, 10000)
    assert "averaged from the sides of the cells" in currents.attrs["notes"]
    assert "glamt, gphit: from mesh_mask.nc" in currents.attrs["notes"]
    assert currents.attrs["source"] == "v.nc, u.nc"


def test_nemo_at_the_centres_of_its_mesh_is_not_turned(tmp_path):
    """Velocities at the centres are neither averaged nor turned."""
    grid = products.nemo_mesh(land=())
    dataset = products.nemo(grid, "t", "uo", 1.0).rename(deptht="depth").isel(depth=0, drop=True)
    u, v = products.numbers()
    dataset["uo"], dataset["vo"] = (dataset.uo.dims, u), (dataset.uo.dims, v)
    reads(open_currents(dataset, grid=grid), u, v)


def test_nemo_without_its_mesh_or_with_another_is_refused(tmp_path):
    files, mesh_file, _, mesh = nemo(tmp_path)
    with pytest.raises(ValueError, match=r"vozocrtx: on the sides of the cells of NEMO.*glamt"):
        open_currents(files)
    with pytest.raises(ValueError, match="variables: no velocity found; the file has vozocrtx"):
        open_currents(files[0], grid=mesh_file)
    other = write(tmp_path, mesh.isel(x=slice(1, None)), "other.nc")
    with pytest.raises(ValueError, match=r"other.nc: x: expected the length 6 of .*v.nc, got 5"):
        open_currents(files, grid=other)
    deep = products.nemo_mesh(levels=4).assign(nav_lev=("z", [5.0, 9.0, 15.0, 40.0]))
    currents = open_currents(files, grid=deep)
    np.testing.assert_array_equal(currents.water, deep.tmask.values[0, [0, 2]])
    with pytest.raises(ValueError, match=r"mask: expected the 2 levels of depthu, got 4 \(z\)"):
        open_currents(files, grid=deep.assign(nav_lev=("z", [5.0, 9.0, 25.0, 40.0])))


@pytest.mark.parametrize(("pivot", "repeated"), [("F", 1), ("T", 2)])
def test_the_northern_fold_is_closed(tmp_path, pivot, repeated):
    currents = open_currents(write(tmp_path, products.tripolar(pivot)))
    water = currents.water.values[0]
    assert not water[-repeated:].any()
    assert water[:-repeated].all()
    assert f"folded in the North; {repeated} rows there repeat" in currents.attrs["notes"]
    u, _ = products.numbers(1, 6, 12)
    np.testing.assert_array_equal(currents.u[0, 0, :-repeated], u[0, :-repeated])
