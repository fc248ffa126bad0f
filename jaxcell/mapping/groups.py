import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Int

from ..base.shown import Pictured, Shown


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class PeriodicGroups(Pictured):
    """The periodic group and step of every cell: the result of Alg. 2.1 (Alam 2018)."""

    group: Int[Array | np.ndarray, "*batch cells"]
    "The number of the group that each cell reaches; groups are ordered by their smallest cells."
    step: Int[Array | np.ndarray, "*batch cells"]
    "Number of applications of the map until each cell is in its group; 0 for cells of the group."
    group_period: Int[Array | np.ndarray, "*batch groups"]
    "Period of each group; entries past `count` are 0."
    count: Int[Array | np.ndarray, "*batch"]
    "Number of periodic groups."

    @property
    def period(self) -> Int[Array | np.ndarray, "*batch cells"]:
        """Period of the group that each cell reaches."""
        xp = self.group.__array_namespace__()
        return xp.take_along_axis(self.group_period, self.group, axis=-1)

    @property
    def periodic(self) -> Bool[Array | np.ndarray, "*batch cells"]:
        """A mask of the cells in periodic groups."""
        return self.step == 0


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class GroupSummary(Shown):
    """Period, basin and longest transient of each periodic group; entries past `count` are 0."""

    count: Int[Array | np.ndarray, "*batch"]
    "Number of periodic groups."
    period: Int[Array | np.ndarray, "*batch groups"]
    "Period of each group."
    basin: Int[Array | np.ndarray, "*batch groups"]
    "Number of cells that reach each group, including the cells of the group."
    transient: Int[Array | np.ndarray, "*batch groups"]
    "Longest transient of each group, in applications of the map until a cell is in the group."

    def totals(self) -> "GroupTotals":
        """Compute statistics over all groups of each map, with NumPy."""
        count, period, basin, transient = map(
            np.asarray, (self.count, self.period, self.basin, self.transient)
        )
        live = np.arange(period.shape[-1]) < count[..., None]
        shortest = np.where(live, period, np.iinfo(period.dtype).max).min(axis=-1)
        numbers = (
            *(count, transient.max(axis=-1), shortest, period.max(axis=-1)),
            *(period.sum(axis=-1), basin.max(axis=-1)),
        )
        return GroupTotals(*map(np.asarray, numbers))


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class GroupTotals(Shown):
    """Statistics over all periodic groups of a map."""

    count: Int[Array | np.ndarray, "*batch"]
    "Number of periodic groups."
    longest_transient: Int[Array | np.ndarray, "*batch"]
    "The largest number of applications of the map until a cell is in its group."
    shortest_period: Int[Array | np.ndarray, "*batch"]
    "The smallest number of cells of a group."
    longest_period: Int[Array | np.ndarray, "*batch"]
    "The largest number of cells of a group."
    periodic_cells: Int[Array | np.ndarray, "*batch"]
    "Total number of cells of the groups."
    largest_basin: Int[Array | np.ndarray, "*batch"]
    "The largest number of cells that reach one group, including the cells of the group."


@jax.jit
def doubled_groups(image: Int[Array, "cells"]) -> PeriodicGroups:
    """Compute [`jaxcell.mapping.periodic_groups`][] on an accelerator, by repeated squaring."""
    periodic = periodic_cells(image)
    leader, step = follow(image, periodic, jnp.ones_like(image))
    leads = periodic & (leader == jnp.arange(image.shape[0], dtype=image.dtype))
    group = (jnp.cumsum(leads, dtype=image.dtype) - 1)[leader]
    return PeriodicGroups(
        group=group,
        step=step,
        group_period=jnp.zeros_like(image).at[group].add(periodic.astype(image.dtype)),
        count=jnp.sum(leads, dtype=image.dtype),
    )


def periodic_cells(
    image: Int[Array | np.ndarray, "cells"],
) -> Bool[Any, "cells"]:
    """Find the cells that return to themselves under a map, given as a JAX or NumPy array.

    The map is squared repeatedly, `f, f^2, f^4, ...`, until the number of distinct images stops
    falling. Then the images are the periodic cells: if `f^m` and `f^2m` have equally many images,
    `f^m` permutes its images, so each image is periodic, and a periodic cell is always an image.
    """

    def images(power: Any) -> tuple[Any, Any]:
        seen: Any
        if isinstance(power, np.ndarray):
            seen = np.zeros(power.shape, bool)
            seen[power] = True
        else:
            seen = jnp.zeros(power.shape, bool).at[power].set(True)
        return seen, seen.sum(dtype=power.dtype)

    def double(state):  # type: ignore[no-untyped-def]
        power, _, count, _ = state
        power = power[power]
        seen, fewer = images(power)
        return power, seen, fewer, fewer < count

    seen, count = images(image)
    return _repeat(double, (image, seen, count, count > 0))[1]


def follow(
    image: Int[Array | np.ndarray, "cells"],
    periodic: Bool[Array | np.ndarray, "cells"],
    weight: Int[Array | np.ndarray, "cells"],
) -> tuple[Int[Any, "cells"], Int[Any, "cells"]]:
    """Find the smallest cell of the group that each cell reaches, and sum the weights on the way.

    The sum is over the cells of the orbit before its first cell in the group. If all weights are 1,
    it is the number of applications of the map until the cell is in its group.
    """
    xp = image.__array_namespace__()
    cells = image.shape[0]
    leader = xp.where(periodic, xp.arange(cells, dtype=image.dtype), cells)
    total = xp.where(periodic, 0, weight)

    # After r rounds `leader` is the smallest periodic cell, and `total` the sum of weights, among
    # the first 2^r cells of the orbit. A round without changes is the last: see `periodic_cells`
    # for `total`; for `leader`, windows of 2^r cells at a stride of 2^r cover the whole cycle.
    def double(state):  # type: ignore[no-untyped-def]
        power, leader, total, _ = state
        least = xp.minimum(leader, leader[power])
        added = total[power]
        return power[power], least, total + added, xp.any(least != leader) | xp.any(added != 0)

    _, leader, total, _ = _repeat(double, (image, leader, total, xp.any(periodic)))
    return leader, total


def _repeat(function: Callable[[Any], Any], state: Any) -> Any:
    """Apply a function of JAX or NumPy to the tuple `state` until its last entry is false."""
    if not isinstance(state[0], np.ndarray):
        return jax.lax.while_loop(lambda state: state[-1], function, state)
    while state[-1]:
        state = function(state)
    return state
