"""Checks that a dataset makes of its own numbers, kept with them as attributes `check_...`.

They are computed from the arrays that are about to be saved, and not from what made them, so that
they can be computed again from any file. Most are a number of violations, or the largest error of
something that ought to be 0. A dataset that contradicts itself is not made at all: whoever opens
the file later would have no reason to doubt it. The limits are far beyond rounding, so that only
a defect, or arrays that were altered, exceeds one.
"""

from collections.abc import Mapping
from typing import Any, TypeAlias

import numpy as np
import xarray as xr
from jaxtyping import Float, Int


# Sums of some 10^6 probabilities are good to 1e-10, and so are the solves behind them.
PROBABILITY = 1e-8

Checks: TypeAlias = Mapping[str, tuple[float | int, float | int]]
"""By name: the value, and the largest that is right; infinite if it is told only."""


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


def groups_checks(dataset: xr.Dataset, image: Int[np.ndarray, "*batch cells"] | None) -> Checks:
    """Those of [`jaxcell.record.groups_dataset`][].

    Basins hold all cells; a group has as many periodic cells as its period; in each basin some cell
    is at every step up to the farthest; and, if the images are known, each leads to the same group,
    one step nearer to it.
    """
    maps = 1 if dataset["bounce"].ndim == 0 else dataset.sizes["bounce"]
    group, step = (dataset[name].values.reshape(maps, -1) for name in ("group", "step"))
    tables = ("group_period", "group_basin", "group_transient")
    period, basin, transient = (dataset[name].values.reshape(maps, -1) for name in tables)
    basins = periods = missing = 0
    for i, count in enumerate(dataset["groups"].values.reshape(-1)):
        basins = max(basins, abs(int(basin[i, :count].sum()) - group[i].size))
        periodic = np.bincount(group[i][step[i] == 0], minlength=count)
        periods = max(periods, int(np.abs(periodic - period[i, :count]).max()))
        first = np.cumsum([0, *(transient[i, :count] + 1)])
        occurs = np.zeros(first[-1], bool)
        occurs[first[group[i]] + step[i]] = True
        missing += int(np.count_nonzero(~occurs))
    found: dict[str, tuple[float | int, float | int]] = {
        "basins_minus_cells": (basins, 0),
        "periodic_cells_minus_period": (periods, 0),
        "steps_that_no_cell_takes": (missing, 0),
    }
    if image is not None:
        to = np.asarray(image).reshape(maps, -1)
        leads = np.take_along_axis(group, to, 1) == group
        nearer = np.take_along_axis(step, to, 1) == np.maximum(step - 1, 0)
        found["image_violations"] = (int(np.count_nonzero(~(leads & nearer))), 0)
    return found


def filter_checks(dataset: xr.Dataset) -> Checks:
    """Those of [`jaxcell.record.filter_dataset`][].

    The uncertainty is the number of configurations; and what is left after either observation was
    there before, so that both together are no more.
    """
    uncertainty, transition = dataset["uncertainty"].values, dataset["transition"].values
    after = np.where(transition >= 0, uncertainty[np.maximum(transition, 0)], 0).sum(axis=1)
    return {
        "uncertainty_minus_members": (
            int(np.abs(uncertainty - np.diff(dataset["offset"].values)).max()),
            0,
        ),
        "states_that_gain_cells": (int(np.count_nonzero(after > uncertainty)), 0),
    }


def localization_checks(dataset: xr.Dataset) -> Checks:
    """Those of [`jaxcell.record.localization_dataset`][], and those of its filter.

    The run follows the transitions, and ends with the configurations of its last state. In how many
    states the robot is in none of the configurations is told: some, if the filter is of another
    map.
    """
    visited, sensed = dataset["visited"].values, dataset["sensed"].values
    offset, member = dataset["offset"].values, dataset["member"].values
    path, transition = dataset["cell"].values, dataset["transition"].values
    follows = transition[visited[:-1], sensed] == visited[1:]
    beliefs = [member[offset[s] : offset[s + 1]] for s in visited]
    lost = sum(not np.isin(z, cells) for z, cells in zip(path, beliefs, strict=True))
    ends = np.setxor1d(dataset["candidate"].values, beliefs[-1])
    return {
        **filter_checks(dataset),
        "run_off_the_transitions": (int(np.count_nonzero(~follows)), 0),
        "candidates_not_of_the_last_state": (ends.size, 0),
        "states_without_the_robot": (lost, np.inf),
    }


def error_of_sums(values: Float[np.ndarray, "*rows terms"]) -> float:
    """The largest difference of the sum of a row from 1."""
    return _largest(np.abs(values.sum(axis=-1) - 1))


def _largest(values: Any) -> float:
    """The largest value, 0 if there is none above; not a number if one is not."""
    array = np.asarray(values, float)
    return float(array.max(initial=0.0))
