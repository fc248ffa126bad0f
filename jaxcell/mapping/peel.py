import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Int

from .groups import PeriodicGroups, follow, periodic_cells, periodic_groups
from .section import bucket


# Of what is left, the share that a round must drop to be worth its three passes.
_WORTH = 0.05
# From how many cells on JAX doubles, which takes two thirds of the time that NumPy does.
_FEW = 1 << 20


def peeled_groups(image: Int[np.ndarray, "cells"]) -> PeriodicGroups:
    """Find the periodic groups of a simple map that is given as an array of NumPy.

    The same as [`periodic_groups`][jaxcell.mapping.periodic_groups], on the host and in less memory
    where many cells share images: cells that are nobody's image are transient, so they are dropped,
    again and again while it pays, and only what is left is doubled. For a dissipative map that is a
    fraction of the cells.

    **Arguments:**

    - `image`: the cell that each cell is mapped to, `int32`.

    **Returns:** [`PeriodicGroups`][jaxcell.mapping.PeriodicGroups] with arrays of NumPy.

    Cells 1 and 2 change places, 3 stays, and 0 comes to the first two:

        >>> import numpy as np
        >>> from jaxcell.mapping.peel import peeled_groups
        >>> groups = peeled_groups(np.array([1, 2, 1, 3], np.int32))
        >>> groups.group.tolist(), groups.step.tolist(), groups.period.tolist()
        ([0, 0, 0, 1], [1, 0, 0, 0], [2, 2, 2, 1])
    """
    rounds: list[tuple[np.ndarray, Bool[np.ndarray, left]]] = []
    left = image
    while True:
        kept = np.zeros(left.size, bool)
        kept[left] = True
        count = int(np.count_nonzero(kept))
        if count >= (1 - _WORTH) * left.size:
            break
        rounds.append((left, kept))
        # Places among those that are kept; those of others are not asked for.
        place = np.cumsum(kept, dtype=left.dtype) - 1
        left = place[left[kept]]
    group, step, period = _doubled(left)
    for before, kept in reversed(rounds):
        dropped = ~kept
        place = np.cumsum(kept, dtype=before.dtype) - 1
        there = place[before[dropped]]
        wider = np.empty((2, before.size), before.dtype)
        wider[0, kept], wider[1, kept] = group, step
        wider[0, dropped], wider[1, dropped] = group[there], step[there] + 1
        group, step = wider
    return PeriodicGroups(group, step, period, np.asarray(period.size, image.dtype))


def _doubled(image: Int[np.ndarray, "left"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The group and the step of each cell, and the periods, by doubling what is left.

    Cells that were dropped do not change the order of the others, so groups are numbered by their
    smallest cells.
    """
    cells = image.size
    if cells > _FEW:
        # Cells of their own fill up to one of few sizes, each of which is compiled once.
        filled = np.arange(bucket(cells), dtype=image.dtype)
        filled[:cells] = image
        found = jax.device_get(periodic_groups(jnp.asarray(filled)))
        count = int(found.count) - (filled.size - cells)
        return found.group[:cells], found.step[:cells], found.group_period[:count]
    periodic = periodic_cells(image)
    leader, step = follow(image, periodic, np.ones_like(image))
    leads = periodic & (leader == np.arange(cells, dtype=image.dtype))
    group = (np.cumsum(leads, dtype=image.dtype) - 1)[leader]
    return group, step, np.bincount(group[periodic]).astype(image.dtype)
