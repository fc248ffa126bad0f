"""Wrap public functions and classes, which are imported when they are first used."""

import dataclasses
import sys
from collections.abc import Callable
from typing import Any

import lazy_loader  # type: ignore[import-untyped]

from .optional_modules import explained
from .wide import is_function, wide, widened


def attach(
    package: str, file: str
) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Prepare a package to import the names in its `.pyi` file when they are first used.

    The arguments are `__name__` and `__file__` of the package. **Returns:** its `__getattr__`,
    `__dir__` and `__all__`.
    """
    get, names, every = lazy_loader.attach_stub(package, file)

    def get_hosted(name: str) -> Any:
        try:
            return hosted(package, name, get(name))
        except ModuleNotFoundError as error:
            raise explained(error) from None

    return get_hosted, names, every


def hosted(package: str, name: str, value: Any) -> Any:
    """Wrap a public function, or the methods of a public class, as [`wide`][] does.

    Functions and class methods check their arguments by their annotations. The wrapper of a
    function also replaces it in its own module, where `pickle` looks it up.
    """
    # Help does without NumPy, which takes .1 s to import.
    if isinstance(value, type) and dataclasses.is_dataclass(value):
        if "_hosted" not in vars(value):
            from .arguments import check_methods

            value._hosted = True  # type: ignore[attr-defined]
            check_methods(value)
        return widened(value)
    if is_function(value) and not hasattr(value, "_wide"):
        from .arguments import checked

        value = wide(checked(value, name), f"{package}.{name}")
        setattr(sys.modules[value.__module__], value.__name__, value)
        setattr(sys.modules[package], name, value)
    return value
