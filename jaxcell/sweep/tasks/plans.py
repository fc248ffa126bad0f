"""The cheapest plans between all pairs of cells (Alam 2018, Alg. 3.2)."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from .maps import MAP, MOTION, cells_of, motion_of
from .parameters import Parameter, members, number, numbers
from .results import dataset


_cost = number("more than 0", lambda x: x > 0)
PARAMETERS = {
    **MAP,
    **MOTION,
    "bounces": Parameter(numbers),
    "keep": Parameter(_cost, 1.0),
    "change": Parameter(_cost, 100.0),
}
_RESULTS = {
    "reachable_pairs": ("share of pairs of cells with a path from one to the other", "1"),
    "mean_cost": ("mean cost of the plans between pairs with a path", "1"),
    "largest_cost": ("largest cost of a plan between two cells", "1"),
}
# Costs of so many pairs are read at a time.
_PAIRS = 1 << 24


def plans(batch: Mapping[str, np.ndarray], fixed: Mapping[str, Any], seed: int) -> xr.Dataset:
    """Which cells a robot can get from and to with its bouncing angles, and at what cost.

    Parameters: the options of `jaxcell navigate` but `start` and `goal`; `bounces` is a list of
    angles in degrees, or one. Nothing is random.
    """
    return dataset(
        _RESULTS, [_row(member) for member in members("plans", PARAMETERS, batch, fixed)]
    )


def _row(member: dict[str, Any]) -> tuple[float | int, ...]:
    from ...bounce import all_plans

    cells = cells_of(member)
    keep, change = (int(x) if x == int(x) else x for x in (member["keep"], member["change"]))
    found = all_plans(cells, np.radians(member["bounces"]), keep, change, **motion_of(member))
    pairs, total, largest = 0, 0.0, 0.0
    block = max(1, _PAIRS // cells.size)
    for begin in range(0, cells.size, block):
        goals = np.arange(begin, min(begin + block, cells.size))
        costs = found.costs(goals)
        known = costs[costs >= 0]
        pairs += known.size
        total += float(known.sum(dtype=float))
        largest = max(largest, float(known.max(initial=0)))
    return pairs / cells.size**2, total / pairs, largest
