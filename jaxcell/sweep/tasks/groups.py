"""The periodic groups of a bouncing robot, as `jaxcell groups`."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from .maps import MAP, MOTION, cells_of, motion_of
from .parameters import Parameter, angle, members
from .results import but, dataset, together


PARAMETERS = {**MAP, "bounce": Parameter(angle), **MOTION}
# Tables of walls grow with the square of it.
_MOST_WAYS = 100
_RESULTS = {
    "count": ("number of periodic groups", "1"),
    "longest_transient": ("longest transient", "mappings"),
    "shortest_period": ("shortest period", "mappings"),
    "longest_period": ("longest period", "mappings"),
    "periodic_cells": ("cells of periodic groups", "1"),
    "largest_basin": ("cells that reach the same group, at most", "1"),
}


def groups(batch: Mapping[str, np.ndarray], fixed: Mapping[str, Any], seed: int) -> xr.Dataset:
    """Number, periods, basins and transients of the periodic groups on maps.

    Parameters: the options of `jaxcell groups`, with one angle `bounce` in degrees. Nothing is
    random. Members that differ in their angle alone are one batched call.
    """
    found = members("groups", PARAMETERS, batch, fixed)
    return dataset(_RESULTS, together(found, but("bounce"), _rows))


def _rows(alike: list[dict[str, Any]]) -> list[tuple[int, ...]]:
    from ...bounce import bounce_shift, cell_walls, group_summary, moves, wall_groups

    member, bounce = alike[0], np.radians([one["bounce"] for one in alike])
    cells, motion = cells_of(member), motion_of(member)
    if len(moves(cells, **motion).target) <= _MOST_WAYS:
        shift = bounce_shift(bounce, cells.directions)
        found = wall_groups(cell_walls(cells, **motion), shift)
        return [
            tuple(row) for row in np.stack([getattr(found, n)[0] for n in _RESULTS], 1).tolist()
        ]
    summary = group_summary(cells, bounce, **motion)
    tables = (summary.count, summary.period, summary.basin, summary.transient)
    rows = []
    for count, *some in zip(*map(np.asarray, tables), strict=True):
        period, basin, transient = (x[:count] for x in some)
        numbers = (transient.max(), period.min(), period.max(), period.sum(), basin.max())
        rows.append((int(count), *map(int, numbers)))
    return rows
