"""Real files of currents, in the folder that JAXCELL_OCEAN_FILES names; skipped without them."""

import os
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from drift.products import refused

from jaxcell.drift import open_currents


def real(name):
    folder = os.environ.get("JAXCELL_OCEAN_FILES")
    if not folder or not (Path(folder) / name).is_file():
        pytest.skip(f"JAXCELL_OCEAN_FILES names no folder with {name}")
    return Path(folder) / name


# Values that other programs read: the cells of water, and u and v at layers, rows and columns.
REAL = {
    "nordic4km_roms_native_s.nc": (
        466, ([0, 0, 0], [10, 15, 18], [5, 10, 3]),
        [0.17056, -0.08927, -0.16010], [0.13010, 0.13896, -0.02706]),
    "norkyst800m_roms_zlevel.nc": (
        None, (range(6), [5] * 6, [8] * 6),
        [0.133, 0.114, 0.099, 0.088, 0.073, 0.061], [-0.001, 0.005, 0.011, 0.016, 0.022, 0.028]),
    "wcofs4km_roms_surface_cgrid.nc": (1849, ([0], [30], [10]), [0.10539], [-0.16569]),
}  # fmt: skip


@pytest.mark.parametrize("name", REAL)
def test_real_files_are_read_as_by_other_programs(name):
    water, (layers, rows, columns), east, north = REAL[name]
    currents = open_currents(real(name), time=0)
    count = int(currents.water.sum())
    assert count == (currents.water.size if water is None else water)
    places = list(layers), rows, columns
    np.testing.assert_allclose(currents.u[0].values[places], east, atol=1e-4)
    np.testing.assert_allclose(currents.v[0].values[places], north, atol=1e-4)
    if "nordic" in name:
        np.testing.assert_allclose(currents.dx, 4120, rtol=5e-3)
    elif "norkyst" in name:
        np.testing.assert_array_equal(currents.depth, [0, 1, 2, 3, 5, 7])
    else:
        assert float(np.degrees(currents.angle[30, 10])) == pytest.approx(16.432, abs=1e-3)


def test_damage_to_a_real_file_is_refused_or_repaired(tmp_path):
    """The same file with its lowest level only, its mask exchanged, or its angle in degrees."""
    path = tmp_path / "nordic.nc"
    with xr.open_dataset(real("nordic4km_roms_native_s.nc"), decode_times=False) as whole:
        whole = whole.isel(ocean_time=[0]).load().drop_encoding()
    whole.isel(s_rho=slice(0, 1)).to_netcdf(path)
    refused(path, r"depths: 0 m below the surface is \d+ m away from")
    whole.assign(mask_rho=1 - whole.mask_rho).to_netcdf(path)
    refused(path, r"mask_rho, mask_u, mask_v: none of the 185 cells .* of the 466 that are land")
    whole.assign(angle=np.degrees(whole.angle)).to_netcdf(path)
    currents = open_currents(path)
    assert float(currents.u[0, 0, 10, 5]) == pytest.approx(0.17056, abs=1e-4)
    assert float(currents.v[0, 0, 10, 5]) == pytest.approx(0.13010, abs=1e-4)
