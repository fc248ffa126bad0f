import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jax import lax
from jaxtyping import Array, Int

from ..base.indices import as_array, check_indices
from .groups import PeriodicGroups, doubled_groups
from .section import bucket
from .walk import walked_groups


# Peeling is tried for maps with at least this number of cells.
MANY = 1 << 18
# A pass over all remaining cells is worth its time if it drops this share of them.
_WORTH = 0.2
# Peeling goes on from the images of dropped cells while there are more than this number.
FRONT = 200
# Number of cells that are computed at once.
PART = 1 << 20
# Sizes to which shorter maps are padded; the walk over padding takes almost no time.
_LENGTHS = 1 << 12, 1 << 14, 1 << 16, 1 << 18


def periodic_groups(image: npt.ArrayLike) -> PeriodicGroups:
    """Find the periodic groups of a simple map (Alg. 2.1 of Alam 2018).

    It works under `jit` and `vmap`, where images that are out of range are not refused; a batch of
    maps that is divided among devices stays divided. On a CPU it maps every cell once. If the map
    is large, and many of its cells have no preimage, these cells are removed first, except under
    `jit`. On an accelerator it squares the map repeatedly, `f, f^2, f^4, ...`: the number of rounds
    is about the binary logarithm of the longest transient or period, and a round is a few gather
    operations.

    **Arguments:** the image of each cell; a sink needs a cell of its own. **Returns:** the group
    and the step of each cell.

    Cells 1 and 2 lead to each other, cell 3 leads to itself, and cell 0 leads to cell 1:

        >>> import jax.numpy as jnp
        >>> from jaxcell.mapping import periodic_groups
        >>> groups = periodic_groups(jnp.array([1, 2, 1, 3]))
        >>> groups.group.tolist(), groups.step.tolist(), groups.period.tolist()
        ([0, 0, 0, 1], [1, 0, 0, 0], [2, 2, 2, 1])
    """
    image = as_array(image, "image")
    if image.ndim != 1:
        raise ValueError(f"image: expected the image of each cell, got shape {image.shape}")
    sink = "; give a sink a cell of its own that leads to itself"
    image = jnp.asarray(check_indices(image, image.size, "image", instead=sink))
    here = not isinstance(image, jax.core.Tracer)
    if here and all(device.platform == "cpu" for device in image.devices()):
        on_host = np.asarray(image)
        if _worth_peeling(on_host):
            return jax.device_put(peeled_groups(on_host))
    return _groups(image)


def groups_on_host(image: Int[np.ndarray, "cells"]) -> PeriodicGroups:
    """Compute [`periodic_groups`][jaxcell.mapping.periodic_groups] on the host, in NumPy.

    It takes at most 16 bytes per cell besides the image and the result. The periods of the groups
    are not padded with zeros.
    """
    if _worth_peeling(image):
        groups = peeled_groups(image)
    elif image.size < MANY:
        groups = _groups_of_longer(image)
    else:
        groups = jax.device_get(_groups(image))
    return dataclasses.replace(groups, group_period=groups.group_period[: groups.count].copy())


def _worth_peeling(image: Int[np.ndarray, "cells"]) -> bool:
    return bool(image.size >= MANY and _missed(image) >= _WORTH)


@jax.jit
def _groups(image: Int[Array, "cells"]) -> PeriodicGroups:
    groups: PeriodicGroups = lax.platform_dependent(
        image, cpu=walked_groups, default=doubled_groups
    )
    return groups


def _missed(image: Int[np.ndarray, "cells"]) -> float:
    """Estimate the share of cells without preimages, from every 64th cell."""
    hit = np.zeros(-(-image.size // 64), bool)
    hit[image[image % 64 == 0] // 64] = True
    return 1 - np.count_nonzero(hit) / hit.size


def peeled_groups(image: Int[np.ndarray, "cells"]) -> PeriodicGroups:
    """Compute [`periodic_groups`][jaxcell.mapping.periodic_groups] on the host by peeling.

    Cells without preimages are transient, so they are removed. Then the cells whose preimages were
    all removed are removed as well, and so on, as long as many cells can be removed. Few cells of a
    dissipative map remain, and their groups are found as usual.
    """
    dropped, left = _peeled(image)
    place = np.empty_like(image)
    place[left] = np.arange(left.size, dtype=image.dtype)
    rest = place[image[left]]
    del place
    core = _groups_of_longer(rest)
    del rest
    # Both numbers of a cell are packed into one, so that they are read and written at once.
    both = np.empty(image.size, np.int64)
    both[left] = (core.group.astype(np.int64) << 32) + core.step
    period = np.zeros(image.size, image.dtype)
    period[: left.size] = core.group_period
    count = core.count
    del core, left
    while dropped:
        cells = dropped.pop()
        for part in np.array_split(cells, 1 + cells.size // PART):
            both[part] = both[image[part]] + 1
    step = both.astype(np.int32).astype(image.dtype, copy=False)
    group = np.right_shift(both, 32, out=both).astype(image.dtype)
    return PeriodicGroups(group, step, period, count)


def _groups_of_longer(image: Int[np.ndarray, "cells"]) -> PeriodicGroups:
    """Compute the groups of a map padded to one of a few lengths, as JAX compiles once per length.

    The cells of the padding lead to the last cell, which is the last group.
    """
    size = next((size for size in _LENGTHS if size > image.size), bucket(image.size + 1))
    longer = np.full(size, size - 1, image.dtype)
    longer[: image.size] = image
    padded = jax.device_get(_groups(longer))
    period = padded.group_period[: image.size].copy()
    period[padded.count - 1 :] = 0
    group, step = padded.group[: image.size], padded.step[: image.size]
    return PeriodicGroups(group, step, period, np.asarray(padded.count - 1))


def _peeled(
    image: Int[np.ndarray, "cells"],
) -> tuple[list[Int[np.ndarray, "_"]], Int[np.ndarray, "left"]]:
    """Return the removed cells, in lists in the order of removal, and the remaining cells."""
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
    # The number of remaining preimages of each cell.
    count = np.zeros(image.size, np.int32)
    for part in np.array_split(cells, 1 + cells.size // PART):
        np.add.at(count, image[part], np.int32(1))
    front = cells[count[cells] == 0]
    while front.size > FRONT:
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
