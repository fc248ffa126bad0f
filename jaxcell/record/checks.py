"""Checks that a dataset makes of its own numbers, kept with them as attributes `check_...`.

They are computed from the arrays that are about to be saved, and not from what made them, so that
they can be computed again from any file. Most are a number of violations, or the largest error of
something that ought to be 0. A dataset that contradicts itself is not made at all: whoever opens
the file later would have no reason to doubt it. The limits are far beyond rounding, so that only
a defect, or arrays that were altered, exceeds one.
"""

import json
from collections.abc import Mapping
from typing import Any, TypeAlias

import numpy as np
import xarray as xr
from jaxtyping import Bool, Float, Int


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


def navigation_checks(dataset: xr.Dataset) -> Checks:
    """Those of [`jaxcell.record.navigation_dataset`][].

    Each action leads from its cell to the next: forward to another position in the same direction,
    and an angle to the direction that it turns to; from the start to the goal, through cells that
    reach it, at the cost that is told, as far as `spec` says what a step costs.
    """
    path, action = dataset["cell"].values, dataset["action"].values
    directions, positions = dataset.sizes["direction"], dataset.sizes["position"]
    turned = np.rint(action * directions / (2 * np.pi)).astype(int)
    wrong = motion_violations(path[:, None], action[:, None] != 0, turned, directions, positions)
    cost, reaches = float(dataset["cost"]), dataset["reaches"].values.ravel()
    found: dict[str, tuple[float | int, float | int]] = {
        "actions_that_lead_elsewhere": (int(wrong.sum()), 0)
    }
    if cost < 0:
        return found
    ends = int(path[0] != dataset["start"]) + int(path[-1] != dataset["goal"])
    found["ends_missed"] = (ends, 0)
    found["cells_that_do_not_reach"] = (int(np.count_nonzero(~reaches[path])), 0)
    spec = json.loads(dataset.attrs["spec"])
    if {"keep", "change"} <= spec.keys():
        bumps = turned[action != 0]
        changes = np.count_nonzero(np.diff(bumps))
        sums = spec["keep"] * (action.size - changes) + spec["change"] * changes
        found["cost_minus_that_of_actions"] = (abs(cost - float(sums)), 1e-9 * max(1.0, cost))
    return found


def motion_violations(
    path: Int[np.ndarray, "times robots"],
    bumped: Bool[np.ndarray, "times-1 robots"],
    turn: Int[np.ndarray, "times-1"] | None,
    directions: int,
    positions: int,
) -> Bool[np.ndarray, "times-1 robots"]:
    """Whether a robot does not keep its direction in a move, or its position where it bumps.

    **Arguments:**

    - `path`: the cells.
    - `bumped`: whether the robot turned in place.
    - `turn`: by how many directions; `None` if that is not known.
    - `directions`, `positions`: of the cell space.
    """
    direction, position = np.divmod(path, positions)
    stays = position[1:] == position[:-1]
    by = (direction[1:] - direction[:-1]) % directions
    right = stays if turn is None else stays & (by == turn[:, None] % directions)
    return ~np.where(bumped, right, ~stays & (by == 0))


def team_checks(dataset: xr.Dataset, directions: int, positions: int) -> Checks:
    """Those of [`jaxcell.record.team_dataset`][].

    No two robots share a position; robots that bump stay where they are and the others go on in
    their directions, but for the turn of one robot with which a part begins; and what is covered is
    what was visited.
    """
    path, bumped = dataset["cell"].values, dataset["bumped"].values
    position = np.sort(path % positions, axis=1)
    begins = dataset["part_begin"].values[1:]
    wrong = motion_violations(path, bumped, None, directions, positions)
    # The move before a part begins is the turn of one robot.
    wrong[begins - 1] = False
    turned = (path[begins] - path[begins - 1]) // positions % directions
    one = np.isin(turned, (1, directions - 1)).sum(axis=1) == 1
    alone = one & ((path[begins] != path[begins - 1]).sum(axis=1) == 1)
    _, first = np.unique(path % positions, return_index=True)
    visited = np.cumsum(np.bincount(first // path.shape[1], minlength=len(path)))
    return {
        "shared_positions": (int(np.count_nonzero(np.diff(position, axis=1) == 0)), 0),
        "moves_against_the_rule": (int(wrong.sum()), 0),
        "parts_that_begin_otherwise": (int(np.count_nonzero(~alone)), 0),
        "covered_minus_visited": (_largest(np.abs(visited - dataset["covered"].values)), 0),
    }


def error_of_sums(values: Float[np.ndarray, "*rows terms"]) -> float:
    """The largest difference of the sum of a row from 1."""
    return _largest(np.abs(values.sum(axis=-1) - 1))


def _largest(values: Any) -> float:
    """The largest value, 0 if there is none above; not a number if one is not."""
    array = np.asarray(values, float)
    return float(array.max(initial=0.0))
