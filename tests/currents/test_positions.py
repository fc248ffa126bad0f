"""Turned and curved grids, the angle of a grid in any unit, and rows at the poles."""

import numpy as np
import pytest
import xarray as xr
from drift import products
from drift.products import refused

from jaxcell.drift import open_currents


SEA = np.ones((4, 5), bool)
EAST, NORTH = 0.35, -0.12


def turned(turn_deg, angle, **attributes):
    """A file in which the water goes the same way everywhere, on a grid that is turned."""
    turn = np.radians(turn_deg)
    u = EAST * np.cos(turn) + NORTH * np.sin(turn)
    v = NORTH * np.cos(turn) - EAST * np.sin(turn)
    file = products.croco(SEA, u=u, v=v, turn_deg=turn_deg)
    return file.assign(angle=(products.RHO, np.full(SEA.shape, angle), attributes))


@pytest.mark.parametrize("turn_deg", [21.0, -21.4, 0.4, -1.5, 57.0, 133.0, -179.9, 0.0])
@pytest.mark.parametrize("angle", ["radians", "degrees"])
@pytest.mark.parametrize("units", [{}, {"units": "radians"}, {"units": "degree"}])
def test_the_positions_tell_the_unit_of_the_angle(turn_deg, angle, units):
    """Units in the file have no effect, because some files of radians say degree."""
    values = np.radians(turn_deg) if angle == "radians" else turn_deg
    currents = open_currents(turned(turn_deg, values, **units))
    np.testing.assert_allclose(currents.u, EAST, atol=1e-12)
    np.testing.assert_allclose(currents.v, NORTH, atol=1e-12)
    np.testing.assert_allclose(currents.angle, np.radians(turn_deg), atol=1e-12)
    if turn_deg:
        message = f"turned to East and North by the variable angle, in {angle} as lon_rho and"
        assert message in currents.attrs["notes"]


def test_small_angles_in_declared_radians_are_radians():
    currents = open_currents(turned(0.0, np.radians(2.0), units="radians"))
    np.testing.assert_allclose(currents.angle, np.radians(2.0))
    assert "in radians as the file says" in currents.attrs["notes"]


@pytest.mark.parametrize("off", [-4.0, 4.0])
def test_an_angle_that_is_a_little_off_is_taken(off):
    currents = open_currents(turned(30, np.radians(30 + off)))
    direction = np.degrees(np.arctan2(currents.v, currents.u) - np.arctan2(NORTH, EAST))
    np.testing.assert_allclose(direction, off, atol=1e-9)


@pytest.mark.parametrize(
    ("turn_deg", "values", "off"),
    [
        (30, np.radians(36), r"off by [56]\S* degrees if it is in radians, and by 29\.\d if"),
        (30, np.radians(120), r"off by 9\d\.?\d* degrees if it is in radians, and by 2[78]\S* if"),
        (-30, 30, r"off by \d+\.?\d* degrees if it is in radians, and by 60 if it is in degrees"),
        (170, np.radians(-10), r"off by 180 degrees if it is in radians, and by 170 if"),
    ],
)
def test_an_angle_that_is_not_that_of_the_grid_is_refused(turn_deg, values, off):
    message = "angle: expected .* within 5 degrees of that from lon_rho and lat_rho; .*"
    refused(turned(turn_deg, values), message + off)


def globe(lat, curved=False, wet=True):
    lon = np.arange(0.0, 360, 30)
    flow = np.where(np.broadcast_to(wet, (len(lon), len(lat))).T, 0.1, np.nan)
    time = products.hours(count=1)
    dims = "time", "lat", "lon"
    plain = products.regular(values=(flow, flow), lon=lon, lat=lat, time=time, dims=dims)
    if not curved:
        return plain
    rows = plain.drop_vars(["lat", "lon"]).rename(lat="y", lon="x")
    lon, lat = np.meshgrid(lon, lat)
    return rows.assign(lon=(("y", "x"), lon), lat=(("y", "x"), lat))


@pytest.mark.parametrize("curved", [False, True])
@pytest.mark.parametrize(("lat", "row", "pole"), [([60, 70, 80, 90], 3, 90), ([-90, -80], 0, -90)])
def test_a_row_at_a_pole_is_refused(curved, lat, row, pole):
    file = globe(np.array(lat, float), curved)
    message = rf"lon: the cell at row {row}, column \d has sides of \d\S* and \d\S* m; .*"
    refused(file, rf"{message}the row at latitude {pole} is at a pole: leave it out with bounds")
    if len(lat) > 2:
        rest = open_currents(file, bounds=(-180, 55, 180, 85))
        assert rest.water.all()
        np.testing.assert_array_equal(rest.lat[:, 0], [60, 70, 80])
    wet = np.abs(lat) < 90
    file = globe(np.array(lat, float), curved, wet)
    np.testing.assert_array_equal(open_currents(file).water[0, :, 0], wet)


@pytest.mark.parametrize("step", [10.0, 1 / 12, 1e-3])
def test_cells_that_end_at_a_pole_are_read(step):
    lat = 90 - step * np.array([3.5, 2.5, 1.5, 0.5])
    currents = open_currents(globe(lat))
    side = np.radians(30) * 6371000 * np.sin(np.radians(90 - lat))
    np.testing.assert_allclose(currents.dx[:, 0], side, rtol=1e-6)


def curved(turn_deg, u, v, names=("u_eastward", "v_northward"), mirrored=False):
    """A grid of 1 km cells that is turned by an angle, with 2-D longitudes and latitudes."""
    j, i = np.indices((5, 6))
    if mirrored:
        j = j[::-1]
    lon, lat = products.positions(j, i, 1000, turn_deg, -118, 33.5)
    dims = ("time", "Y", "X")
    return xr.Dataset(
        {
            names[0]: (dims, np.broadcast_to(u, (1, 5, 6)).copy()),
            names[1]: (dims, np.broadcast_to(v, (1, 5, 6)).copy()),
            "lat": (("Y", "X"), lat),
            "lon": (("Y", "X"), lon),
        },
        coords={"time": ("time", [12], {"units": "days since 1970-01-01"})},
    )


@pytest.mark.parametrize("turn_deg", [0, 44, -120, 180])
def test_velocities_on_a_turned_grid(turn_deg):
    angle = np.radians(turn_deg)
    currents = open_currents(curved(turn_deg, 0.3, 0.0))
    np.testing.assert_allclose(np.cos(currents.angle - angle), 1, atol=1e-6)
    np.testing.assert_allclose(currents.dx, 1000, rtol=1e-3)
    np.testing.assert_allclose(currents.dy, 1000, rtol=1e-3)
    assert (currents.u == 0.3).all()
    along = curved(turn_deg, 0.3 * np.cos(angle), -0.3 * np.sin(angle), ("a", "b"))
    along.a.attrs["standard_name"] = "x_sea_water_velocity"
    along.b.attrs["standard_name"] = "y_sea_water_velocity"
    currents = open_currents(along)
    np.testing.assert_allclose(currents.u, 0.3, atol=1e-3)
    np.testing.assert_allclose(currents.v, 0.0, atol=1e-3)
    assert "turned" in currents.attrs["east_from"]
    bare = curved(turn_deg, 0.3, 0.0, ("u", "v"))
    assert (open_currents(bare, variables=("u", "v")).u == 0.3).all()


def test_a_mirrored_grid_is_turned_over():
    j = np.arange(5)[:, None] * 0.01
    straight = open_currents(curved(30, 0.1 + j, 0.0))
    mirrored = open_currents(curved(30, 0.1 + j[::-1], 0.0, mirrored=True))
    xr.testing.assert_allclose(mirrored, straight, atol=1e-6)


def folded(dataset):
    dataset.lon[2, 2] = dataset.lon[2, 5]
    return dataset


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.rename(u_eastward="u", v_northward="v"), r"u: ambiguous: on the dimensions "
         r"\(Y, X\) it may be towards the East or along the grid.*name u and v with variables"),
        (folded, r"lon: .* the grid folds at row"),
        (lambda d: d.assign(lon=0 * d.lon, lat=0 * d.lat), r"lon: the cell .* sides of 0 and 0 m"),
        (lambda d: d.assign(lon=d.lon.where(d.lon > -118)), r"lon: no longitude at row 0, column"),
    ],
)  # fmt: skip
def test_damaged_files_of_a_turned_grid_are_refused(change, message):
    refused(change(curved(30, 0.3, 0.0)), message)
