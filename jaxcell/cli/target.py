"""What a robot is to cover, as people name it on the command line."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float


if TYPE_CHECKING:
    import xarray as xr

    from ..space import CellSpace


def read_target(cells: "CellSpace", text: str) -> Float[np.ndarray, "positions"]:
    """The share of each position that `--target` names.

    **Arguments:**

    - `cells`: the cell space.
    - `text`: `uniform`; the name of an image, whose bright parts are worth more; or
        `FILE.nc:VARIABLE`, a variable over `position`, or over coordinates `x` and `y` in metres.

    **Raises:** `ValueError` or `OSError` that names the option and what is wrong with it.
    """
    from ..bounce.coverage import coverage_target

    if text == "uniform":
        return coverage_target(cells)
    try:
        file, colon, variable = text.rpartition(":")
        if colon and file.endswith(".nc"):
            worth = _variable(cells, Path(file), variable)
        elif text.endswith(".nc"):
            raise ValueError("which variable? give FILE.nc:VARIABLE")
        else:
            worth = _brightness(Path(text))
        return coverage_target(cells, worth)
    except (ValueError, OSError) as error:
        message = str(error).removeprefix("target: ")
        raise type(error)(f"--target {text}: {message}") from None


def _brightness(path: Path) -> Float[np.ndarray, "rows columns"]:
    from PIL import Image, UnidentifiedImageError

    if not path.is_file():
        raise ValueError("there is no such file; expected 'uniform', an image, or FILE.nc:VARIABLE")
    try:
        with Image.open(path) as image:
            # Images of more than 8 bits are numbers already, and conversion would cut them off.
            plain = image if image.mode in ("I;16", "I", "F") else image.convert("L")
            return np.asarray(plain, float)
    except UnidentifiedImageError:
        raise ValueError("it is no image that can be read") from None


def _variable(cells: "CellSpace", path: Path, variable: str) -> Float[np.ndarray, "positions"]:
    import xarray as xr

    if not path.is_file():
        raise ValueError(f"there is no file {path}")
    with xr.open_dataset(path, engine="netcdf4") as dataset:
        if variable not in dataset:
            names = ", ".join(map(str, dataset.data_vars)) or "no variables"
            raise ValueError(f"expected a variable of the file, which holds {names}")
        array = dataset[variable].load()
    if array.dims == ("position",):
        return np.asarray(array, float)
    if set(array.dims) != {"x", "y"} or not {"x", "y"} <= set(array.coords):
        raise ValueError(
            f"expected a variable over position, or over coordinates x and y in metres, got one "
            f"over {', '.join(map(str, array.dims)) or 'nothing'}"
        )
    x, y, _ = cells.centre(np.arange(cells.positions))
    return np.asarray(array.isel(x=_nearest(array, "x", x), y=_nearest(array, "y", y)), float)


def _nearest(
    array: "xr.DataArray", name: str, centres: Float[np.ndarray, "positions"]
) -> "xr.DataArray":
    """The index of the coordinate nearest to each centre."""
    import xarray as xr

    values = np.asarray(array[name], float)
    if values.size < 2 or not np.isfinite(values).all():
        raise ValueError(f"expected at least two finite coordinates {name}")
    index = np.abs(values[:, None] - centres).argmin(axis=0)
    beyond = np.abs(values[index] - centres).max()
    if beyond > np.abs(np.diff(np.sort(values))).max():
        raise ValueError(
            f"the map reaches {beyond:g} m beyond its coordinates {name}, which go from "
            f"{values.min():g} to {values.max():g}"
        )
    return xr.DataArray(index, dims="position")
