"""Wrap public functions and classes, which are imported when they are first used."""

import dataclasses
import sys
from collections.abc import Callable
from typing import Any

import lazy_loader  # type: ignore[import-untyped]

from .optional_modules import explained
from .wide import is_function, wide, widened


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
        try:
            return hosted(package, name, get(name), check)
        except ModuleNotFoundError as error:
            raise explained(error) from None

    return get_hosted, names, every


def hosted(package: str, name: str, value: Any, check: bool = False) -> Any:
    """Wrap a public function, or the methods of a public class, as [`wide`][] does.

    The wrapper of a function also replaces it in its own module, where `pickle` looks it up.
    """
    if isinstance(value, type):
        return widened(value) if dataclasses.is_dataclass(value) else value
    if is_function(value) and not hasattr(value, "_wide"):
        if check:
            # Help does without NumPy, which takes .1 s to import.
            from .arguments import checked

            value = checked(value)
        value = wide(value, f"{package}.{name}")
        setattr(sys.modules[value.__module__], value.__name__, value)
        setattr(sys.modules[package], name, value)
    return value
