import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Int

from .groups import PeriodicGroups, doubled_groups
from .section import bucket
from .walk import walked_groups


# Cells from which on a map is peeled, if it is worth it.
_MANY = 1 << 18
# Of what is left, the share that a pass over all of it must drop to be worth it.
_WORTH = 0.2
# Cells at once from which on it is worth to go on from those that were dropped before.
_FRONT = 200
# Cells that are worked out at once.
_PART = 1 << 20
# Cells of maps that shorter ones are made of; the walk over those that are added takes nothing.
_LENGTHS = 1 << 12, 1 << 14, 1 << 16, 1 << 18


def periodic_groups(
    image: Int[Array, "cells"] | Int[np.ndarray, "cells"],
    where: Bool[Array, "cells"] | Bool[np.ndarray, "cells"] | None = None,
) -> PeriodicGroups:
    """Find the periodic groups of a simple map (Alg. 2.1 of Alam 2018).

    Works on any functional graph, under `jit` and `vmap`. A processor maps every cell once, and
    peels the cells that nothing leads to off a large map that is given as an array and has many. An
    accelerator doubles pointers: the number of rounds is about the binary logarithm of the longest
    transient or period, and each round is a few gathers.

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
    image = jnp.asarray(image)
    here = not isinstance(image, jax.core.Tracer) and where is None
    if here and all(device.platform == "cpu" for device in image.devices()):
        on_host = np.asarray(image)
        if _worth_peeling(on_host):
            return jax.device_put(_peeled_groups(on_host))
    return _groups(image, where)


def groups_on_host(image: Int[np.ndarray, "cells"]) -> PeriodicGroups:
    """[`periodic_groups`][jaxcell.mapping.periodic_groups] of an array of NumPy, in such arrays.

    Beside the image and the result it takes at most 16 bytes a cell. There are no zeros behind the
    periods of the groups.
    """
    if _worth_peeling(image):
        found = _peeled_groups(image)
    elif image.size < _MANY:
        found = _groups_of_longer(image)
    else:
        found = jax.device_get(_groups(image, None))
    return dataclasses.replace(found, group_period=found.group_period[: found.count].copy())


def _worth_peeling(image: Int[np.ndarray, "cells"]) -> bool:
    return bool(image.size >= _MANY and _missed(image) >= _WORTH)


@jax.jit
def _groups(
    image: Int[Array, "cells"], where: Bool[Array, "cells"] | Bool[np.ndarray, "cells"] | None
) -> PeriodicGroups:
    found: PeriodicGroups = lax.platform_dependent(
        image, where, cpu=walked_groups, default=doubled_groups
    )
    return found


def _missed(image: Int[np.ndarray, "cells"]) -> float:
    """The share of cells that nothing leads to, of every 64th."""
    hit = np.zeros(-(-image.size // 64), bool)
    hit[image[image % 64 == 0] // 64] = True
    return 1 - np.count_nonzero(hit) / hit.size


def _peeled_groups(image: Int[np.ndarray, "cells"]) -> PeriodicGroups:
    """[`periodic_groups`][jaxcell.mapping.periodic_groups] on the host.

    Cells that are nobody's image are transient, so they are dropped, and then those that only they
    led to, as long as there are many. What is left of a dissipative map is next to nothing.
    """
    dropped, left = _peeled(image)
    place = np.empty_like(image)
    place[left] = np.arange(left.size, dtype=image.dtype)
    rest = place[image[left]]
    del place
    found = _groups_of_longer(rest)
    del rest
    # Both numbers of a cell in one, so that they are read and written at once.
    both = np.empty(image.size, np.int64)
    both[left] = (found.group.astype(np.int64) << 32) + found.step
    period = np.zeros(image.size, image.dtype)
    period[: left.size] = found.group_period
    count = found.count
    del found, left
    while dropped:
        cells = dropped.pop()
        for part in np.array_split(cells, 1 + cells.size // _PART):
            both[part] = both[image[part]] + 1
    step = both.astype(np.int32).astype(image.dtype, copy=False)
    group = np.right_shift(both, 32, out=both).astype(image.dtype)
    return PeriodicGroups(group, step, period, count)


def _groups_of_longer(image: Int[np.ndarray, "cells"]) -> PeriodicGroups:
    """The groups of a map as that of a longer one, of few lengths, each of which is compiled once.

    Cells that are added lead to the last of them, a group behind all.
    """
    size = next((size for size in _LENGTHS if size > image.size), bucket(image.size + 1))
    longer = np.full(size, size - 1, image.dtype)
    longer[: image.size] = image
    found = jax.device_get(_groups(longer, None))
    period = found.group_period[: image.size].copy()
    period[found.count - 1 :] = 0
    group, step = found.group[: image.size], found.step[: image.size]
    return PeriodicGroups(group, step, period, np.asarray(found.count - 1))


def _peeled(
    image: Int[np.ndarray, "cells"],
) -> tuple[list[Int[np.ndarray, "_"]], Int[np.ndarray, "left"]]:
    """Transient cells, those first that nothing leads to; and the other cells."""
    reached = np.zeros(image.size, bool)
    reached[image] = True
    dropped = [np.flatnonzero(~reached).astype(image.dtype)]
    cells = np.flatnonzero(reached).astype(image.dtype)
    while True:
        reached[:] = False
        reached[image[cells]] = True
        kept = reached[cells]
        if np.count_nonzero(kept) >= (1 - _WORTH) * cells.size:
            break
        dropped.append(cells[~kept])
        cells = cells[kept]
    del reached, kept
    # How many of those left lead to each.
    count = np.zeros(image.size, np.int32)
    for part in np.array_split(cells, 1 + cells.size // _PART):
        np.add.at(count, image[part], np.int32(1))
    front = cells[count[cells] == 0]
    while front.size > _FRONT:
        dropped.append(front)
        to = image[front]
        last = count[to] == 1
        front = to[last]
        count[front] = 0
        if front.size < to.size:
            several, times = np.unique(to[~last], return_counts=True)
            count[several] -= times.astype(count.dtype)
            front = np.concatenate([front, several[count[several] == 0]])
    alive = count > 0
    alive[front] = True
    return dropped, np.flatnonzero(alive).astype(image.dtype)
