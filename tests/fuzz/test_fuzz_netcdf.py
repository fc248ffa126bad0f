"""Damaged NetCDF files: currents, targets, and files for `jaxcell info`.

Wrong bytes of a file of version 4 may crash the HDF5 library itself, which no reader can prevent.
So all files are read in another process.
"""

import copy
import functools

import netCDF4
import numpy as np
import pytest
from hypothesis import given, strategies as st
from mutations import cases, damaged
from netcdf_worker import Worker


@pytest.fixture(scope="module")
def worker():
    one = Worker()
    yield one
    one.close()


def variable(dims, values, dtype="f8", **attributes):
    return {"dims": dims, "values": values, "dtype": dtype, "attributes": attributes}


def currents():
    """The components on time, depth, latitude and longitude."""
    t, k, j, i = np.indices((2, 2, 3, 4))
    dims = ("time", "depth", "lat", "lon")
    return {
        "dims": {"time": 2, "depth": 2, "lat": 3, "lon": 4},
        "attributes": {"title": "x"},
        "variables": {
            "time": variable(("time",), [0.0, 1.0], units="hours since 2011-07-01 00:00:00"),
            "depth": variable(("depth",), [0.0, 5.0], units="m", positive="down"),
            "lat": variable(("lat",), 33 + 0.01 * np.arange(3), units="degrees_north"),
            "lon": variable(("lon",), -118 + 0.01 * np.arange(4), units="degrees_east"),
            "u": variable(
                dims, 0.1 + 0.01 * t + 0.001 * j, standard_name="eastward_sea_water_velocity"
            ),
            "v": variable(
                dims, -0.2 + 0.01 * i + 0.01 * k, standard_name="northward_sea_water_velocity"
            ),
        },
    }


def roms():
    """Currents as in ROMS: on the sides of cells, with levels that follow the sea bed."""
    rho, time, s = ("eta_rho", "xi_rho"), ("ocean_time",), ("s_rho",)
    whole = np.ones((4, 5))
    return {
        "dims": {
            **{"ocean_time": 2, "s_rho": 3, "eta_rho": 4, "xi_rho": 5},
            **{"eta_u": 4, "xi_u": 4, "eta_v": 3, "xi_v": 5},
        },
        "attributes": {},
        "variables": {
            "ocean_time": variable(time, [0, 3600], units="seconds since 2016-02-02"),
            "s_rho": variable(s, [-0.8, -0.5, -0.1]),
            "Cs_r": variable(s, [-0.7, -0.4, -0.05]),
            "hc": variable((), 5.0),
            "Vtransform": variable((), 2, "i4"),
            "h": variable(rho, 50 * whole, units="meter"),
            "zeta": variable((*time, *rho), np.zeros((2, 4, 5))),
            "lon_rho": variable(rho, whole * (-118 + 0.01 * np.arange(5))),
            "lat_rho": variable(rho, whole * (33 + 0.01 * np.arange(4))[:, None]),
            "angle": variable(rho, 0 * whole, units="radians"),
            "mask_rho": variable(rho, whole),
            "u": variable((*time, *s, "eta_u", "xi_u"), np.full((2, 3, 4, 4), 0.1)),
            "v": variable((*time, *s, "eta_v", "xi_v"), np.full((2, 3, 3, 5), 0.2)),
        },
    }


def mitgcm():
    """Currents as in MITgcm: on the western and southern sides of cells, with gaps."""
    u = np.full((2, 3, 4, 5), 0.1)
    u[:, :, 1, 2] = np.nan
    return {
        "dims": {"time": 2, "Z": 3, "YC": 4, "XC": 5, "YG": 4, "XG": 5},
        "attributes": {},
        "variables": {
            "time": variable(("time",), [0, 3600], units="seconds since 2016-02-02"),
            "Z": variable(("Z",), [-5.0, -15.0, -30.0], units="m", positive="up"),
            "XC": variable(("XC",), -118 + 0.01 * np.arange(5), units="degrees_east"),
            "YC": variable(("YC",), 33 + 0.01 * np.arange(4), units="degrees_north"),
            "UVEL": variable(("time", "Z", "YC", "XG"), u, units="m/s"),
            "VVEL": variable(("time", "Z", "YG", "XC"), np.full((2, 3, 4, 5), 0.2)),
            "hFacC": variable(("Z", "YC", "XC"), np.full((3, 4, 5), 0.5)),
        },
    }


def target():
    return {
        "dims": {"x": 3, "y": 2},
        "attributes": {},
        "variables": {
            "x": variable(("x",), [0.5, 1.5, 2.5]),
            "y": variable(("y",), [0.5, 1.5]),
            "worth": variable(("y", "x"), np.arange(6.0).reshape(2, 3)),
        },
    }


def target_of_positions():
    return {
        "dims": {"position": 6},
        "attributes": {},
        "variables": {"worth": variable(("position",), np.arange(6.0))},
    }


def write(path, described, form="NETCDF4"):
    """Writes a file; values that do not fit are left out, as a lazy writer would."""
    path.unlink(missing_ok=True)
    with netCDF4.Dataset(path, "w", format=form) as file:
        file.set_auto_mask(False)
        file.setncatts(described["attributes"])
        for name, size in described["dims"].items():
            file.createDimension(name, size)
        for name, one in described["variables"].items():
            attributes = dict(one["attributes"])
            fill = attributes.pop("_FillValue", None)
            dtype = str if one["dtype"] == "str" else one["dtype"]
            sizes = [described["dims"][dim] for dim in one["dims"]]
            # Not so small that the library is busy with millions of them.
            chunks = [min(size, 64) or 1 for size in sizes] if form == "NETCDF4" else None
            made = file.createVariable(
                name, dtype, one["dims"], fill_value=fill, chunksizes=chunks or None
            )
            made.set_auto_maskandscale(False)
            made.setncatts(attributes)
            values = np.asarray(one["values"])
            if list(values.shape) == sizes and one["dtype"] not in ("str", "S1"):
                with np.errstate(all="ignore"):
                    made[...] = values.astype(dtype)


_UNITS = ["", "m", "degrees_north", "degrees_east", "radians", "days since 0000-00-00", "hours"]
_UNITS += [
    "hours since 2011-07-01",
    "seconds since",
    "months since 2000-01-01",
    "cm s-1",
    "s",
    "\0",
]
_UNITS += ["seconds since 1e999-01-01", "seconds since 2011-07-01 25:61:61", "é\n", "x" * 5000]
_ATTRIBUTES = {
    "units": st.sampled_from(_UNITS) | st.text(max_size=5),
    "calendar": st.sampled_from(["julian", "360_day", "none", "", "x"]),
    "standard_name": st.sampled_from(
        ["eastward_sea_water_velocity", "northward_sea_water_velocity", "time", "latitude", "", "x"]
    ),
    "positive": st.sampled_from(["up", "down", ""]),
    "_FillValue": st.sampled_from([0.0, float("nan"), -9999.0, 1.0]),
    "missing_value": st.sampled_from([0.0, [0.0, 1.0], "x", float("nan")]),
    "scale_factor": st.sampled_from(
        [0.0, 1e300, float("nan"), float("inf"), "x", [1.0, 2.0], -1.0]
    ),
    "add_offset": st.sampled_from([1e300, float("nan"), "x", 7]),
    "coordinates": st.sampled_from(["lon lat", "x", "u v", ""]),
    "axis": st.sampled_from(["X", "Y", "Z", "T", ""]),
    "valid_range": st.sampled_from([[0.0, 0.0], "x"]),
    "scale": st.just("x"),
}
_NUMBERS = st.sampled_from(
    [
        *(0.0, 1.0, -1.0, 11.0, 89.0, 91.0, 361.0, -9999.0, 1e20, 1e300, 5e-324),
        *(float("nan"), float("inf"), float("-inf")),
    ]
)
_SIZES = st.sampled_from([0, 1, 2, 3, 5, 1000, 10**6, 10**9, 2**31 + 5, 10**12])


@st.composite
def changed(draw, make):
    """A description of a file with some errors."""
    described = copy.deepcopy(make())
    variables = described["variables"]
    for _ in range(draw(st.integers(1, 3))):
        if not variables:
            break
        name = draw(st.sampled_from(sorted(variables)))
        one = variables[name]
        kind = draw(
            st.sampled_from(["value", "value", "all", "attribute", "attribute", "drop", "rename"])
            | st.sampled_from(["order", "dims", "dtype", "size", "reverse", "global", "bare"])
        )
        values = np.array(one["values"], float)
        if kind == "value" and values.size:
            values.flat[draw(st.integers(0, values.size - 1))] = draw(_NUMBERS)
            one["values"] = values
        elif kind == "all":
            one["values"] = np.full(values.shape, draw(_NUMBERS))
        elif kind == "reverse":
            one["values"] = values[::-1] if values.ndim else values
        elif kind == "attribute":
            key = draw(st.sampled_from(sorted(_ATTRIBUTES)))
            one["attributes"][key] = draw(_ATTRIBUTES[key])
        elif kind == "bare":
            one["attributes"] = {}
        elif kind == "drop":
            del variables[name]
        elif kind == "rename":
            others = ["x", "u2", "lon", "lat", "depth", "mask_rho", "h", "zeta", "hc", "u_eastward"]
            variables[draw(st.sampled_from(others))] = variables.pop(name)
        elif kind == "order":
            places = draw(st.permutations(range(len(one["dims"]))))
            one["dims"] = tuple(one["dims"][place] for place in places)
            one["values"] = values.transpose(places) if values.ndim == len(places) else values
        elif kind == "dims":
            names = st.sampled_from(sorted(described["dims"]))
            one["dims"] = tuple(draw(st.lists(names, max_size=4)))
        elif kind == "dtype":
            one["dtype"] = draw(st.sampled_from(["i1", "u8", "f4", "S1", "str", "i2"]))
        elif kind == "size":
            described["dims"][draw(st.sampled_from(sorted(described["dims"])))] = draw(_SIZES)
        elif described["attributes"]:
            key = draw(st.sampled_from(sorted(described["attributes"])))
            described["attributes"][key] = draw(
                st.sampled_from(["", "x", 0, -1.5, [1, 2], "[" * 50_000, "{", "é"])
            )
    return described


FILES = {
    "currents": [currents, roms, mitgcm],
    "target": [target, target_of_positions],
    "info": [currents, target],
}
readers = pytest.mark.parametrize("reader", FILES)


@readers
@cases(50)
@given(data=st.data())
def test_files_with_errors_are_read_or_refused(tmp_path, worker, reader, data):
    described = data.draw(st.one_of([changed(make) for make in FILES[reader]]))
    form = data.draw(st.sampled_from(["NETCDF4", "NETCDF4", "NETCDF3_CLASSIC"]))
    path = tmp_path / "f.nc"
    huge = np.prod([float(size or 1) for size in described["dims"].values()]) > 1e6
    try:
        # A classic file has its huge arrays on the disk.
        write(path, described, "NETCDF4" if huge else form)
    except (ValueError, TypeError, RuntimeError, AttributeError, KeyError, OverflowError):
        return  # It cannot even be written.
    assert worker(reader, path) in ("read", "refused")


@pytest.fixture(scope="module")
def corpus(tmp_path_factory):
    """Gives the bytes of the undamaged files of a reader."""
    path = tmp_path_factory.mktemp("corpus") / "f.nc"

    @functools.cache
    def contents(reader, form):
        found = {}
        for number, make in enumerate(FILES[reader]):
            write(path, make(), form)
            found[number] = path.read_bytes()
        return found

    return contents


@readers
@pytest.mark.parametrize("form", ["NETCDF4", "NETCDF3_CLASSIC"])
@cases(50)
@given(data=st.data())
def test_damaged_files_are_read_or_refused(tmp_path, worker, reader, form, corpus, data):
    _, content = data.draw(damaged(corpus(reader, form)))
    path = tmp_path / "f.nc"
    path.write_bytes(content)
    found = worker(reader, path)
    if form == "NETCDF4" and "died with status -" in found:
        return  # In the C library; see above.
    assert found in ("read", "refused")


@readers
def test_the_undamaged_ones_are_read(tmp_path, worker, reader):
    for make in FILES[reader]:
        write(tmp_path / "f.nc", make())
        assert worker(reader, tmp_path / "f.nc") == "read"
