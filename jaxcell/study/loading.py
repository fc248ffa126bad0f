"""Studies and tasks of the user's own, found by a file or a module."""

import importlib
import importlib.util
import sys
from pathlib import Path
from types import ModuleType

from .study import Study


def load_module(name: str) -> ModuleType:
    """Import a module by its name, or from its file `FILE.py`.

    **Raises:** `ImportError` if there is none; whatever it raises when it runs.
    """
    if not name.endswith(".py"):
        return importlib.import_module(name)
    path = Path(name).resolve()
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None or not path.is_file():
        raise ImportError(f"there is no file {name}")
    module = importlib.util.module_from_spec(spec)
    # Before it runs, so that the dataclasses in it find their module.
    sys.modules[path.stem] = module
    spec.loader.exec_module(module)
    return module


def load_study(reference: str) -> type[Study]:
    """The class of a study of one's own.

    **Arguments:**

    - `reference`: `FILE.py:CLASS` or `MODULE:CLASS`.

    **Raises:** `ValueError` that says what is wrong with the reference.
    """
    module, colon, name = reference.rpartition(":")
    try:
        if not colon:
            raise ValueError("expected FILE.py:CLASS or MODULE:CLASS")
        found = getattr(load_module(module), name)
        if not (isinstance(found, type) and issubclass(found, Study)):
            raise ValueError(f"expected a class that derives from jaxcell.study.Study, got {found}")
    except (ImportError, AttributeError, ValueError, SyntaxError) as error:
        raise ValueError(f"{reference}: {error}") from None
    return found
