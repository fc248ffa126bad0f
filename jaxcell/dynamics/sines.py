"""Sines and cosines as polynomials, which a CPU computes for many points at once.

On a CPU, XLA calls the C library for each point. In most fields, this takes most of the time.
"""

import functools
import math
from collections.abc import Callable
from typing import Any, TypeVar, cast

import jax
import jax.numpy as jnp
from jax import lax
from jax.extend.core import ClosedJaxpr, JaxprEqn, jaxpr_as_fun
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
    """Replace the sines and cosines in a function by polynomials, where it runs on a CPU."""

    @functools.wraps(function)
    def of_polynomials(*arguments: Any) -> Result:
        traced, shape = jax.make_jaxpr(function, return_shape=True)(*arguments)
        leaves = jaxpr_as_fun(_changed(traced, _as_polynomial))(*jax.tree.leaves(arguments))
        return cast("Result", jax.tree.unflatten(jax.tree.structure(shape), leaves))

    return of_polynomials


def without_polynomials(traced: ClosedJaxpr) -> ClosedJaxpr:
    """Turn polynomials of [`with_sines`][jaxcell.dynamics.sines.with_sines] back into sines."""
    return _changed(traced, _as_sine)


def _changed(traced: ClosedJaxpr, change: Callable[[JaxprEqn], JaxprEqn | None]) -> ClosedJaxpr:
    """Replace each operation, also in inner programs, for which `change` returns another one."""
    steps = []
    for step in traced.jaxpr.eqns:
        changed = change(step)
        if changed is None and isinstance(inner := step.params.get("jaxpr"), ClosedJaxpr):
            changed = step.replace(params={**step.params, "jaxpr": _changed(inner, change)})
        steps.append(changed or step)
    return ClosedJaxpr(traced.jaxpr.replace(eqns=steps), traced.consts)


def _as_polynomial(step: JaxprEqn) -> JaxprEqn | None:
    kind: Any = step.outvars[0].aval
    if step.primitive not in (lax.sin_p, lax.cos_p) or kind.dtype.name not in _PI:
        return None
    own = jax.jit(_cosine if step.primitive is lax.cos_p else _sine)
    return _replaced(step, own)


def _as_sine(step: JaxprEqn) -> JaxprEqn | None:
    for ours, plain in ((_sine, lax.sin), (_cosine, lax.cos)):
        if step.params.get("name") == ours.__name__ and len(step.invars) == 1:
            # A function of a user may have the same name.
            known = _replaced(step, jax.jit(ours))
            if str(known.params["jaxpr"]) == str(step.params["jaxpr"]):
                return _replaced(step, plain)
    return None


def _replaced(step: JaxprEqn, function: Callable[[Any], Any]) -> JaxprEqn:
    kind: Any = step.outvars[0].aval
    (call,) = jax.make_jaxpr(function)(jax.ShapeDtypeStruct(kind.shape, kind.dtype)).eqns
    return step.replace(primitive=call.primitive, params=call.params)


def _sine(x: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    here = functools.partial(polynomial, first=0.0)
    return lax.platform_dependent(x, cpu=here, default=jnp.sin)


def _cosine(x: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    here = functools.partial(polynomial, first=0.5)
    return lax.platform_dependent(x, cpu=here, default=jnp.cos)


def polynomial(x: Float[Array, "*shape"], first: float) -> Float[Array, "*shape"]:
    """Compute `sin(x + first * pi)`, with an absolute error of at most two machine epsilons."""
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
