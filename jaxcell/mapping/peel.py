import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Int
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from .groups import PeriodicGroups, doubled_groups


# Cells from which on peeling is faster than doubling for all kinds of maps.
_MANY = 1 << 18
# Of what is left, the share that a pass over all of it must drop to be worth it.
_WORTH = 0.2
# Cells at once from which on it is worth to go on from those that were dropped before.
_FRONT = 200


def periodic_groups(
    image: Int[Array, "cells"] | Int[np.ndarray, "cells"],
    where: Bool[Array, "cells"] | Bool[np.ndarray, "cells"] | None = None,
) -> PeriodicGroups:
    """Find the periodic groups of a simple map (Alg. 2.1 of Alam 2018).

    Works on any functional graph, under `jit` and `vmap`, by pointer doubling: the number of rounds
    is about the binary logarithm of the longest transient or period, and each round is a few
    gathers. Of a large map that is given as an array in the memory of the host, cells that nothing
    leads to are peeled off first.

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
    here = not isinstance(image, jax.core.Tracer) and where is None and image.size >= _MANY
    if not here or any(device.platform != "cpu" for device in image.devices()):
        return doubled_groups(image, where)
    found = peeled_groups(np.asarray(image))
    period = np.zeros_like(found.group)
    period[: found.group_period.size] = found.group_period
    return PeriodicGroups(*map(jnp.asarray, (found.group, found.step, period, found.count)))


def peeled_groups(image: Int[np.ndarray, "cells"]) -> PeriodicGroups:
    """Find the periodic groups of a simple map that is given as an array of NumPy.

    The same as [`periodic_groups`][jaxcell.mapping.periodic_groups], on the host: cells that are
    nobody's image are transient, so they are dropped, and then those that only they led to, as long
    as there are many. What is left of a dissipative map is next to nothing; its periodic cells are
    strong components.

    **Arguments:**

    - `image`: the cell that each cell is mapped to.

    **Returns:** [`PeriodicGroups`][jaxcell.mapping.PeriodicGroups] with arrays of NumPy.

    Cells 1 and 2 change places, 3 stays, and 0 comes to the first two:

        >>> import numpy as np
        >>> from jaxcell.mapping.peel import peeled_groups
        >>> groups = peeled_groups(np.array([1, 2, 1, 3], np.int32))
        >>> groups.group.tolist(), groups.step.tolist(), groups.period.tolist()
        ([0, 0, 0, 1], [1, 0, 0, 0], [2, 2, 2, 1])
    """
    dropped, left = _peeled(image)
    place = np.empty_like(image)
    place[left] = np.arange(left.size, dtype=image.dtype)
    group, step, period = _of_rest(place[image[left]])
    # Both numbers of a cell in one, so that they are read and written at once.
    both = np.empty(image.size, np.int64)
    both[left] = (group.astype(np.int64) << 32) + step
    for cells in reversed(dropped):
        both[cells] = both[image[cells]] + 1
    group, step = ((both >> 32).astype(image.dtype), (both & (2**32 - 1)).astype(image.dtype))
    return PeriodicGroups(group, step, period, np.asarray(period.size, image.dtype))


def _peeled(
    image: Int[np.ndarray, "cells"],
) -> tuple[list[Int[np.ndarray, "_"]], Int[np.ndarray, "left"]]:
    """Transient cells, those first that nothing leads to; and the other cells."""
    dropped = []
    cells, reached = np.arange(image.size, dtype=image.dtype), np.empty(image.size, bool)
    while True:
        reached[:] = False
        reached[image[cells]] = True
        kept = reached[cells]
        if np.count_nonzero(kept) >= (1 - _WORTH) * cells.size:
            break
        dropped.append(cells[~kept])
        cells = cells[kept]
    # How many of those left lead to each.
    count = np.bincount(image[cells], minlength=image.size).astype(np.int32)
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


def _of_rest(
    image: Int[np.ndarray, "left"],
) -> tuple[Int[np.ndarray, "left"], Int[np.ndarray, "left"], Int[np.ndarray, "groups"]]:
    """The group and the step of each cell that was not peeled off, and the periods.

    Cells that were do not change the order of the others, so groups are numbered by their smallest
    cells.
    """
    cells = np.arange(image.size, dtype=image.dtype)
    if not cells.size:
        return cells, cells, cells
    edges = np.ones(cells.size, np.int8), image, np.arange(cells.size + 1, dtype=image.dtype)
    graph = csr_array(edges, shape=(cells.size, cells.size))
    count, component = connected_components(graph, connection="strong")
    size = np.bincount(component)
    periodic = (size[component] > 1) | (image == cells)
    on_groups = cells[periodic]
    # Of what is written to one place, the last stays.
    least = np.empty(count, image.dtype)
    least[component[on_groups[::-1]]] = on_groups[::-1]
    of_group = component[on_groups]
    of_group = of_group[least[of_group] == on_groups]
    number = np.empty(count, image.dtype)
    number[of_group] = np.arange(of_group.size, dtype=image.dtype)
    # The first cell of its group that each comes to, by doubling.
    to, step = np.where(periodic, cells, image), (~periodic).astype(image.dtype)
    while (more := step[to]).any():
        to, step = to[to], step + more
    return number[component[to]], step, size[of_group].astype(image.dtype)
