"""Files of grids that go round the Earth, however they begin and end."""

import numpy as np
import pytest
import xarray as xr
from drift import products

from jaxcell.currents.sphere import overlapping_columns
from jaxcell.drift import Water, open_currents


ROWS, COLUMNS = 4, 12
RADIUS = 6371000.0
LAT = np.array([-50.0, -20, 20, 60])


def flat(lon, u=None):
    """A file on longitudes and latitudes; the current tells the longitude and the row."""
    lon = np.asarray(lon, float)
    u = 0.001 * (lon % 360) + np.arange(ROWS)[:, None] if u is None else u
    return products.regular(values=(u, -0.25), lon=lon, lat=LAT, time=products.hours(count=1))


ROUND = np.arange(0, 360, 30.0)
STRETCHED = np.array([0, 20, 42, 66, 92, 120, 150, 182, 216, 252, 288, 324.0])


@pytest.mark.parametrize("lon", [ROUND, ROUND - 180, np.roll(ROUND, 5), ROUND + 13.7, STRETCHED])
@pytest.mark.parametrize("again", [0, 1, 2])
def test_a_grid_without_a_gap_goes_round_the_earth(lon, again):
    whole = np.concatenate([lon, lon[:again] + (360 if again == 1 else 0)])
    currents = open_currents(flat(whole))
    assert currents.sizes["x"] == COLUMNS
    water = Water.of(currents)
    assert water.wraps
    assert "goes round the Earth" in currents.attrs["notes"]
    if again:
        columns = "a column" if again == 1 else "2 columns"
        assert f"{columns} at the end repeated the first; left out" in currents.attrs["notes"]
    np.testing.assert_allclose(currents.u[0, 0, 2], 0.001 * (currents.lon[2] % 360) + 2, atol=1e-12)
    # A cell reaches half way to its neighbours, across the seam too.
    lon = currents.lon.values[0]
    width = ((np.roll(lon, -1) - lon) % 360 + (lon - np.roll(lon, 1)) % 360) / 2
    side = RADIUS * np.radians(width) * np.cos(np.radians(LAT))[:, None]
    np.testing.assert_allclose(currents.dx, side, rtol=1e-12)


def test_four_repeated_columns_are_found():
    lon, lat = np.meshgrid([0.0, 90, 180, 270] * 2, LAT)
    assert overlapping_columns(lon, lat) == 4


def test_packed_longitudes_go_round_the_earth():
    lon = np.arange(0, 360.1, 1 / 12).astype(np.float32)
    u = np.zeros((ROWS, lon.size))
    currents = open_currents(flat(lon, u))
    assert Water.of(currents).wraps
    assert currents.sizes["x"] == 12 * 360


@pytest.mark.parametrize("lon", [ROUND[:-1], ROUND[:-2], ROUND / 2, np.arange(COLUMNS) * 0.01])
def test_a_grid_with_a_gap_does_not_go_round(lon):
    currents = open_currents(flat(lon))
    assert not Water.of(currents).wraps
    assert "Earth" not in currents.attrs["notes"]


def test_more_than_a_turn_is_refused_unless_it_repeats():
    with pytest.raises(ValueError, match="expected less than a turn, got 0 to 370"):
        open_currents(flat([*ROUND, 370]))


def test_a_part_of_the_globe_across_its_seam_is_in_order():
    currents = open_currents(flat(ROUND), bounds=(145, -60, -85, 70))
    np.testing.assert_allclose(currents.lon[0], [150, -180, -150, -120, -90])
    np.testing.assert_allclose(currents.u[0, 0, 1], 0.001 * (currents.lon[1] % 360) + 1)
    assert not Water.of(currents).wraps
    whole = open_currents(flat(ROUND), bounds=(-180, -60, 180, 30))
    assert Water.of(whole).wraps


def native(again):
    """A file of ROMS round the Earth whose first columns come again at the end.

    On the eastern side of a cell the current along x is a tenth of the number of its column.
    """
    column = np.arange(COLUMNS + again)
    lon = np.broadcast_to(30.0 * column, (ROWS, column.size))
    lat = np.broadcast_to(LAT[:, None], lon.shape)
    east = np.broadcast_to(0.1 * (column[:-1] % COLUMNS), (ROWS, column.size - 1))
    return xr.Dataset(
        {
            "lon_rho": (("eta_rho", "xi_rho"), lon),
            "lat_rho": (("eta_rho", "xi_rho"), lat),
            "u": (("eta_u", "xi_u"), east),
            "v": (("eta_v", "xi_v"), np.zeros((ROWS - 1, column.size))),
            "mask_rho": (("eta_rho", "xi_rho"), np.ones(lon.shape)),
        }
    )


@pytest.mark.parametrize("again", [1, 2, 3])
def test_sides_of_cells_are_averaged_across_the_seam(again):
    currents = open_currents(native(again))
    assert currents.sizes["x"] == COLUMNS
    assert Water.of(currents).wraps
    assert "left out" in currents.attrs["notes"]
    column = np.rint(currents.lon.values[1] % 360 / 30).astype(int)
    assert sorted(column.tolist()) == list(range(COLUMNS))
    expected = 0.05 * (column + (column - 1) % COLUMNS)
    # The rows of this grid are parallels, along which a straight line points a little aside.
    np.testing.assert_allclose(currents.u[0, 0, 1], expected, atol=1e-9)
    assert float(np.ptp(currents.dx.values[1])) < 1e-6


def test_bounds_cut_a_curved_grid():
    currents = open_currents(native(2), bounds=(80, -90, 190, 90))
    np.testing.assert_allclose(currents.lon[0], [90, 120, 150, -180], atol=1e-9)
    np.testing.assert_allclose(currents.u[0, 0, 0], [0.25, 0.35, 0.45, 0.55], atol=1e-9)
    assert not Water.of(currents).wraps
