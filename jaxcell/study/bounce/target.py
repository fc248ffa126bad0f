"""Read the target of a coverage study: the desired share of time at each position."""

from pathlib import Path

import numpy as np
import xarray as xr
from jaxtyping import Float
from PIL import UnidentifiedImageError

from ...bounce.coverage import coverage_target
from ...currents.netcdf import open_netcdf
from ...space import CellSpace
from ...space.maps.images import read_image


_MAX_VALUES = 100_000_000
_LARGEST_COORDINATE = 1e9


def read_target(cells: CellSpace, text: str) -> Float[np.ndarray, "positions"]:
    """Read the desired share of time at each position from the parameter `target`.

    The text is `uniform`; the name of an image, whose bright parts get larger shares; or
    `FILE.nc:VARIABLE`, a variable over `position`, or over coordinates `x` and `y` in metres.
    """
    if text == "uniform":
        return coverage_target(cells)
    try:
        file, colon, variable = text.rpartition(":")
        if colon and file.endswith(".nc"):
            worth = _variable(cells, Path(file), variable)
        elif text.endswith(".nc"):
            raise ValueError("expected a variable of the file, FILE.nc:VARIABLE")
        else:
            worth = _brightness(Path(text))
        return coverage_target(cells, worth)
    except (ValueError, OSError) as error:
        message = str(error).removeprefix("target: ")
        raise type(error)(f"target {text}: {message}") from None


def _brightness(path: Path) -> Float[np.ndarray, "rows columns"]:
    try:
        image = read_image(path.read_bytes())
    except UnidentifiedImageError:
        raise ValueError("expected an image that can be read") from None
    # Conversion to 8 bits would cut off the numbers of images with more bits.
    plain = image if image.mode in ("I;16", "I", "F") else image.convert("L")
    return np.asarray(plain, float)


def _variable(cells: CellSpace, path: Path, variable: str) -> Float[np.ndarray, "positions"]:
    with open_netcdf(path) as file:
        if variable not in file.dataset:
            names = ", ".join(map(str, file.dataset.data_vars)) or "no variables"
            raise ValueError(f"expected a variable of the file, which holds {names}")
        array = file.dataset[variable]
        if array.size > _MAX_VALUES:
            raise ValueError(f"it has {array.size:,} values; expected at most {_MAX_VALUES:,}")
        array = array.copy(data=file.read(array))
    if array.dims == ("position",):
        return np.asarray(array, float)
    if set(array.dims) != {"x", "y"} or not {"x", "y"} <= set(array.coords):
        raise ValueError(
            f"expected a variable over position, or over coordinates x and y in metres, got one "
            f"over {', '.join(map(str, array.dims)) or 'nothing'}"
        )
    x, y, _ = cells.centre(np.arange(cells.positions))
    array = array.sortby(["x", "y"])
    nearest = {name: _nearest(array, name, centres) for name, centres in (("x", x), ("y", y))}
    return np.asarray(array.isel(nearest), float)


def _nearest(
    array: xr.DataArray, name: str, centres: Float[np.ndarray, "positions"]
) -> xr.DataArray:
    """Return, for each centre, the index of the nearest value of the sorted coordinate `name`."""
    values = np.asarray(array[name], float)
    # The bound on coordinates keeps their differences finite.
    if values.size < 2 or not (np.abs(values) <= _LARGEST_COORDINATE).all():
        raise ValueError(f"expected at least two finite coordinates {name}")
    # The lower coordinate is chosen if two are equally near.
    index = np.searchsorted((values[1:] + values[:-1]) / 2, centres)
    beyond = np.abs(values[index] - centres).max()
    if beyond > np.diff(values).max():
        raise ValueError(
            f"the map reaches {beyond:g} m beyond its coordinates {name}, which go from "
            f"{values.min():g} to {values.max():g}"
        )
    return xr.DataArray(index, dims="position")
