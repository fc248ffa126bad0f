"""Modules that not every installation has: those of the extras, and what robots do without."""

import importlib
import importlib.util
from types import ModuleType


# What needs a module, and what to install.
_NEEDS = {
    "cv2": ("finding crosses needs OpenCV", "'jaxcell[vision]'"),
    "rerun": ("recordings need Rerun", "'jaxcell[view]'"),
    "scipy": ("beliefs need SciPy", "scipy"),
}


def has_module(name: str) -> bool:
    """Whether a module is installed, without importing it."""
    try:
        return importlib.util.find_spec(name) is not None
    except ModuleNotFoundError:
        return False


def missing_module(name: str, reason: object = None) -> ModuleNotFoundError:
    """Make the error that says what needs a module and how to install it."""
    need, package = _NEEDS[name]
    why = "" if reason is None else f" ({reason})"
    return ModuleNotFoundError(f"{need}; install it with: pip install {package}{why}", name=name)


def import_module(name: str) -> ModuleType:
    """Import a module that may be missing.

    **Raises:** `ModuleNotFoundError` that says what needs it and how to install it.
    """
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise missing_module(name.partition(".")[0], error) from None
