"""Sines of many points at once on processors.

On processors XLA calls the C library for each point, which takes longer than the rest of most
fields. The vector units compute a polynomial for many points in the time of one.
"""

import functools
import math
from collections.abc import Callable
from typing import Any, TypeVar, cast

import jax
import jax.numpy as jnp
from jax import lax
from jax.extend.core import ClosedJaxpr, jaxpr_as_fun
from jaxtyping import Array, Float


Result = TypeVar("Result")

# Pi as a sum. Its first terms have so few bits (8 in 32 bits) that their multiples are exact.
_PI = {
    "float32": (3.140625, 9.65118408203125e-4, 2.5331974029541016e-6, 1.984187258941006e-9),
    "float64": (3.1415926218032837, 3.178650942459171e-8, 1.2246467864107189e-16, 1.27366343e-24),
}
# Number of terms of the series for an error of half a unit in the last place at a quarter turn.
_TERMS = {"float32": 6, "float64": 11}


def with_sines(function: Callable[..., Result]) -> Callable[..., Result]:
    """Return the same function with sines and cosines that are polynomials on processors."""

    @functools.wraps(function)
    def of_polynomials(*arguments: Any) -> Result:
        traced, shape = jax.make_jaxpr(function, return_shape=True)(*arguments)
        leaves = jaxpr_as_fun(_changed(traced))(*jax.tree.leaves(arguments))
        return cast("Result", jax.tree.unflatten(jax.tree.structure(shape), leaves))

    return of_polynomials


def _changed(traced: ClosedJaxpr) -> ClosedJaxpr:
    steps = []
    for step in traced.jaxpr.eqns:
        kind = step.outvars[0].aval
        if step.primitive in (lax.sin_p, lax.cos_p) and kind.dtype.name in _PI:
            own = jax.jit(_cosine if step.primitive is lax.cos_p else _sine)
            (call,) = jax.make_jaxpr(own)(jax.ShapeDtypeStruct(kind.shape, kind.dtype)).eqns
            step = step.replace(primitive=call.primitive, params=call.params)
        elif isinstance(inner := step.params.get("jaxpr"), ClosedJaxpr):
            step = step.replace(params={**step.params, "jaxpr": _changed(inner)})
        steps.append(step)
    return ClosedJaxpr(traced.jaxpr.replace(eqns=steps), traced.consts)


def _sine(x: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    here = functools.partial(_polynomial, first=0.0)
    return lax.platform_dependent(x, cpu=here, default=jnp.sin)


def _cosine(x: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    here = functools.partial(_polynomial, first=0.5)
    return lax.platform_dependent(x, cpu=here, default=jnp.cos)


def _polynomial(x: Float[Array, "*shape"], first: float) -> Float[Array, "*shape"]:
    """Compute the sine that rises through 0 at `first` half turns.

    The error is at most two units in the last place of 1.
    """
    turns = jnp.round(x / math.pi - first)
    for part in _PI[x.dtype.name]:
        x = x - (turns + first) * part
    # If angles are so large that the turn is unknown, the result is still a value of a sine.
    x = jnp.clip(x, -2, 2)
    square, series = x * x, jnp.zeros_like(x)
    for k in reversed(range(_TERMS[x.dtype.name])):
        series = series * square + (-1) ** k / math.factorial(2 * k + 1)
    half = (turns + 2 * first) / 2
    return x * series * (1 - 4 * (half - jnp.floor(half)))
