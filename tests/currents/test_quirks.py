"""Small files of currents, each with one quirk of real files, and what a correct reader says.

All have the same current, known to the last digit, or are refused in a sentence with an option that
opens them.
"""

import warnings
from pathlib import Path

import netCDF4
import numpy as np
import pytest
import xarray as xr
from drift.products import COLUMNS, LAT, LON, RECORDS, ROWS, hours, numbers, regular

from jaxcell.base.doubts import Doubt
from jaxcell.drift import open_currents


U, V = numbers()
FLAT = ("time", "latitude", "longitude")
POSITIONS = dict(zip(("lon", "lat"), np.meshgrid(LON, LAT), strict=True))
HOURS = np.datetime64("2020-01-01") + np.arange(RECORDS) * np.timedelta64(1, "h")


def dated(values, units, expected=None, **about):
    """A file with these times, and the dates that they mean."""
    file = regular(time=(np.asarray(values), {"units": units, **about}))
    return file, {}, HOURS if expected is None else np.array(expected, "datetime64[ns]")


def in_units(units, factor):
    return named(regular(values=(U / factor, V / factor)), units=units)


def named(file, **about):
    """The file with these attributes of its velocities."""
    for name in ("uo", "vo"):
        file[name].attrs |= about
    return file


def at_depths(depths):
    return regular(values=(U[:, None], V[:, None]), depth=depths)


def polar(toward=True, radians=False, speed="sea_water_speed"):
    angle = np.arctan2(U, V) + (0 if toward else np.pi)
    way = "to" if toward else "from"
    about = {"standard_name": f"sea_water_velocity_{way}_direction"}
    about["units"] = "radian" if radians else "degree"
    file = regular()
    fields = {
        "s": (FLAT, np.hypot(U, V), {"standard_name": speed, "units": "m s-1"}),
        "d": (FLAT, angle if radians else np.degrees(angle) % 360, about),
    }
    return xr.Dataset(fields, file.coords)


def on_rows(names=("lon", "lat"), dims=("y", "x"), **about):
    """Velocities on rows and columns, with positions of two dimensions."""
    file = regular(dims=("time", *dims)).drop_vars(dims)
    places = zip(names, POSITIONS.values(), strict=True)
    for (name, values), word in zip(places, ("east", "north"), strict=True):
        file[name] = dims, values.copy(), {"units": f"degrees_{word}"}
    return named(file, **about)


def pop(**kept):
    file = on_rows(("ULONG", "ULAT"), ("nlat", "nlon"), units="centimeter/s")
    file = file.assign(uo=100 * file.uo, vo=100 * file.vo, **kept)
    for name in ("uo", "vo"):
        file[name].attrs |= {"coordinates": "ULONG ULAT time", "units": "centimeter/s"}
    for name in ("ULONG", "ULAT"):
        file[f"T{name[1:]}"] = file[name] - 0.125
    return file.rename(uo="UVEL", vo="VVEL")


def unknown_axes():
    return on_rows(dims=("row", "col")).rename(time="when").drop_vars("when")


def mom6(symmetric):
    """Speeds that grow along their axis: from 0.1 at the first face, by 0.01 a cell."""
    more = int(symmetric)
    u = np.zeros((RECORDS, ROWS, COLUMNS + more)) + 0.1 + 0.01 * np.arange(COLUMNS + more)
    v = np.zeros((RECORDS, ROWS + more, COLUMNS)) + 0.1 + 0.01 * np.arange(ROWS + more)[:, None]
    named = "sea_water_{}_velocity"
    data = {
        "uo": (("time", "yh", "xq"), u, {"standard_name": named.format("x"), "units": "m s-1"}),
        "vo": (("time", "yq", "xh"), v, {"standard_name": named.format("y"), "units": "m s-1"}),
        "geolon": (("yh", "xh"), POSITIONS["lon"]),
        "geolat": (("yh", "xh"), POSITIONS["lat"]),
    }
    return xr.Dataset(data, {"time": ("time", *hours())})


# A file, the options that it needs, and the dates of its records.
READ = {
    # Times: how many files count and spell them.
    "hours": dated([0, 1, 2], "hours since 2020-01-01"),
    "hrs": dated([0, 1, 2], "hrs since 2020-01-01"),
    "seconds": dated([0, 3600, 7200], "seconds since 2020-01-01T00:00:00Z"),
    "one-digit date": dated([0, 1, 2], "hours since 2020-1-1 0:0:0"),
    "proleptic": dated([0, 1, 2], "hours since 2020-01-01", calendar="gregorian_proleptic"),
    "Gregorian": dated([0, 1, 2], "hours since 2020-01-01", calendar="Gregorian"),
    "empty calendar": dated([0, 1, 2], "hours since 2020-01-01", calendar=""),
    "365 days": dated([0, 59, 60], "days since 2020-01-01",
                      ["2020-01-01", "2020-02-29", "2020-03-01"], calendar="365_days"),
    "no-leap": dated([0, 59, 60], "days since 2020-01-01",
                     ["2020-01-01", "2020-02-29", "2020-03-01"], calendar="no-leap"),
    "months": dated([0, 1, 2], "months since 1960-01-01",
                    ["1960-01-01", "1960-02-01", "1960-03-01"]),
    "half months": dated([0.5, 1.5, 2.5], "months since 1960-01-01",
                         ["1960-01-16T12", "1960-02-15T12", "1960-03-16T12"]),
    "months of 30 days": dated([0.5, 1.5, 2.5], "months since 1960-01-01",
                               ["1960-01-16", "1960-02-15", "1960-03-16"], calendar="360"),
    "years": dated([0, 1, 2], "years since 2000-01-01", ["2000-01-01", "2001-01-01", "2002-01-01"]),
    "digits": dated([20200101.0, 20200101.5, 20200102.0], "day as %Y%m%d.%f",
                    ["2020-01-01", "2020-01-01T12", "2020-01-02"]),
    "YYYYMMDD": dated([20200131, 20200201, 20200202], "YYYYMMDD",
                      ["2020-01-31", "2020-02-01", "2020-02-02"]),
    "year 0": dated([0, 1, 2], "days since 0000-01-01",
                    ["1970-01-01", "1970-01-02", "1970-01-03"], calendar="noleap"),
    "year 0, standard": dated([0, 1, 2], "days since 0000-01-01",
                              ["1970-01-01", "1970-01-02", "1970-01-03"]),
    "year 1": dated([0, 3600, 7200], "seconds since 1-1-1 00:00:00",
                    ["1970-01-01T00", "1970-01-01T01", "1970-01-01T02"]),
    # Units of speed.
    "cm": (in_units("cm/s", 0.01), {}, HOURS),
    "cm s**-1": (in_units("cm s**-1", 0.01), {}, HOURS),
    "cm s-1 in superscript": (in_units("cm s⁻¹", 0.01), {}, HOURS),
    "mm": (in_units("mm s-1", 0.001), {}, HOURS),
    "km an hour": (in_units("km/h", 1 / 3.6), {}, HOURS),
    "m a day": (in_units("m day-1", 1 / 86400), {}, HOURS),
    "knots": (in_units("knots", 1852 / 3600), {}, HOURS),
    "kt": (in_units("kt", 1852 / 3600), {}, HOURS),
    "feet": (in_units("ft/s", 0.3048), {}, HOURS),
    "miles": (in_units("miles per hour", 1609.344 / 3600), {}, HOURS),
    "a factor": (in_units("0.01 m s-1", 0.01), {}, HOURS),
    "metres in words": (in_units("Meters Second-1", 1), {}, HOURS),
    "unknown unit": (in_units("furlongs", 0.01), {"units": "cm/s"}, HOURS),
    # Speeds and directions.
    "direction to": (polar(), {}, HOURS),
    "direction from": (polar(toward=False), {}, HOURS),
    "direction in radians": (polar(radians=True), {}, HOURS),
    "direction asked": (polar(speed=""), {"variables": ("s", "d")}, HOURS),
    # Positions, axes and depths.
    "POP": (pop(), {}, HOURS),
    "axes and positions asked": (
        unknown_axes().rename(lon="P", lat="Q").drop_attrs(),
        {"dims": ("when=time", "row=y", "col=x"), "coords": ("P", "Q"),
         "time_units": "hours since 2020-01-01", "variables": ("uo", "vo")},
        HOURS,
    ),
    "a calendar asked": (
        regular(time=hours(calendar="mayan")), {"calendar": "standard"}, HOURS
    ),
    "a unit of time asked": (
        regular(time=(np.arange(RECORDS), {})), {"time_units": "hours since 2020-01-01"}, HOURS
    ),
    "a level without a depth": (
        at_depths([0.0]).drop_vars("depth").rename(depth="k"), {}, HOURS
    ),
    "depths in centimetres": (
        at_depths([500.0]).assign_coords(depth=("depth", [500.0], {"units": "centimeters"})),
        {"depths": 5}, HOURS,
    ),
}  # fmt: skip


@pytest.mark.parametrize("quirk", READ)
def test_files_with_a_quirk_are_read(quirk, tmp_path):
    file, choice, dates = READ[quirk]
    encoding = {name: {"_FillValue": None} for name in file.variables}
    file.to_netcdf(tmp_path / "quirk.nc", encoding=encoding)
    currents = open_currents(tmp_path / "quirk.nc", **choice)
    assert currents.time.values.tolist() == dates.astype("datetime64[ns]").tolist()
    east, north = currents.u.values[:, 0], currents.v.values[:, 0]
    if quirk == "POP":  # along a grid whose rows are not quite parallels
        np.testing.assert_allclose(np.hypot(east, north), np.hypot(U, V), rtol=1e-9)
        np.testing.assert_allclose(currents.lon, POSITIONS["lon"])
    else:
        np.testing.assert_allclose([east, north], [U, V], rtol=1e-9, atol=1e-12)


# A file, the words of its refusal, and the option that they name, which opens it.
REFUSED = {
    "dims": (unknown_axes(), "--dims when=AXIS", {
        "dims": ("when=time", "row=y", "col=x"), "time_units": "hours since 2020-01-01",
        "variables": ("uo", "vo"),
    }),
    "coords": (
        on_rows(("P", "Q")).drop_attrs(),
        "--coords LON LAT", {"coords": ("P", "Q"), "time_units": "hours since 2020-01-01",
         "variables": ("uo", "vo")},
    ),
    "depths": (
        at_depths([0.0, 5.0]).drop_vars("depth").assign(d=("depth", [0.0, 5.0])),
        "--coords LON LAT DEPTH", {"coords": ("longitude", "latitude", "d")},
    ),
    "time_units": (regular(time=(np.arange(3), {"units": "moons"})), "--time-units",
                   {"time_units": "hours since 2020-01-01"}),
    "no times": (regular().drop_vars("time"), "--time-units",
                 {"time_units": "hours since 2020-01-01"}),
    "calendar": (regular(time=hours(calendar="mayan")), "--calendar standard",
                 {"calendar": "standard"}),
    "units": (in_units("furlongs", 1), "--units cm/s", {"units": "m/s"}),
    "variables": (regular("p", "q"), "--variables U V", {"variables": ("p", "q")}),
}  # fmt: skip


@pytest.mark.parametrize("quirk", REFUSED)
def test_a_refusal_names_the_option_that_opens_the_file(quirk, tmp_path):
    file, words, choice = REFUSED[quirk]
    file.to_netcdf(tmp_path / "quirk.nc")
    with pytest.raises(ValueError, match=r"quirk\.nc") as caught:
        open_currents(tmp_path / "quirk.nc")
    assert words in str(caught.value)
    assert "decode" not in str(caught.value)
    assert "\n" not in str(caught.value)
    currents = open_currents(tmp_path / "quirk.nc", **choice)
    np.testing.assert_allclose(currents.u[:, 0], U)


@pytest.mark.parametrize("names", [["currents"], ["a", "b"], ["model/surface"]])
def test_groups_are_opened(names, tmp_path):
    path = tmp_path / "groups.nc"
    netCDF4.Dataset(path, "w").close()
    for k, name in enumerate(names):
        regular(values=(U + k, V)).to_netcdf(path, mode="a", group=name)
    if len(names) > 1:
        with pytest.raises(ValueError, match=r"groups a, b, got none; .*--group b"):
            open_currents(path)
    with pytest.raises(ValueError, match=r"got nowhere"):
        open_currents(path, group="nowhere")
    currents = open_currents(path, group=names[-1])
    np.testing.assert_allclose(currents.u[:, 0], U + len(names) - 1)
    if len(names) == 1:
        np.testing.assert_array_equal(open_currents(path).u, currents.u)


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("range", [{"valid_max": 1.0}, {"valid_range": [-1.0, 1.0]}])
def test_values_out_of_the_valid_range_are_left_out(packed, range, tmp_path):
    file = regular()
    file.uo[:, 1, 2] = 5.0
    about = range
    encoding = {}
    if packed:
        encoding = {"uo": {"dtype": "i2", "scale_factor": 0.015625, "_FillValue": np.int16(-999)}}
        about = {key: (np.asarray(v) / 0.015625).astype("i2") for key, v in range.items()}
    file.uo.attrs |= about
    file.to_netcdf(tmp_path / "valid.nc", encoding=encoding)
    with pytest.warns(Doubt, match="sea without data"):
        currents = open_currents(tmp_path / "valid.nc")
    assert not currents.water[0, 1, 2]
    assert int((~currents.water).sum()) == 1
    assert "the valid range, are left out" in currents.notes


@pytest.mark.parametrize("hole", [np.nan, 0.0])
def test_positions_may_have_holes(hole):
    file = on_rows()
    for name in ("lon", "lat"):
        file[name][1:3, :2] = hole
    file.uo[:, 1:3, :2] = np.nan
    with pytest.warns(Doubt, match="4 squares have no position"):
        currents = open_currents(file, variables=("uo", "vo"))
    assert int((~currents.water).sum()) == 4
    whole = open_currents(on_rows(), variables=("uo", "vo"))
    water = currents.water.values[0]
    for side in ("dx", "dy"):
        np.testing.assert_allclose(
            currents[side].values[water], whole[side].values[water], rtol=1e-4
        )


@pytest.mark.parametrize("symmetric", [False, True])
def test_mom6_is_averaged_to_centres(symmetric):
    currents = open_currents(mom6(symmetric))
    first = 0.105 if symmetric else 0.095
    speed = np.hypot(currents.u, currents.v).values[0, 0]
    expected = first + 0.01 * np.stack(np.indices((ROWS, COLUMNS)))
    inner = np.s_[1:-1, 1:-1]
    np.testing.assert_allclose(speed[inner], np.hypot(*expected)[inner], rtol=1e-9)


@pytest.mark.parametrize("factor", [1.0, 0.001])
def test_a_plane_has_the_sides_of_its_cells(factor):
    file = regular(dims=("time", "y", "x"), lon=factor * 1000.0 * np.arange(6),
                   lat=factor * 2000.0 * np.arange(5))  # fmt: skip
    for name in ("x", "y"):
        file[name].attrs["units"] = "m" if factor == 1 else "km"
    file.uo[:, 0, 0] = np.nan
    with pytest.warns(Doubt, match=r"on a plane in metres; the middle \(2500, 4000\)"):
        currents = open_currents(file)
    np.testing.assert_allclose(currents.dx, 1000.0)
    np.testing.assert_allclose(currents.dy, 2000.0)
    assert currents.land.values.sum() == 1
    np.testing.assert_allclose(currents.v[:, 0, 1:], V[:, 1:])


@pytest.mark.parametrize("eta", [0.0, 1.5])
def test_sigma_levels_are_shares_of_the_depth(eta):
    """The speed is the share of the depth, which a layer in metres gives back."""
    share = -(np.arange(10) + 0.5) / 10
    file = at_depths(share).rename(depth="sigma")
    for name in ("uo", "vo"):
        file[name][:] = -share[:, None, None]
    terms = "sigma: sigma eta: height depth: floor"
    about = {"standard_name": "ocean_sigma_coordinate", "formula_terms": terms}
    file = file.assign_coords(sigma=("sigma", share, about))
    file["floor"] = FLAT[1:], np.full((ROWS, COLUMNS), 40.0)
    file["height"] = FLAT, np.full((RECORDS, ROWS, COLUMNS), eta)
    currents = open_currents(file, depths=(10, 30))
    for layer, depth in enumerate((10, 30)):
        np.testing.assert_allclose(currents.u[:, layer], depth / (40 + eta))


@pytest.mark.parametrize("mask", ["uo=0", "floor=0", "floor=-1"])
def test_a_mask_is_as_asked(mask):
    file = regular()
    file["floor"] = FLAT[1:], np.where(np.arange(COLUMNS) < 2, 0.0, 40.0) * np.ones((ROWS, 1))
    for name in ("uo", "vo"):
        file[name] = file[name].where(file.longitude > LON[1], 0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", Doubt)
        currents = open_currents(file, mask=mask)
    assert int(currents.land.sum()) == (0 if mask == "floor=-1" else 2 * ROWS)


@pytest.mark.parametrize(
    ("choice", "words"),
    [
        ({"mask": "uo"}, "mask: expected VAR=VALUE"),
        ({"mask": "w=0"}, "mask: 'w' is not in the file"),
        ({"coords": ("longitude",)}, "coords: expected LON LAT"),
        ({"coords": ("longitude", "w")}, "coords: 'w' is not in the file"),
        ({"dims": ("longitude=z",)}, "dims: expected NAME=AXIS"),
        ({"dims": ("w=x",)}, "dims: 'w' is not a dimension"),
    ],
)
def test_wrong_words_are_refused(choice, words):
    with pytest.raises(ValueError, match=words):
        open_currents(regular(), **choice)


def test_equal_variables_of_many_files_are_taken_once(tmp_path):
    whole = regular()
    paths = [tmp_path / f"{k}.nc" for k in range(4)]
    parts = whole.isel(time=[0, 1]), whole.isel(time=[1, 2]), whole[["uo"]], whole
    for part, path in zip(parts, paths, strict=True):
        part.assign(bed=(FLAT[1:], np.full((ROWS, COLUMNS), 9.0))).to_netcdf(path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", Doubt)
        currents = open_currents([*map(Path, paths)])
    np.testing.assert_array_equal(currents.u[:, 0], U)
    np.testing.assert_array_equal(currents.v[:, 0], V)
