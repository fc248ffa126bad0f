"""Tables of particles in Parquet files, with the columns of Parcels 4."""

import os
from collections.abc import Mapping

import numpy as np
import xarray as xr

from ..base.optional_modules import import_module
from .netcdf import error_line


# Parcels 4 names the coordinates x, y and t.
_NAMES = {"x": "lon", "y": "lat", "t": "time"}
_NEEDED = ("lon", "lat", "time", "particle_id", "trajectory", *_NAMES)


def read_parquet(path: str | os.PathLike[str]) -> xr.Dataset:
    """Read the columns with positions, and their attributes, as variables on the dimension `obs`.

    **Raises:** `ValueError` for a file that is not Parquet; `ModuleNotFoundError` without PyArrow.
    """
    pa, parquet = import_module("pyarrow"), import_module("pyarrow.parquet")
    try:
        columns = [name for name in parquet.read_schema(path).names if name in _NEEDED]
        table = parquet.read_table(path, columns=columns)
    except (pa.ArrowException, OSError) as error:
        why = f"{os.fspath(path)}: cannot be read as Parquet: {error_line(error)}"
        raise ValueError(why) from error
    variables = {}
    for name in table.column_names:
        about = table.field(name).metadata or {}
        attributes = {key.decode(): text.decode() for key, text in about.items()}
        new = _NAMES.get(name, name)
        values = np.asarray(table.column(name).to_numpy())
        variables[name if new in table.column_names else new] = ("obs", values, attributes)
    return xr.Dataset(variables)


def write_parquet(
    path: str | os.PathLike[str], columns: Mapping[str, tuple[np.ndarray, Mapping[str, str]]]
) -> None:
    """Write the columns of a table, each with its attributes.

    **Raises:** `ModuleNotFoundError` without PyArrow.
    """
    pa, parquet = import_module("pyarrow"), import_module("pyarrow.parquet")
    fields = [
        pa.field(name, pa.from_numpy_dtype(values.dtype), metadata=about)
        for name, (values, about) in columns.items()
    ]
    schema = pa.schema(fields, metadata={"feature_type": "trajectory"})
    arrays = [pa.array(values) for values, _ in columns.values()]
    parquet.write_table(pa.Table.from_arrays(arrays, schema=schema), path)
