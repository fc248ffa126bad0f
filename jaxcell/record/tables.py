import dataclasses

import jax
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..automata import Filter
from ..bounce import Localization
from ..mapping import PeriodicGroups
from ..space import CellSpace


@dataclasses.dataclass(frozen=True, eq=False)
class HostGroups:
    """The periodic groups of one map, on the host."""

    group: Int[np.ndarray, "cells"]
    step: Int[np.ndarray, "cells"]
    period: Int[np.ndarray, "cells"]

    @property
    def periodic(self) -> Bool[np.ndarray, "cells"]:
        return self.step == 0


@dataclasses.dataclass(frozen=True, eq=False)
class GroupTable:
    """What there is to say of each group of one map."""

    period: Int[np.ndarray, "groups"]
    "Cells on the group."
    basin: Int[np.ndarray, "groups"]
    "Cells that reach it, its own included."
    transient: Int[np.ndarray, "groups"]
    "Mappings from the farthest of them."
    direction: Int[np.ndarray, "groups"]
    "The lowest direction of these cells."


def host_groups(
    cells: CellSpace,
    groups: PeriodicGroups,
    bounce: Float[np.ndarray, "*batch"] | Array | float,
) -> tuple[Float[np.ndarray, "maps"], list[HostGroups]]:
    """The groups of one map or of a batch, in one transfer to the host.

    **Arguments:**

    - `cells`: the cell space.
    - `groups`: the groups.
    - `bounce`: the bouncing angle of each map, in radians.

    **Returns:** the angle and the groups of each map.

    **Raises:** `ValueError` if the groups are not of these cells, or not one for each angle.
    """
    angles = np.asarray(bounce, float)
    shape = groups.group.shape
    if angles.ndim > 1 or not angles.size:
        raise ValueError(f"bounce: expected an angle or a list, got an array of {angles.shape}")
    if not np.isfinite(angles).all():
        raise ValueError(f"bounce: expected finite angles in radians, got {bounce}")
    if shape != (*angles.shape, cells.size):
        expected = f"{angles.size} x {cells.size}" if angles.ndim else cells.size
        raise ValueError(
            f"groups: expected those of {expected} cells, one for each angle, got {shape}"
        )
    arrays = jax.device_get((groups.group, groups.step, groups.period))
    group, step, period = (np.reshape(a, (-1, cells.size)) for a in arrays)
    return angles.reshape(-1), [HostGroups(*one) for one in zip(group, step, period, strict=True)]


def group_table(cells: CellSpace, groups: HostGroups) -> GroupTable:
    """What there is to say of each group."""
    basin = np.bincount(groups.group).astype(np.int32)
    period = np.zeros_like(basin)
    period[groups.group] = groups.period
    transient = np.zeros_like(basin)
    np.maximum.at(transient, groups.group, groups.step)
    direction = np.zeros_like(basin)
    for k, group in reversed(list(enumerate(groups.group.reshape(cells.directions, -1)))):
        direction[group] = k
    return GroupTable(period, basin, transient, direction)


def check_filter(cells: CellSpace, filter: Filter, localization: Localization) -> None:
    """Raises `ValueError` if a filter or a run is not of these cells."""
    if filter.uncertainty[0] != cells.size:
        raise ValueError(
            f"filter: it starts in doubt over {filter.uncertainty[0]} cells, but there are "
            f"{cells.size}; it is not of these cells"
        )
    wrong = np.flatnonzero((localization.path < 0) | (localization.path >= cells.size))
    if wrong.size:
        raise ValueError(
            f"localization: path[{wrong[0]}] is cell {localization.path[wrong[0]]}; cells are 0 to "
            f"{cells.size - 1}"
        )
    states = localization.states
    wrong = np.flatnonzero((states < 0) | (states >= len(filter.transition)))
    if wrong.size:
        raise ValueError(
            f"localization: states[{wrong[0]}] is {states[wrong[0]]}; the filter has states 0 to "
            f"{len(filter.transition) - 1}"
        )
