"""Say that a function runs on the host, where JAX says that an array is traced.

Most public functions read the values of their arrays. Under `jit`, `vmap` and `grad` there are no
values, and what JAX raises then names NumPy or `bool`. The packages pass their functions through
here, so that the error names the function and what to do.
"""

import functools
import sys
from collections.abc import Callable
from types import FunctionType
from typing import Any


def attach(
    package: str, file: str
) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Import the names in the stub of a package when they are first used.

    **Arguments:**

    - `package`, `file`: `__name__` and `__file__` of the package.

    **Returns:** its `__getattr__`, `__dir__` and `__all__`.
    """
    # A robot's host may be without it.
    import lazy_loader  # type: ignore[import-untyped]

    get, names, every = lazy_loader.attach_stub(package, file)

    def get_hosted(name: str) -> Any:
        return hosted(package, name, get(name))

    return get_hosted, names, every


def attach_all(package: str) -> None:
    """Pass the functions that a package has imported through [`hosted`][]."""
    for name, value in list(vars(sys.modules[package]).items()):
        if not name.startswith("_"):
            hosted(package, name, value)


def hosted(package: str, name: str, value: Any) -> Any:
    """Let a public function say that it runs on the host if it is given traced arrays.

    The function is replaced in its own module too, where `pickle` looks for it.

    **Arguments:**

    - `package`: the package with the function.
    - `name`: its name there.
    - `value`: the function; anything else stays as it is.

    **Returns:** what the package has by that name from now on.
    """
    if isinstance(value, FunctionType) and not hasattr(value, "_hosted"):
        value = hosted_function(value, f"{package}.{name}")
        setattr(sys.modules[value.__module__], value.__name__, value)
        setattr(sys.modules[package], name, value)
    return value


def hosted_function(function: Callable[..., Any], name: str) -> Callable[..., Any]:
    """Wrap a function so that it says that it runs on the host, under a name."""

    @functools.wraps(function)
    def call(*args: Any, **options: Any) -> Any:
        try:
            return function(*args, **options)
        except (TypeError, IndexError) as error:
            # An error in a function of the user's own, which is traced inside, is not ours.
            if not (type(error).__module__ == "jax.errors" and _traced(args, options)):
                raise
            raise TypeError(
                f"{name} reads the values of its arrays, on the host: call it outside jit, vmap "
                "and grad"
            ) from error

    call._hosted = True  # type: ignore[attr-defined]
    return call


def _traced(*values: Any) -> bool:
    # It is loaded, since it raised an error; not all that is hosted needs it.
    jax: Any = sys.modules["jax"]
    return any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(values))
