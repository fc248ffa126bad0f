"""NetCDF files that are missing, truncated, of other formats, or too large."""

import gc

import netCDF4
import numpy as np
import pytest
import xarray as xr
from drift import products
from drift.products import refused, write

from jaxcell.drift import open_currents


CLASSIC = ["NETCDF3_CLASSIC", "NETCDF3_64BIT_OFFSET"]


def test_missing_files_and_other_formats_are_refused(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"nowhere.nc: there is no such file"):
        open_currents(tmp_path / "nowhere.nc")
    (tmp_path / "sea.nc").write_text("lon,lat,u,v\n")
    refused(tmp_path / "sea.nc", r"cannot be read as NetCDF")


@pytest.mark.parametrize("format", ["NETCDF4", *CLASSIC])
def test_a_truncated_file_is_never_read_as_zeros(tmp_path, format):
    """The library itself reads the lost end of a classic file as zeros."""
    path = write(tmp_path, products.regular(), format=format)
    whole = path.read_bytes()
    rng = np.random.default_rng(1)
    cuts = {0, 1, 3, 4, 8, len(whole) - 1, *rng.integers(0, len(whole), 60).tolist()}
    for cut in sorted(cuts):
        path.write_bytes(whole[:cut])
        with pytest.raises((ValueError, OSError), match=r"sea\.nc"):
            open_currents(path)


@pytest.mark.parametrize("format", CLASSIC)
def test_records_of_a_classic_file_count(tmp_path, format):
    """With an unlimited dimension the values of all variables alternate, padded to words."""
    path = tmp_path / "sea.nc"
    dataset = products.regular().assign(flag=("time", np.arange(products.RECORDS, dtype="i2")))
    dataset.to_netcdf(path, format=format, unlimited_dims=["time"], engine="netcdf4")
    xr.testing.assert_equal(open_currents(path), open_currents(products.regular()))
    whole = path.read_bytes()
    for lost in (4, 5, 100, 1000):
        path.write_bytes(whole[:-lost])
        refused(path, r"cannot be read as NetCDF \(truncated")
    # SciPy leaves damaged files open. If Python 3.11 collects them while it compiles, it fails.
    gc.collect()


def test_a_format_that_hides_truncation_is_refused(tmp_path):
    path = write(tmp_path, products.regular(), format="NETCDF3_64BIT_DATA")
    refused(path, r"it is of the classic NetCDF version 5, .* nccopy")


def test_much_text_is_refused(tmp_path):
    with netCDF4.Dataset(tmp_path / "sea.nc", "w") as file:
        file.createDimension("y", 4000)
        file.createDimension("x", 4000)
        file.createVariable("u", str, ("y", "x"), chunksizes=(8, 8))
    refused(tmp_path / "sea.nc", r"u: expected at most .* text, got 16,000,000")
