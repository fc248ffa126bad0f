"""Compute on the host what a program of JAX traces.

Outside a program, groups and quantities of chains are computed on the host. A program that is
traced by `jit`, `vmap` or `grad` computes them on the host when it runs, so that its values are the
same. A program cannot raise errors: values that cannot be computed are NaN, -1 or `False`.
"""

import contextlib
import dataclasses
import functools
import math
from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from jaxtyping import Bool, Int

from ..base.callbacks import call_back
from ..base.wide import traced
from .batch import Batch, alike, rows
from .generalized import Chain, are_chains, matrix_of


_FAILED = {"f": np.nan, "c": np.nan, "i": -1, "u": 0, "b": False}


def like(kind: type, *shape: int) -> jax.ShapeDtypeStruct:
    """Describe an array of `float`, `int` or `bool`; the default is a single number."""
    return jax.ShapeDtypeStruct(shape, np.int32 if kind is int else kind)


def on_host(
    compute: Callable[..., Any],
    form: Any,
    chains: Any,
    *args: Any,
    of_steps: bool = False,
    many: Callable[..., Any] | None = None,
) -> Any:
    """Call `compute` on the host: now or, if JAX traces an argument, when the program runs.

    `chains` is a chain or a tuple of chains, for which `compute` gets their transition matrices.
    The other arguments become NumPy arrays. `form` describes the arrays of the result. They have no
    derivatives, which [`implicit`][] adds.

    `compute` is called for each member of a batch or, with `of_steps`, once for all members with
    the same possible steps, whose probabilities do not matter. `many` is a function for the
    members of a batch with the same steps: it gets a [`Batch`][] in place of each matrix, and
    numbers with a row per member, and returns results with a row per member. Members whose results
    are not finite, or all if it raises a `RuntimeError`, are left to `compute`.
    """
    whole: Any
    tree: Any
    outer: Any
    each, whole = jax.tree.flatten(chains, is_leaf=lambda one: isinstance(one, Chain))
    if not traced(chains, args):
        args = tuple(np.asarray(x) if isinstance(x, jax.Array) else x for x in args)
        return compute(whole.unflatten(map(Chain.to_scipy, each)), *args)
    rest, tree = jax.tree.flatten(args)
    slots = [x for one in each for x in (one.image, one.probability)]
    given, count = jax.lax.stop_gradient([*slots, *rest]), len(slots)
    forms, outer = jax.tree.flatten(form)
    axes = [np.ndim(x) for x in given]

    def alone(values: list[Any]) -> list[Any]:
        args = tree.unflatten(map(_value_of, values[count:]))
        try:
            if not all(map(are_chains, values[:count:2], values[1:count:2])):
                raise ValueError("images and probabilities")
            matrices = map(matrix_of, values[:count:2], values[1:count:2])
            result = outer.flatten_up_to(compute(whole.unflatten(matrices), *args))
        except (ValueError, RuntimeError, ArithmeticError):
            result = [np.full(part.shape, _FAILED[part.dtype.kind]) for part in forms]
        return [_filled(*pair) for pair in zip(forms, result, strict=True)]

    def together(values: list[Any], part: Int[np.ndarray, "part"]) -> list[Any]:
        if of_steps:
            return alone([x[part[0]] for x in values])
        if not many:
            return []
        pairs = zip(values[:count:2], values[1:count:2], strict=True)
        batches = (Batch.of(image[part[0]], chance[_rows(chance, part)]) for image, chance in pairs)
        rest = (x[part] if x.dtype.kind == "f" else _value_of(x[part[0]]) for x in values[count:])
        return outer.flatten_up_to(many(whole.unflatten(batches), *tree.unflatten(rest)))

    def call(*given: Any) -> Any:
        values = [np.asarray(x) for x in given]
        leads = [x.shape[: x.ndim - own] for x, own in zip(values, axes, strict=True)]
        lead = np.broadcast_shapes(*leads)
        if not lead:
            return outer.unflatten(alone(values))
        values = [rows(x, own, lead) for x, own in zip(values, axes, strict=True)]
        size = math.prod(lead)
        results = [np.empty((size, *part.shape), part.dtype) for part in forms]
        left = np.ones(size, bool)
        right = left.copy()
        for slots in zip(values[:count:2], values[1:count:2], strict=True):
            right &= are_chains(*(x if x.strides[0] else x[:1] for x in slots))
        with contextlib.suppress(RuntimeError):
            for part in alike(values[:count], values[count:]) if of_steps or many else ():
                part = part[right[part]]
                if part.size == 1 and many and size > 1:
                    # Its numbers do not depend on the other members of the batch.
                    part = np.repeat(part, 2)
                if part.size > (not of_steps):
                    for result, found in zip(results, together(values, part), strict=True):
                        result[part] = found
                    left[part] = ~np.all([_finite(result[part]) for result in results], axis=0)
        for member in np.flatnonzero(left):
            for result, found in zip(results, alone([x[member] for x in values]), strict=True):
                result[member] = found
        return outer.unflatten([x.reshape(*lead, *x.shape[1:]) for x in results])

    same = _identity(compute), _identity(many), of_steps, whole, tree, outer, *forms, *axes
    return call_back(_Call(same, call), form, *given)


@dataclasses.dataclass(frozen=True)
class _Call:
    """A function on the host. JAX compiles calls once that are equal, also outside `jit`."""

    same: tuple[Any, ...]
    function: Callable[..., Any] = dataclasses.field(compare=False)

    def __call__(self, *given: Any) -> Any:
        return self.function(*given)


def _identity(function: Any) -> Any:
    """Return an object that is equal for functions of the same code and the same arguments."""
    if not isinstance(function, functools.partial):
        return function
    return *map(_identity, (function.func, *function.args)), *sorted(function.keywords.items())


def _rows(array: np.ndarray, part: Int[np.ndarray, "part"]) -> Any:
    """Return the indices of rows, of which one is enough if all are the same one in memory."""
    return part if array.strides[0] else part[:1]


def _value_of(array: Any) -> Any:
    """Convert an array without axes to a number."""
    return array if array.ndim else array.item()


def _finite(rows: np.ndarray) -> Bool[np.ndarray, "rows"]:
    return np.isfinite(rows).reshape(len(rows), -1).all(axis=1)


def _filled(form: jax.ShapeDtypeStruct, values: Any) -> np.ndarray:
    """Convert values to an array of the wanted shape, which may have more rows of zeros."""
    values = np.asarray(values, form.dtype)
    if values.shape == form.shape:
        return values
    return np.pad(values, [(0, most - n) for most, n in zip(form.shape, values.shape, strict=True)])


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def _once(name: str, values: Any) -> Any:
    """Return `values`, which have no derivative."""
    return values


@_once.defjvp
def _refuse_derivative(name: str, *_: Any) -> Any:
    raise TypeError(f"{name}: expected no second derivative; only the first one is computed")


def first_derivative_only(name: str) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Mark a `change` of [`implicit`][] that has numbers from the host, which have no derivative.

    A second derivative would lack a term, so it is refused with the `name` of the function.
    """

    def mark(change: Callable[..., Any]) -> Callable[..., Any]:
        change.only_first = name  # type: ignore[attr-defined]
        return change

    return mark


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def implicit(change: Callable[[Any, Any], Any], value: Any, inputs: Any) -> Any:
    """Return `value`, whose derivative is that of `change(value, inputs)` in the inputs.

    `change` is a function of a module: it may not refer to arrays that JAX traces.
    """
    return value


@implicit.defjvp
def _implicit_jvp(change, primals, tangents):  # type: ignore[no-untyped-def]
    if (name := getattr(change, "only_first", None)) is not None:
        primals = _once(name, primals)
    value = implicit(change, *primals)
    _, later = jax.jvp(lambda inputs: change(value, inputs), primals[1:], tangents[1:])
    return value, later
