"""MITgcm and ECCO, and layouts that are refused with a way out."""

import numpy as np
import pytest
import xarray as xr
from drift import products
from drift.products import refused

from jaxcell.drift import Water, open_currents


ROWS, COLUMNS = 4, 5


def sides(layout):
    """Velocities that tell row and column on the western and southern sides, and their centres."""
    y, x, y_side, x_side, more = {
        "diagnostics": ("YC", "XC", "YG", "XG", 0),
        "ecco": ("j", "i", "j_g", "i_g", 0),
        "mnc": ("Y", "X", "Yp1", "Xp1", 1),
    }[layout]
    row, column = np.indices((ROWS, COLUMNS + more))
    u = (row + 10 * column)[None, None] / 100
    row, column = np.indices((ROWS + more, COLUMNS))
    v = (100 * row + column)[None, None] / 1000
    depth = "k" if layout == "ecco" else "Z"
    names = ("U", "V") if layout == "mnc" else ("UVEL", "VVEL")
    lon, lat = 200 + 0.5 * np.arange(COLUMNS), 10 + 0.5 * np.arange(ROWS)
    mask = np.ones((1, ROWS, COLUMNS))
    mask[0, 0, 0] = 0
    data = {
        names[0]: (("time", depth, y, x_side), u, {"units": "m/s"}),
        names[1]: (("time", depth, y_side, x), v, {"units": "m/s"}),
        "hFacC": ((depth, y, x), 0.3 * mask),
        "Z": ((depth,), [-5.0], {"units": "m", "positive": "up"}),
        "time": (("time",), [0.0], {"units": "hours since 2000-01-01"}),
    }
    if layout == "ecco":
        both = np.meshgrid(lon, lat)
        data |= {"XC": ((y, x), both[0]), "YC": ((y, x), both[1])}
    else:
        data |= {x: ((x,), lon), y: ((y,), lat)}
    return xr.Dataset(data), u[0, 0], v[0, 0], mask[0].astype(bool)


@pytest.mark.parametrize("layout", ["diagnostics", "ecco", "mnc"])
def test_velocities_on_western_and_southern_sides_are_averaged_to_centres(layout):
    file, u, v, wet = sides(layout)
    currents = open_currents(file)
    np.testing.assert_array_equal(currents.water.values[0], wet)
    assert float(currents.depth[0]) == 5.0
    for name, values, axis in (("u", u, 1), ("v", v, 0)):
        inner = values.take(range(1, wet.shape[axis]), axis)
        expected = products.to_centres(inner * products.open_faces(wet)[name], axis)
        got = currents[name].values[0, 0]
        # The grid is turned by the angle between its centres, which is not quite 0 at the edge.
        np.testing.assert_allclose(got[wet], expected[wet], atol=1e-3)
    assert "XC" not in currents
    assert not Water.of(currents).wraps


def test_a_grid_of_mitgcm_round_the_earth_has_the_side_at_the_seam():
    columns = 12
    lon, lat = 30.0 * np.arange(columns), 10.0 + np.arange(3)
    u = np.broadcast_to(np.arange(columns) / 10.0, (3, columns))
    file = xr.Dataset(
        {
            "UVEL": (("YC", "XG"), u, {"units": "m/s"}),
            "VVEL": (("YG", "XC"), 0 * u, {"units": "m/s"}),
            "XC": (("XC",), lon), "YC": (("YC",), lat),
        }
    )  # fmt: skip
    currents = open_currents(file)
    assert Water.of(currents).wraps
    expected = (u[0] + np.roll(u[0], -1)) / 2
    np.testing.assert_allclose(currents.u.values[0, 0, 1], expected)


def llc():
    dims = ("tile", "j", "i_g"), ("tile", "j_g", "i")
    values = np.zeros((13, 3, 3))
    place = dict.fromkeys(("XC", "YC"), (("tile", "j", "i"), values))
    return xr.Dataset({"UVEL": (dims[0], values), "VVEL": (dims[1], values), **place})


UNSTRUCTURED = r"on an unstructured grid \(.*griddata"


def unknown():
    return xr.Dataset({"a": (("y", "x"), np.zeros((3, 3))), "b": (("y", "x"), np.zeros((3, 3)))})


@pytest.mark.parametrize(
    ("made", "message"),
    [
        (llc(), r"UVEL: on 13 faces \(tile\).*dataset.isel\(tile=0\).*EVEL and NVEL"),
        (products.fvcom(), UNSTRUCTURED),
        (products.schism(), UNSTRUCTURED),
        (products.schism().drop_vars("SCHISM_hgrid"), UNSTRUCTURED),
        (products.schism().rename(hvel="u").assign(v=lambda d: d.u), UNSTRUCTURED),
        (unknown(), r"no velocity found; the file has a, b; .*--variables U V"),
    ],
)
def test_other_layouts_are_refused_with_a_way_out(made, message):
    refused(made, message)


def test_positions_in_metres_are_refused():
    file, *_ = sides("diagnostics")
    file["XC"].attrs["units"] = "m"
    refused(file, "expected longitudes and latitudes of its cells")


@pytest.mark.parametrize("turned", [False, True])
def test_longitudes_with_a_hole_begin_after_it(turned):
    lon = np.array([0.0, 1.0, 2.0, 357.0, 358.0, 359.0])
    lon = lon[::-1] if turned else lon
    currents = open_currents(products.regular(values=(lon / 1000, 0), lon=lon, lat=[1.0, 2, 3]))
    np.testing.assert_array_equal(currents.lon[0], [-3, -2, -1, 0, 1, 2])
    np.testing.assert_allclose(currents.u.values[0, 0, 0] * 1000, [357, 358, 359, 0, 1, 2])
    np.testing.assert_allclose(currents.dx[0], currents.dx[0, 0], rtol=1e-3)


def test_declared_radians_are_radians():
    file = products.regular(lon=np.radians([10.0, 11, 12, 13]), lat=np.radians([40.0, 41, 42]))
    file.longitude.attrs["units"] = file.latitude.attrs["units"] = "radians"
    np.testing.assert_allclose(open_currents(file).lon[0], [10, 11, 12, 13])
