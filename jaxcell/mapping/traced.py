"""Compute on the host what a program of JAX traces.

Outside a program, groups and quantities of chains are computed on the host. A program that is
traced by `jit`, `vmap` or `grad` computes them on the host when it runs, so that its values are the
same. A program cannot raise errors: values that cannot be computed are NaN, -1 or `False`.
"""

import functools
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from ..base.wide import traced
from .generalized import Chain


_FAILED = {"f": np.nan, "c": np.nan, "i": -1, "b": False}


def like(kind: type, *shape: int) -> jax.ShapeDtypeStruct:
    """Describe an array of `float`, `int` or `bool`; the default is a single number."""
    return jax.ShapeDtypeStruct(shape, np.int32 if kind is int else kind)


def on_host(compute: Callable[..., Any], form: Any, chains: Any, *args: Any) -> Any:
    """Call `compute` on the host: now or, if JAX traces an argument, when the program runs.

    `chains` is a chain or a tuple of chains, for which `compute` gets their transition matrices.
    The other arguments become NumPy arrays. `form` describes the arrays of the result. They have no
    derivatives, which [`implicit`][] adds.
    """
    if not traced(chains, args):
        args = tuple(np.asarray(x) if isinstance(x, jax.Array) else x for x in args)
        return compute(_matrices(chains), *args)

    def call(chains: Any, *args: Any) -> Any:
        try:
            result = compute(_matrices(chains), *jax.tree.map(_value_of, args))
        except (ValueError, RuntimeError, ArithmeticError):
            result = jax.tree.map(lambda part: np.full(part.shape, _FAILED[part.dtype.kind]), form)
        return jax.tree.map(_filled, form, result)

    fixed = jax.lax.stop_gradient((chains, *args))
    return jax.pure_callback(call, form, *fixed, vmap_method="sequential")


def _matrices(chains: Any) -> Any:
    return jax.tree.map(Chain.to_scipy, chains, is_leaf=lambda one: isinstance(one, Chain))


def _value_of(array: Any) -> Any:
    """Convert an array of JAX to an array of NumPy or, without axes, to a number."""
    values = np.asarray(array)
    return values if values.ndim else values.item()


def _filled(form: jax.ShapeDtypeStruct, values: Any) -> np.ndarray:
    """Convert values to an array of the wanted shape, which may have more rows of zeros."""
    values = np.asarray(values, form.dtype)
    if values.shape == form.shape:
        return values
    return np.pad(values, [(0, most - n) for most, n in zip(form.shape, values.shape, strict=True)])


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def implicit(change: Callable[[Any, Any], Any], value: Any, inputs: Any) -> Any:
    """Return `value`, whose derivative is that of `change(value, inputs)` in the inputs.

    `change` is a function of a module: it may not refer to arrays that JAX traces.
    """
    return value


@implicit.defjvp
def _implicit_jvp(change, primals, tangents):  # type: ignore[no-untyped-def]
    value = implicit(change, *primals)
    _, later = jax.jvp(lambda inputs: change(value, inputs), primals[1:], tangents[1:])
    return value, later
