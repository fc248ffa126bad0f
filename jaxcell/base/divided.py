"""Write programs of JAX for batches that are divided among devices.

The type of an array may tell how it is divided, in `jax.shard_map` or if the axes of a mesh are
explicit. Then JAX refuses some programs that it would run on one device.
"""

from typing import Any

import jax
import jax.numpy as jnp

from .wide import traced


def start_loop(start: Any, *inputs: Any) -> Any:
    """Return the `start` of a loop with the type of values that the loop computes from `inputs`.

    JAX demands that the values after each round are divided among devices as those at the start.
    """

    def typed(value: Any) -> Any:
        for x in jax.tree.leaves(inputs):
            value = value + jnp.zeros_like(x, value.dtype, shape=())
        return value

    return jax.tree.map(typed, start)


def of_members(array: Any, index: Any) -> Any:
    """Return an array, which differs among the members of a batch if the `index` does.

    Otherwise JAX does not infer how `array[index]` is divided if the axes of a mesh are explicit.
    """
    if not jax.sharding.get_abstract_mesh().explicit_axes:
        return array
    # XLA knows that this is true, but a batch does not.
    return jnp.where(jnp.sum(index) * 0 == 0, array, jnp.zeros((), array.dtype))


def put_on_device(values: Any) -> Any:
    """Convert a tree of arrays to arrays of JAX; those that JAX traces remain as they are.

    The derivative of a traced `jax.device_put` would lose how an array is divided.
    """
    if not traced(values):
        return jax.device_put(values)
    return jax.tree.map(jnp.asarray, values)
