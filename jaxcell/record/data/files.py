import os

import xarray as xr

from ...base.files import replacing


def save_dataset(dataset: xr.Dataset, path: str | os.PathLike[str]) -> None:
    """Write a dataset as a compressed NetCDF-4 file, whole or not at all.

    **Arguments:**

    - `dataset`: the dataset.
    - `path`: the file to write or replace.

    **Raises:** `FileNotFoundError` if the folder does not exist.

    A dataset, written and read again:

        >>> import pathlib, tempfile
        >>> import xarray as xr
        >>> from jaxcell import record
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = pathlib.Path(folder, "result.nc")
        ...     record.save_dataset(xr.Dataset({"steps": ("cell", [1, 2])}), path)
        ...     xr.load_dataset(path).steps.values.tolist()
        [1, 2]
    """
    encoding = {
        name: {"zlib": True, "complevel": 1, "_FillValue": None}
        for name, variable in dataset.variables.items()
        if variable.ndim and variable.dtype.kind in "bif"
    }
    with replacing(path) as temporary:
        dataset.to_netcdf(temporary, format="NETCDF4", engine="netcdf4", encoding=encoding)
