import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class PeriodicGroups:
    """Where every cell ends up: the result of Alg. 2.1 (Alam 2018)."""

    group: Int[Array, "*batch cells"]
    "The periodic group that the cell reaches, numbered from 0 by their smallest cells."
    step: Int[Array, "*batch cells"]
    "Mappings until the cell is on its periodic group, 0 on it."
    group_period: Int[Array, "*batch groups"]
    "Period of each group; zeros past `count`."
    count: Int[Array, "*batch"]
    "Number of periodic groups."

    @property
    def period(self) -> Int[Array, "*batch cells"]:
        """Period of the group that the cell reaches."""
        period = jnp.take_along_axis(self.group_period, jnp.maximum(self.group, 0), axis=-1)
        return jnp.where(self.group < 0, -1, period)

    @property
    def periodic(self) -> Bool[Array, "*batch cells"]:
        """Whether the cell is on a periodic group."""
        return self.step == 0


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class GroupSummary:
    """What sweeps ask of the groups of a map; slots past `count` hold zeros."""

    count: Int[Array, "*batch"]
    "Number of periodic groups."
    period: Int[Array, "*batch groups"]
    "Period of each group."
    basin: Int[Array, "*batch groups"]
    "Number of cells that reach each group, its own included."
    transient: Int[Array, "*batch groups"]
    "Longest transient of each group: mappings from the farthest cell of its basin."


@jax.jit
def periodic_groups(
    image: Int[Array, "cells"], where: Bool[Array, "cells"] | None = None
) -> PeriodicGroups:
    """Finds the periodic groups of a simple map by pointer doubling (Alg. 2.1 of Alam 2018).

    Works on any functional graph, under `jit` and `vmap`. The number of rounds is about the binary
    logarithm of the longest transient or period, and each round is a few gathers.

    **Arguments:**

    - `image`: the cell that each cell is mapped to.
    - `where`: the cells that count, all by default; the image of one that counts must count.
        The others get group, step and period -1.

    **Returns:** [`PeriodicGroups`][].

    Cells 1 and 2 change places, 3 stays, and 0 comes to the first two:

        >>> import jax.numpy as jnp
        >>> from jaxcell.mapping import periodic_groups
        >>> groups = periodic_groups(jnp.array([1, 2, 1, 3]))
        >>> groups.group.tolist(), groups.step.tolist(), groups.period.tolist()
        ([0, 0, 0, 1], [1, 0, 0, 0], [2, 2, 2, 1])
    """
    cells = image.shape[0]
    me = jnp.arange(cells, dtype=image.dtype)
    counts = jnp.ones(cells, bool) if where is None else where
    image = jnp.where(counts, image, me)
    periodic = periodic_cells(image)
    leader, step = follow(image, periodic, jnp.ones_like(image))
    leads = counts & periodic & (leader == me)
    number = jnp.cumsum(leads, dtype=image.dtype) - 1
    group = jnp.where(counts, number[leader], -1)
    on_cycle = counts & periodic
    return PeriodicGroups(
        group=group,
        step=jnp.where(counts, step, -1),
        group_period=jnp.zeros_like(image).at[group].add(on_cycle.astype(image.dtype)),
        count=jnp.sum(leads, dtype=image.dtype),
    )


def periodic_cells(image: Int[Array, "cells"]) -> Bool[Array, "cells"]:
    """The cells that come back to themselves under a map.

    Doubles the map, `f, f^2, f^4, ...`, until the number of distinct images stops falling. That
    stop is exact: if `f^m` and `f^2m` have equally many images then `f^m` permutes its images, so
    each is periodic, and a periodic cell is always an image.
    """

    def images(power: Int[Array, "cells"]) -> tuple[Bool[Array, "cells"], Int[Array, ""]]:
        seen = jnp.zeros(power.shape, bool).at[power].set(True)
        return seen, jnp.sum(seen, dtype=power.dtype)

    def double(state):  # type: ignore[no-untyped-def]
        power, _, count, _ = state
        power = power[power]
        seen, fewer = images(power)
        return power, seen, fewer, fewer < count

    _, seen, _, _ = jax.lax.while_loop(
        lambda state: state[-1], double, (image, *images(image), jnp.array(True))
    )
    return seen


def follow(
    image: Int[Array, "cells"], periodic: Bool[Array, "cells"], weight: Int[Array, "cells"]
) -> tuple[Int[Array, "cells"], Int[Array, "cells"]]:
    """The smallest cell of the group that each cell reaches, and the weights on the way there.

    **Arguments:**

    - `image`: the cell that each cell is mapped to.
    - `periodic`: which cells are periodic.
    - `weight`: what a transient cell adds; with 1 the sum is the number of mappings to reach the
        group.
    """
    cells = image.shape[0]
    leader = jnp.where(periodic, jnp.arange(cells, dtype=image.dtype), cells)
    total = jnp.where(periodic, 0, weight)

    # After r rounds `leader` is the smallest periodic cell, and `total` the sum of weights, among
    # the first 2^r cells of the orbit. A round that changes nothing means that nothing is left to
    # find: see `periodic_cells` for `total`; for `leader`, windows of 2^r cells at a stride of 2^r
    # cover the whole cycle.
    def double(state):  # type: ignore[no-untyped-def]
        power, leader, total, _ = state
        least = jnp.minimum(leader, leader[power])
        added = total[power]
        return power[power], least, total + added, jnp.any(least != leader) | jnp.any(added != 0)

    _, leader, total, _ = jax.lax.while_loop(
        lambda state: state[-1], double, (image, leader, total, jnp.array(True))
    )
    return leader, total
