"""The global behaviour of simple robots, computed by cell-to-cell mapping.

Packages, from the ground floor up: `space` (maps and cells), `automata` (filters), `mapping`
(cell maps and their groups), `markov` (chains), `optimize` (weights), `bounce` (bouncing robots),
`patrol` (patrolling), `drift` (ocean drifters), `record` (results), `robot` (on an iRobot Create),
`sweep` (many runs). They are imported on first use, so that `import jaxcell` alone does not import
JAX.
"""

import importlib
from types import ModuleType


__version__ = "0.1.0"

_PACKAGES = (
    "automata",
    "bounce",
    "drift",
    "mapping",
    "markov",
    "optimize",
    "patrol",
    "record",
    "robot",
    "space",
    "sweep",
)

__all__ = ["__version__", *_PACKAGES]


def __getattr__(name: str) -> ModuleType:
    if name in _PACKAGES:
        return importlib.import_module(f"{__name__}.{name}")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
