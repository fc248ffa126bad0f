"""What moves drifters at the surface besides the current: the wind, and waves."""

from typing import Literal, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int

from .axes.dimensions import Axes
from .conventions import table
from .grid import OceanGrid
from .netcdf import OceanFile
from .velocity import metres_per_second, read_cells


Push: TypeAlias = Literal["wind", "stokes"]

_WHAT: dict[Push, str] = {"wind": "wind for windage", "stokes": "Stokes drift of waves"}
# No wind is faster, and no drift by waves.
_FASTEST: dict[Push, float] = {"wind": 100.0, "stokes": 10.0}


def read_surface(
    file: OceanFile,
    role: Push,
    axes: Axes,
    grid: OceanGrid,
    records: Int[np.ndarray, " records"],
    water: Bool[np.ndarray, "y x"],
) -> tuple[Float[np.ndarray, "axes records y x"], str]:
    """Read the wind or the Stokes drift towards the East and North, in m/s, at some records.

    **Arguments:**

    - `file`: an open file.
    - `role`: which of them.
    - `axes`: the dimensions of the current, which it must have too, those of depth apart.
    - `grid`: the cells.
    - `records`: the numbers of the records.
    - `water`: where a value is needed; elsewhere it is 0.

    **Returns:** the components, and the names of their variables.

    **Raises:** `ValueError` if the file has none; for a value that is missing in water or too
    large to be one; and for units or dimensions as of a current.
    """
    names = _names(file, role)
    found = np.zeros((2, len(records), *water.shape))
    for component, name in zip(found, names, strict=True):
        factor = metres_per_second(file, name)
        for here, record in zip(component, records.tolist(), strict=True):
            here[water] = factor * read_cells(file, name, axes, grid, record)[water]
            wrong = water & ~(np.abs(here) <= _FASTEST[role])
            if wrong.any():
                row, column = np.argwhere(wrong)[0]
                raise file.error(
                    name,
                    f"expected a {_WHAT[role]} up to {_FASTEST[role]:g} m/s wherever there is "
                    f"water, got {here[row, column]:g} at record {record}, row {grid.rows[row]}, "
                    f"column {grid.columns[column]}",
                )
    return found, ", ".join(names)


def _names(file: OceanFile, role: Push) -> list[str]:
    """The variables towards the East and North, by standard name and then by name."""
    variables = file.dataset.data_vars.items()
    by_standard = {str(one.attrs.get("standard_name")): str(name) for name, one in variables}
    for row in table(role):
        if row.standard_names and all(one in by_standard for one in row.standard_names):
            return [by_standard[one] for one in row.standard_names]
        if named := file.named(row.names):
            return named
    pairs = (" and ".join(row.names or row.standard_names) for row in table(role))
    expected = " or ".join(dict.fromkeys(pairs))
    raise file.error(role, f"the file has no {_WHAT[role]}; expected {expected}")
