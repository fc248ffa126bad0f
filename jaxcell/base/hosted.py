"""Raise clear errors if JAX traces a function that must run on the host.

Most public functions read the values of their arrays. Under `jit`, `vmap` and `grad` arrays have no
values, and the error of JAX mentions only NumPy or `bool`. The packages wrap their functions so
that the error names the function and a remedy.
"""

import functools
import sys
from collections.abc import Callable
from types import FunctionType
from typing import Any

import lazy_loader  # type: ignore[import-untyped]


def attach(
    package: str, file: str
) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Prepare a package to import the names in its `.pyi` file when they are first used.

    The arguments are `__name__` and `__file__` of the package. **Returns:** its `__getattr__`,
    `__dir__` and `__all__`.
    """
    get, names, every = lazy_loader.attach_stub(package, file)

    def get_hosted(name: str) -> Any:
        return hosted(package, name, get(name))

    return get_hosted, names, every


def hosted(package: str, name: str, value: Any) -> Any:
    """Wrap a public function so that a call with traced arrays raises an error with a remedy.

    The wrapper also replaces the function in its own module, where `pickle` looks it up.
    """
    if isinstance(value, FunctionType) and not hasattr(value, "_hosted"):
        value = hosted_function(value, f"{package}.{name}")
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
            if not (type(error).__module__ == "jax.errors" and _traced(args, options)):
                raise
            raise TypeError(
                f"{name} reads the values of its arrays, on the host: call it outside jit, vmap "
                "and grad"
            ) from error

    call._hosted = True  # type: ignore[attr-defined]
    return call


def _traced(*values: Any) -> bool:
    # JAX is not imported here: it is loaded if it has raised an error.
    jax: Any = sys.modules["jax"]
    return any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(values))
