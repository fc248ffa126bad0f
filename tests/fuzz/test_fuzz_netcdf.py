"""Damaged NetCDF files: currents, targets, and files for `jaxcell doctor`.

Wrong bytes of a file of version 4 may crash the HDF5 library itself, which no reader can prevent.
So all files are read in another process.
"""

import copy
import functools

import netCDF4
import numpy as np
import pytest
import xarray as xr
from drift import products
from hypothesis import given, strategies as st
from mutations import cases, damaged, place
from netcdf_worker import Worker


@pytest.fixture(scope="module")
def worker():
    process = Worker()
    yield process
    process.close()


def roms():
    """Currents on the sides of cells, with levels that follow the sea bed."""
    return products.croco(products.island(), levels=3)


def mitgcm():
    """Currents on the western and southern sides of cells, with gaps."""
    u = np.full((2, 3, 4, 5), 0.1)
    u[:, :, 1, 2] = np.nan
    return xr.Dataset(
        {
            "UVEL": (("time", "Z", "YC", "XG"), u, {"units": "m/s"}),
            "VVEL": (("time", "Z", "YG", "XC"), np.full((2, 3, 4, 5), 0.2)),
            "hFacC": (("Z", "YC", "XC"), np.full((3, 4, 5), 0.5)),
            "time": ("time", [0, 3600], {"units": "seconds since 2016-02-02"}),
            "Z": ("Z", [-5.0, -15.0, -30.0], {"units": "m", "positive": "up"}),
            "XC": ("XC", -118 + 0.01 * np.arange(5), {"units": "degrees_east"}),
            "YC": ("YC", 33 + 0.01 * np.arange(4), {"units": "degrees_north"}),
        }
    )


def content_of(dataset):
    """The content of a file, in which errors can be made."""
    variables = {
        name: {"dims": [*one.dims], "values": one.values, "dtype": "f8", "attributes": one.attrs}
        for name, one in dataset.variables.items()
    }
    attributes = {"title": "x", **dataset.attrs}
    return {"dims": dict(dataset.sizes), "attributes": attributes, "variables": variables}


WORTH = np.arange(6.0)
PLACES = {"x": [0.5, 1.5, 2.5], "y": [0.5, 1.5]}
CURRENTS = products.regular(
    depth=[0.0, 5.0], time=products.hours(count=2), lon=products.LON[:4], lat=products.LAT[:3]
)
TARGET = xr.Dataset({"worth": (("y", "x"), WORTH.reshape(2, 3))}, PLACES)
TARGET_OF_POSITIONS = xr.Dataset({"worth": ("position", WORTH)})
FILES = {
    "currents": [*map(content_of, (CURRENTS, roms(), mitgcm()))],
    "target": [*map(content_of, (TARGET, TARGET_OF_POSITIONS))],
    "doctor": [*map(content_of, (CURRENTS, TARGET))],
}
readers = pytest.mark.parametrize("reader", FILES)


def write(path, described, form="NETCDF4"):
    """Writes a file, without values that do not fit, as a lazy writer would."""
    path.unlink(missing_ok=True)
    with netCDF4.Dataset(path, "w", format=form) as file:
        file.set_auto_mask(False)
        file.setncatts(described["attributes"])
        for name, size in described["dims"].items():
            file.createDimension(name, size)
        for name, field in described["variables"].items():
            attributes, kind = dict(field["attributes"]), field["dtype"]
            options = {"fill_value": attributes.pop("_FillValue", None)}
            sizes = [described["dims"][dim] for dim in field["dims"]]
            if form == "NETCDF4" and sizes:
                # Chunks are large enough that the library does not handle millions of them.
                options["chunksizes"] = [min(size, 64) or 1 for size in sizes]
            kind = str if kind == "str" else kind
            made = file.createVariable(name, kind, field["dims"], **options)
            made.set_auto_maskandscale(False)
            made.setncatts(attributes)
            values = np.asarray(field["values"])
            if list(values.shape) == sizes and kind not in (str, "S1"):
                with np.errstate(all="ignore"):
                    made[...] = values.astype(kind)


_ATTRIBUTES = {
    "units": [
        *("", "m", "degrees_north", "degrees_east", "radians", "hours", "cm s-1", "s", "\0", "é\n"),
        *("days since 0000-00-00", "hours since 2011-07-01", "seconds since", "x" * 5000),
        *("months since 2000-01-01", "seconds since 1e999-01-01"),
        "seconds since 2011-07-01 25:61:61",
    ],
    "calendar": ["julian", "360_day", "none", "", "x"],
    "standard_name": [
        *("eastward_sea_water_velocity", "northward_sea_water_velocity", "time", "latitude"),
        *("", "x"),
    ],
    "positive": ["up", "down", ""],
    "_FillValue": [0.0, np.nan, -9999.0, 1.0],
    "missing_value": [0.0, [0.0, 1.0], "x", np.nan],
    "scale_factor": [0.0, 1e300, np.nan, np.inf, "x", [1.0, 2.0], -1.0],
    "add_offset": [1e300, np.nan, "x", 7],
    "coordinates": ["lon lat", "x", "u v", ""],
    "axis": ["X", "Y", "Z", "T", ""],
    "valid_range": [[0.0, 0.0], "x"],
    "scale": ["x"],
}
_NUMBERS = [0, 1, -1, 11, 89, 91, 361, -9999, 1e20, 1e300, 5e-324, np.nan, np.inf, -np.inf]
_SIZES = [0, 1, 2, 3, 5, 1000, 10**6, 10**9, 2**31 + 5, 10**12]
_KINDS = [
    *("value", "value", "all", "attribute", "attribute", "drop", "rename", "order", "dims"),
    *("dtype", "size", "reverse", "global", "bare"),
]


@st.composite
def changed(draw, described):
    """A description of a file with some errors."""
    described = copy.deepcopy(described)
    variables = described["variables"]

    def one_of(values):
        return draw(st.sampled_from(values))

    for _ in range(draw(st.integers(1, 3))):
        if not variables:
            break
        name, kind = one_of(sorted(variables)), one_of(_KINDS)
        field = variables[name]
        values = np.array(field["values"], float)
        if kind == "value" and values.size:
            values.flat[draw(st.integers(0, values.size - 1))] = one_of(_NUMBERS)
            field["values"] = values
        elif kind == "all":
            field["values"] = np.full(values.shape, float(one_of(_NUMBERS)))
        elif kind == "reverse":
            field["values"] = values[::-1] if values.ndim else values
        elif kind == "attribute":
            key = one_of(sorted(_ATTRIBUTES))
            other = st.text(max_size=5) if key == "units" else st.nothing()
            field["attributes"][key] = draw(st.sampled_from(_ATTRIBUTES[key]) | other)
        elif kind == "bare":
            field["attributes"] = {}
        elif kind == "drop":
            del variables[name]
        elif kind == "rename":
            others = ["x", "u2", "lon", "lat", "depth", "mask_rho", "h", "zeta", "hc", "u_eastward"]
            variables[one_of(others)] = variables.pop(name)
        elif kind == "order":
            places = draw(st.permutations(range(len(field["dims"]))))
            field["dims"] = [field["dims"][place] for place in places]
            field["values"] = values.transpose(places) if values.ndim == len(places) else values
        elif kind == "dims":
            names = st.sampled_from(sorted(described["dims"]))
            field["dims"] = draw(st.lists(names, max_size=4))
        elif kind == "dtype":
            field["dtype"] = one_of(["i1", "u8", "f4", "S1", "str", "i2"])
        elif kind == "size":
            described["dims"][one_of(sorted(described["dims"]))] = one_of(_SIZES)
        elif described["attributes"]:
            key = one_of(sorted(described["attributes"]))
            described["attributes"][key] = one_of(
                ["", "x", 0, -1.5, [1, 2], "[" * 50_000, "{", "é"]
            )
    return described


@readers
@cases(50)
@given(data=st.data())
def test_files_with_errors_are_read_or_refused(tmp_path, worker, reader, data):
    described = data.draw(st.one_of(map(changed, FILES[reader])))
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
    """A function that returns the bytes of the undamaged files of a reader."""
    path = tmp_path_factory.mktemp("corpus") / "f.nc"

    @functools.cache
    def contents(reader, form):
        files = {}
        for number, described in enumerate(FILES[reader]):
            write(path, described, form)
            files[f"{number}.nc"] = path.read_bytes()
        return files

    return contents


@readers
@pytest.mark.parametrize("form", ["NETCDF4", "NETCDF3_CLASSIC"])
@cases(50)
@given(data=st.data())
def test_damaged_files_are_read_or_refused(tmp_path, worker, reader, form, corpus, data):
    _, content = data.draw(damaged(corpus(reader, form)))
    outcome = worker(reader, place(tmp_path, "f.nc", content))
    # The C library of version 4 may crash; see above.
    assert outcome in ("read", "refused") or (form == "NETCDF4" and "with status -" in outcome)


@pytest.mark.parametrize(
    ("number", "name", "change"),
    [(1, "pm", {"values": np.full((7, 9), 5e-324)}), (2, "hFacC", {"dtype": "S1"})],
)
def test_cells_without_a_side_and_a_mask_of_letters_are_refused(
    tmp_path, worker, number, name, change
):
    described = copy.deepcopy(FILES["currents"][number])
    described["variables"][name] |= change
    write(tmp_path / "f.nc", described)
    assert worker("currents", tmp_path / "f.nc") == "refused"


@readers
def test_undamaged_files_are_read(tmp_path, worker, reader, corpus):
    for content in corpus(reader, "NETCDF4").values():
        assert worker(reader, place(tmp_path, "f.nc", content)) == "read"
