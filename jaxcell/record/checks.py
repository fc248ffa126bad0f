"""Checks that a dataset makes of its own numbers, kept with them as attributes `check_...`.

They are computed from the arrays that are about to be saved, and not from what made them, so that
they can be computed again from any file. Most are a number of violations, or the largest error of
something that ought to be 0. A dataset that contradicts itself is not made at all: whoever opens
the file later would have no reason to doubt it. The limits are far beyond rounding, so that only
a defect, or arrays that were altered, exceeds one.
"""

import numpy as np
import xarray as xr

from ..base.quantities import Checks


def with_checks(dataset: xr.Dataset, checks: Checks) -> xr.Dataset:
    """The dataset with the value of each check as an attribute `check_<name>`.

    **Raises:** `RuntimeError` that names the check, if a value is beyond its limit.
    """
    for name, (value, limit) in checks.items():
        if not (value <= limit or limit == np.inf):
            raise RuntimeError(
                f"{dataset.attrs['title']}: the result contradicts itself: {name} is {value:g}, "
                f"expected at most {limit:g}"
            )
    return dataset.assign_attrs({f"check_{name}": value for name, (value, _) in checks.items()})
