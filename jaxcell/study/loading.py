"""Load the user's studies and tasks from files or modules."""

import importlib
import importlib.util
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

from .study import Study


def load_module(name: str) -> ModuleType:
    """Import a module by its name, or from a file `FILE.py`."""
    if not name.endswith(".py"):
        return importlib.import_module(name)
    path = Path(name).resolve()
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None or not path.is_file():
        raise ImportError(f"there is no file {name}")
    module = importlib.util.module_from_spec(spec)
    # The module is registered before it runs, because its dataclasses look it up.
    sys.modules[path.stem] = module
    spec.loader.exec_module(module)
    return module


def load_object(reference: str) -> Any:
    """Load an object of a module from a reference: `FILE.py:NAME` or `MODULE:NAME`."""
    module, _, name = reference.rpartition(":")
    try:
        return getattr(load_module(module), name)
    except (ImportError, AttributeError, ValueError, SyntaxError) as error:
        lacks = getattr(error, "obj", None)
        names = vars(lacks) if isinstance(lacks, ModuleType) else ()
        there = ", ".join(one for one in names if not one.startswith("_"))
        there = f"; it has {there}" if there else ""
        raise ValueError(f"{reference}: {error}{there}") from None


def load_study(reference: str) -> type[Study]:
    """Load the class of a user's study from a reference: `FILE.py:CLASS` or `MODULE:CLASS`."""
    if ":" not in reference:
        raise ValueError(f"{reference}: expected FILE.py:CLASS or MODULE:CLASS")
    kind = load_object(reference)
    if not (isinstance(kind, type) and issubclass(kind, Study)):
        raise ValueError(
            f"{reference}: expected a class that derives from jaxcell.study.Study, got {kind}"
        )
    return kind
