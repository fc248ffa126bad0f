"""Wind and waves, which move drifters at the surface in addition to the current."""

from typing import Literal, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int

from .axes.dimensions import Axes
from .component import metres_per_second, read_cells
from .conventions import find_pairs, table
from .grid import OceanGrid
from .netcdf import OceanFile


Push: TypeAlias = Literal["wind", "stokes"]

_WHAT: dict[Push, str] = {"wind": "wind for windage", "stokes": "Stokes drift of waves"}
# The fastest wind and Stokes drift, in m/s.
_FASTEST: dict[Push, float] = {"wind": 100.0, "stokes": 10.0}


def read_surface(
    file: OceanFile,
    role: Push,
    axes: Axes,
    grid: OceanGrid,
    records: Int[np.ndarray, " records"],
    water: Bool[np.ndarray, "y x"],
) -> tuple[Float[np.ndarray, "axes records y x"], str]:
    """Read the wind or the Stokes drift towards the East and North, at `records`.

    **Returns:** the components in m/s, 0 outside `water`; and the names of the variables.
    """
    both = (pair for _, pair in find_pairs(file.dataset, role) if all(pair))
    if not (found := next(both, [])):
        pairs = (" and ".join(row.names or row.standard_names) for row in table(role))
        expected = " or ".join(dict.fromkeys(pairs))
        raise file.error(role, f"the file has no {_WHAT[role]}; expected {expected}")
    names = [variables[-1] for variables in found]
    values = np.zeros((2, len(records), *water.shape))
    for component, name in zip(values, names, strict=True):
        factor = metres_per_second(file, name)
        for cells, record in zip(component, records.tolist(), strict=True):
            cells[water] = factor * read_cells(file, name, axes, grid, record)[water]
            wrong = water & ~(np.abs(cells) <= _FASTEST[role])
            for cell in np.argwhere(wrong):
                raise file.error(
                    name,
                    f"expected a {_WHAT[role]} up to {_FASTEST[role]:g} m/s wherever there is "
                    f"water, got {cells[*cell]:g} at record {record}, {grid.place(*cell)}",
                )
    return values, ", ".join(names)
