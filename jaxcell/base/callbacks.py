"""Call functions of the host from programs of JAX, also from programs on several devices.

`jax.pure_callback` converts the arguments to arrays of JAX, on the threads that run the program.
If several devices share these threads, each may wait for the other (jax #24255), so programs on
CPUs pass their own memory.
"""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_batching import custom_vmap
from jax.experimental.buffer_callback import buffer_callback
from jax.sharding import NamedSharding, PartitionSpec


def call_back(function: Callable[..., Any], form: Any, *given: Any) -> Any:
    """Call `function` with NumPy arrays when a program runs; `form` describes its result.

    In a batch, all arrays have one more axis in front, which has the length 1 for arrays that are
    the same for all members. If the type of an array tells how the batch is divided among devices,
    each device calls the function for its part.
    """
    call = custom_vmap(_at_runtime(function, form))

    @call.def_vmap
    def _(size: int, batched: list[bool], *given: Any) -> Any:
        given = tuple(
            x if own else jnp.expand_dims(x, 0) for x, own in zip(given, batched, strict=True)
        )
        rows = next(filter(None, map(_rows_on_devices, given)), None)
        share = size if rows is None else rows.shard_shape((size,))[0]
        part = jax.tree.map(lambda x: jax.ShapeDtypeStruct((share, *x.shape), x.dtype), form)
        compute: Callable[..., Any] = functools.partial(call_back, function, part)
        if rows is not None:
            needed = tuple(rows.spec if own else PartitionSpec() for own in batched)
            compute = jax.shard_map(
                compute, mesh=rows.mesh, in_specs=needed, out_specs=rows.spec, check_vma=False
            )
        return compute(*given), jax.tree.map(lambda _: True, form)

    return call(*given)


def _rows_on_devices(array: Any) -> NamedSharding | None:
    """Return how the rows of an array are divided among devices, if its type tells."""
    sharding = jax.typeof(array).sharding
    axis = next(iter(sharding.spec), None)
    return None if axis is None else NamedSharding(sharding.mesh, PartitionSpec(axis))


def _at_runtime(function: Callable[..., Any], form: Any) -> Callable[..., Any]:
    def call(*given: Any) -> Any:
        if jax.default_backend() == "cpu":
            result = buffer_callback(_Fill(function), form)(*given)
        else:
            result = jax.pure_callback(
                lambda *given: function(*map(np.asarray, given)), form, *given
            )
        # In `shard_map`, results differ among devices.
        axes = jax.sharding.get_abstract_mesh().manual_axes
        return jax.lax.pcast(result, tuple(axes), to="varying")

    return call


@dataclasses.dataclass(frozen=True)
class _Fill:
    """A call of a function that writes its results to arrays of JAX in place."""

    function: Callable[..., Any]

    def __call__(self, _: Any, out: Any, *given: Any) -> None:
        result = self.function(*map(np.asarray, given))
        for array, values in zip(*map(jax.tree.leaves, (out, result)), strict=True):
            np.asarray(array)[...] = values
