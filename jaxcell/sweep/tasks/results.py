"""How tasks give their results."""

from collections.abc import Mapping, Sequence

import numpy as np
import xarray as xr


def dataset(
    told: Mapping[str, tuple[str, str]], rows: Sequence[Sequence[float | int]]
) -> xr.Dataset:
    """A row of numbers for each member as a Dataset.

    **Arguments:**

    - `told`: what each number is called, says, and is measured in.
    - `rows`: the numbers of each member.
    """
    columns = zip(*rows, strict=True)
    return xr.Dataset(
        {
            name: ("member", np.array(column), {"long_name": long_name, "units": units})
            for (name, (long_name, units)), column in zip(told.items(), columns, strict=True)
        }
    )
