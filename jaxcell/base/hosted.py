"""Raise clear errors if JAX traces a function that must run on the host.

Most public functions read the values of their arrays. Under `jit`, `vmap` and `grad` arrays have no
values, and the error of JAX mentions only NumPy or `bool`. The packages wrap their functions so
that the error names the function and a remedy.
"""

import dataclasses
import functools
import sys
from collections.abc import Callable
from typing import Any, TypeVar, cast

import lazy_loader  # type: ignore[import-untyped]

from .wide import is_function, traced, wide, widened


_Method = TypeVar("_Method", bound=Callable[..., Any])


class OnHostError(TypeError):
    """JAX traces an argument of a function that reads values on the host."""


def attach(
    package: str, file: str, *, check: bool = False
) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Prepare a package to import the names in its `.pyi` file when they are first used.

    The arguments are `__name__` and `__file__` of the package, and whether its functions check
    their arguments by their annotations. **Returns:** its `__getattr__`,
    `__dir__` and `__all__`.
    """
    get, names, every = lazy_loader.attach_stub(package, file)

    def get_hosted(name: str) -> Any:
        return hosted(package, name, get(name), check)

    return get_hosted, names, every


def hosted(package: str, name: str, value: Any, check: bool = False) -> Any:
    """Wrap a public function so that a call with traced arrays raises an error with a remedy.

    The wrapper also replaces the function in its own module, where `pickle` looks it up.
    """
    if isinstance(value, type):
        return widened(value) if dataclasses.is_dataclass(value) else value
    if is_function(value) and not hasattr(value, "_hosted"):
        if check:
            # Help does without NumPy, which takes .1 s to import.
            from .arguments import checked

            value = checked(value)
        value = hosted_function(wide(value), f"{package}.{name}")
        setattr(sys.modules[value.__module__], value.__name__, value)
        setattr(sys.modules[package], name, value)
    return value


def hosted_function(function: Callable[..., Any], name: str) -> Callable[..., Any]:
    """Wrap a function so that a call with traced arrays raises an error that contains `name`."""

    @functools.wraps(function)
    def call(*args: Any, **options: Any) -> Any:
        try:
            return function(*args, **options)
        except (TypeError, IndexError) as error:
            # A user's function that is traced inside may raise such an error too.
            of_jax = isinstance(error, OnHostError) or type(error).__module__ == "jax.errors"
            if not (of_jax and _holds_traced((args, options))):
                raise
            raise OnHostError(
                f"{name} reads the values of its arrays, on the host: call it outside jit, vmap "
                "and grad"
            ) from error

    call._hosted = True  # type: ignore[attr-defined]
    return call


def _holds_traced(values: Any) -> bool:
    """Return whether JAX traces an array in a tree of values, or in a field of its objects."""
    leaves = sys.modules["jax"].tree.leaves(values)
    fields = [getattr(leaf, "__dict__", {}) for leaf in leaves if dataclasses.is_dataclass(leaf)]
    return traced(leaves) or (bool(fields) and _holds_traced(fields))


def on_host_only(method: _Method) -> _Method:
    """Let a method say that it reads the values of its arrays, if JAX traces one of them."""
    return cast(_Method, hosted_function(method, method.__qualname__))
