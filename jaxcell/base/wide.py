"""Compute with 64-bit numbers in programs that have not turned them on.

JAX uses 32 bits by default, too few for probabilities and linear solves. Public functions and the
methods of their results compute in a context of JAX with 64 bits. The setting of the program does
not change. Outside the context JAX would round the 64-bit arrays of a result at the next operation,
so the result gets NumPy arrays in their place.

Some functions read the values of their arrays. Under `jit`, `vmap` and `grad` arrays have no
values, and the error of JAX mentions only NumPy or `bool`. Their error names the function instead.
"""

import dataclasses
import functools
import inspect
import sys
from collections.abc import Callable, Sequence
from types import FunctionType
from typing import Any, TypeVar

from .optional_modules import explained


_Class = TypeVar("_Class", bound=type)

# Types that JAX rounds to 32 bits.
_ROUNDED = ("float64", "int64", "uint64", "complex128")
# Packages without JAX.
_HOST = tuple(f"jaxcell.{name}." for name in ("automata", "robot", "space", "walls"))


class OnHostError(TypeError):
    """JAX traces an argument of a function that reads values on the host."""


def wide(function: Callable[..., Any], name: str | None = None) -> Callable[..., Any]:
    """Wrap a function so that it computes with 64 bits, unless JAX traces it for a program.

    If it cannot be traced, an error contains `name`, by default that of the function in its module.
    """
    if getattr(function, "_wide", False) or inspect.isgeneratorfunction(function):
        return function

    creates = function.__name__ == "__init__"

    @functools.wraps(function)
    def call(*args: Any, **options: Any) -> Any:
        # JAX is not imported here: some programs on a robot do not have it.
        jax: Any = sys.modules.get("jax")
        args, options = _each(_native, args), _each(_native, options)
        try:
            if jax is None or jax.config.jax_enable_x64 or traced(args[creates:], options):
                return function(*args, **options)
            args, options = _each(_given, args), _each(_given, options)
            with jax.enable_x64(True):
                result = function(*args, **options)
        except (TypeError, IndexError) as error:
            # A user's function that is traced inside may raise such an error too.
            of_jax = isinstance(error, OnHostError) or type(error).__module__ == "jax.errors"
            if not (of_jax and _holds_traced((args, options))):
                raise
            raise OnHostError(
                f"{name or function.__qualname__} reads the values of its arrays, on the host: "
                "call it outside jit, vmap and grad"
            ) from error
        except ModuleNotFoundError as error:
            raise explained(error) from None
        kept = _kept(args[0] if creates else result)
        return None if creates else kept

    call._wide = True  # type: ignore[attr-defined]
    return call


def is_function(value: Any) -> bool:
    """Return whether a value is a function, also one that `jax.jit` has wrapped."""
    return isinstance(value, FunctionType) or type(value).__name__ == "PjitFunction"


def traced(*values: Any) -> bool:
    """Return whether JAX traces an array in a tree of values."""
    jax: Any = sys.modules.get("jax")
    return jax is not None and any(
        isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(values)
    )


def _holds_traced(values: Any) -> bool:
    """Return whether JAX traces an array in a tree of values, or in a field of its objects."""
    leaves = sys.modules["jax"].tree.leaves(values)
    fields = [getattr(leaf, "__dict__", {}) for leaf in leaves if dataclasses.is_dataclass(leaf)]
    return traced(leaves) or (bool(fields) and _holds_traced(fields))


def namespace(*values: Any) -> Any:
    """Return the module for arrays: that of JAX if it traces one of the values, or NumPy."""
    return sys.modules["jax.numpy" if traced(values) else "numpy"]


def host_array(array: Any) -> Any:
    """Convert an array of JAX to an array of NumPy, unless JAX traces it."""
    return array if traced(array) else sys.modules["jax"].device_get(array)


def as_number(array: Any) -> Any:
    """Convert an array without axes to a number of Python, unless JAX traces it."""
    return array if traced(array) else array.item()


def widened(kind: _Class) -> _Class:
    """Let the public methods and properties of a class compute with 64 bits."""
    if "_widened" in vars(kind) or kind.__module__.startswith(_HOST):
        return kind
    kind._widened = True  # type: ignore[attr-defined]
    for name, value in list(vars(kind).items()):
        if name.startswith(("_", "tree_")) and name not in ("__init__", "__call__"):
            continue
        if isinstance(value, functools.cached_property):
            value.func = wide(value.func)
        elif isinstance(value, property):
            setattr(kind, name, property(wide(value.fget), doc=value.__doc__))  # type: ignore[arg-type]
        elif isinstance(value, classmethod):
            setattr(kind, name, classmethod(wide(value.__func__)))
        elif is_function(value):
            setattr(kind, name, wide(value))
    return kind


def _each(change: Callable[[Any], Any], value: Any) -> Any:
    """Change each array in a tree of arguments; containers without a change stay the same ones."""
    if type(value) in (tuple, list) and not _has_numbers(value):
        parts = [_each(change, part) for part in value]
        same = all(new is old for new, old in zip(parts, value, strict=True))
        return value if same else type(value)(parts)
    if type(value) is dict:
        changed = {key: _each(change, part) for key, part in value.items()}
        return value if all(changed[key] is value[key] for key in value) else changed
    return change(value)


def _native(value: Any) -> Any:
    """Convert arrays with the byte order of another machine, which JAX refuses."""
    kind: Any = getattr(value, "dtype", None)
    if getattr(kind, "isnative", True) or not hasattr(value, "astype"):
        return value
    return value.astype(kind.newbyteorder("="))


def _given(value: Any) -> Any:
    """Convert 32-bit floats of JAX, which would round the numbers they meet."""
    jax: Any = sys.modules["jax"]
    if isinstance(value, jax.Array) and value.dtype == "float32":
        return jax.device_get(value).astype("float64")
    return value


def _kept(value: Any) -> Any:
    """Replace 64-bit arrays of JAX in a result by NumPy arrays, which JAX does not round."""
    jax: Any = sys.modules["jax"]
    if isinstance(value, jax.Array):
        concrete = not isinstance(value, jax.core.Tracer)
        return jax.device_get(value) if concrete and value.dtype in _ROUNDED else value
    if isinstance(value, tuple | list):
        if _has_numbers(value):
            return value
        parts = [_kept(part) for part in value]
        if all(new is old for new, old in zip(parts, value, strict=True)):
            return value
        return type(value)(*parts) if hasattr(value, "_fields") else type(value)(parts)
    if isinstance(value, dict):
        kept = {key: _kept(part) for key, part in value.items()}
        return value if all(kept[key] is value[key] for key in value) else kept
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        for base in (kinds := [kind for kind in type(value).__mro__ if _is_own(kind)]):
            widened(base)
        if kinds:
            for name, part in list(vars(value).items()):
                if (new := _kept(part)) is not part:
                    object.__setattr__(value, name, new)
    return value


def _has_numbers(value: Sequence[Any]) -> bool:
    """Return whether a long sequence need not be searched for arrays."""
    return not value or isinstance(value[0], str | int | float)


def _is_own(kind: type) -> bool:
    return kind.__module__.startswith("jaxcell.") and not kind.__module__.startswith(_HOST)
