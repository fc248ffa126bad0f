"""Find periodic groups on a CPU in one walk over the map, cell by cell.

XLA compiles the loop to one function of machine code. Each step reads and writes only a few bytes.
XLA would copy an array if a step read its old contents after writing to it, so no step does.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.experimental.custom_partitioning import custom_partitioning
from jax.sharding import NamedSharding, PartitionSpec as P
from jaxtyping import Array, Int

from .groups import PeriodicGroups


@jax.jit
def walked_groups(image: Int[Array, "cells"]) -> PeriodicGroups:
    """Compute [`jaxcell.mapping.periodic_groups`][] with Alg. 2.1, which maps every cell once."""
    if not image.size:
        return PeriodicGroups(image, image, image, jnp.zeros((), image.dtype))
    groups = _walk(image.astype(jnp.int32))
    return PeriodicGroups(*(numbers.astype(image.dtype) for numbers in groups))


@jax.jit
def walked_leaders(
    image: Int[Array, "cells"] | Int[np.ndarray, "cells"],
) -> tuple[Int[Array, "cells"], Int[Array, "cells"]]:
    """Find the smallest cell of the group of each cell, and the number of steps to the group.

    It takes 8 bytes per cell besides the image.
    """
    chain, place, _ = _chains(jnp.asarray(image), jnp.zeros_like(image, shape=1))
    return _ended(chain, place, None)


@jax.custom_batching.custom_vmap
def _walk(images: Int[Array, "*batch cells"]) -> tuple[Int[Array, "..."], ...]:
    """Walk over the maps of a batch one after another, on each device over its own maps."""
    if images.ndim == 1:
        return _walk_once(images)
    if jax.sharding.get_abstract_mesh().explicit_axes:
        axes = P(*jax.typeof(images).sharding.spec[:-1])
        return jax.shard_map(_one_by_one, in_specs=axes, out_specs=axes)(images)
    return _on_each_device(images)


_walk.def_vmap(lambda _, __, images: (_walk(images), (True,) * 4))


def _walk_once(image: Int[Array, "cells"]) -> tuple[Int[Array, "..."], ...]:
    chain, place, period = _chains(image, jnp.zeros_like(image, shape=image.size + 1))
    number, periods, count = _numbered(period)
    return *_ended(chain, place, number), periods, count


def _one_by_one(images: Int[Array, "*batch cells"]) -> tuple[Int[Array, "..."], ...]:
    batch = images.shape[:-1]
    groups = lax.map(_walk_once, images.reshape(-1, images.shape[-1]))
    return tuple(x.reshape(*batch, *x.shape[1:]) for x in groups)


def _divided(mesh: Any, arguments: Any, results: Any) -> Any:
    spec = arguments[0].sharding.spec[: arguments[0].ndim - 1]
    axes = NamedSharding(mesh, P(*spec))
    return mesh, _one_by_one, (axes,) * len(results), (axes,)


_on_each_device = custom_partitioning(_one_by_one)
_on_each_device.def_partition(
    _divided,
    sharding_rule="... cell -> ... cell, ... cell, ... cell, ...",
    need_replication_factors=("cell",),
)


def _chains(
    image: Int[Array, "cells"], period: Int[Array, "places"]
) -> tuple[Int[Array, "cells"], Int[Array, "cells"], Int[Array, "places"]]:
    """Follow the orbit of each cell to a cell that was visited before; the new cells are a *chain*.

    The argument `period` is an array of zeros into which the periods are written. It has an entry
    per cell and one more entry, or a single entry to discard the periods. Returns

    - `chain`: for each cell, 1 plus the first cell of its chain (0 marks cells that are not yet
        visited); for the first cell of a chain, -1 minus the smallest cell of the group.
    - `place`: for each cell, its position in its chain; for the first cell of a chain, the number
        of steps to the group.
    - `period`: for the smallest cell of each group, its period; 0 for other cells. The additional
        last entry has no meaning: chains that lead to a known group write to it.
    """
    cells = image.shape[0]
    zero = jnp.zeros_like(image, shape=())

    def follow_chain(state: Any) -> Any:
        first, chain, place, period = state
        name = first + 1

        def advance(state: Any) -> Any:
            cell, length, _, _, chain, place = state
            chain, place = _put(chain, cell, name), _put(place, cell, length)
            cell = _at(image, cell)
            return cell, length + 1, _at(chain, cell), _at(place, cell), chain, place

        # `seen` and `at` are the entries of the cell that ends the chain.
        state = (first, zero, zero, zero, chain, place)
        state = lax.while_loop(lambda state: state[2] == 0, advance, state)
        cell, length, seen, at, chain, place = state
        new = seen == name

        def to_first(state: Any) -> Any:
            return _at(chain, state[0] - 1), _at(place, state[0] - 1)

        held, steps = lax.while_loop(
            lambda state: (state[0] > 0) & (state[0] != name), to_first, (seen, at)
        )
        steps = jnp.where(seen > 0, jnp.maximum(0, steps - at), at)

        def around(state: Any) -> Any:
            other, least, left = state
            return _at(image, other), jnp.minimum(least, other), left - 1

        # A group that starts with its chain has its smallest cell at the start.
        left = jnp.where(new & (at > 0), length - at, 0)
        _, least, _ = lax.while_loop(lambda state: state[2] > 0, around, (cell, cell, left))
        period = _put(period, jnp.where(new, least, cells), length - at)
        chain = _put(chain, first, jnp.where(new, -1 - least, held))
        place = _put(place, first, jnp.where(new, at, length + steps))
        first, _ = lax.while_loop(
            lambda state: (state[0] < cells) & (state[1] != 0),
            lambda state: (state[0] + 1, _at(chain, state[0] + 1)),
            (first, name),
        )
        return first, chain, place, period

    none = jnp.zeros_like(image)
    state = (zero, none, none, period)
    return lax.while_loop(lambda state: state[0] < cells, follow_chain, state)[1:]


def _numbered(
    period: Int[Array, "places"],
) -> tuple[Int[Array, "places"], Int[Array, "places-1"], Int[Array, ""]]:
    """Number the groups in the order of their smallest cells.

    Returns the number of each group at its smallest cell, the periods of the groups, and the number
    of groups. `period` is the result of `_chains`.
    """

    def step(state: Any) -> Any:
        cell, count, here, number, periods = state
        periods, number = _put(periods, count, here), _put(number, cell, count)
        count = count + (here > 0).astype(jnp.int32)
        return cell + 1, count, _at(number, cell + 1), number, periods

    zero, periods = (jnp.zeros_like(period, shape=shape) for shape in ((), period.size - 1))
    _, count, _, number, periods = lax.while_loop(
        lambda state: state[0] < periods.size, step, (zero, zero, period[0], period, periods)
    )
    return number, periods, count


def _ended(
    chain: Int[Array, "cells"],
    place: Int[Array, "cells"],
    number: Int[Array, "places"] | None,
) -> tuple[Int[Array, "cells"], Int[Array, "cells"]]:
    """Compute the group of each cell, and the number of steps to it, from the results of `_chains`.

    If `number` is `None`, the smallest cell of a group stands for the number of the group.
    Cells are processed from the last to the first, because a chain starts with its smallest cell,
    whose entries are needed until all other cells of the chain are done.
    """

    def step(state: Any) -> Any:
        cell, name, at, chain, place = state
        first = jnp.where(name > 0, name - 1, cell)
        least = -1 - _at(chain, first)
        group = least if number is None else _at(number, least)
        steps = jnp.maximum(0, _at(place, first) - jnp.where(name > 0, at, 0))
        chain, place = _put(chain, cell, group), _put(place, cell, steps)
        cell = cell - 1
        return cell, _at(chain, cell), _at(place, cell), chain, place

    last = jnp.full_like(chain, chain.size - 1, shape=())
    state = last, chain[-1], place[-1], chain, place
    return lax.while_loop(lambda state: state[0] >= 0, step, state)[-2:]


def _at(array: Int[Array, "size"], place: Int[Array, ""]) -> Int[Array, ""]:
    return lax.dynamic_slice(array, (place,), (1,), allow_negative_indices=False)[0]


def _put(
    array: Int[Array, "size"], place: Int[Array, ""], value: Int[Array, ""]
) -> Int[Array, "size"]:
    return lax.dynamic_update_slice(array, value[None], (place,), allow_negative_indices=False)
