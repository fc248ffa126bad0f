"""The global behaviour of simple robots, computed with cell-to-cell mapping.

The state space of a robot, or of a drifter in the sea, is divided into *cells*. Every cell is
mapped to its *image*, the cell at the end of one step from its centre. If each cell has one image,
the map is *simple*, a graph in which each cell has one successor. If images have probabilities, the
map is *generalized*, a finite Markov chain. Properties of the system are then computed from this
map: its periodic or persistent groups, the time and the probability of reaching them, the
observations that localize a robot, and the best plan, policy or mixture. This is the method of T.
Alam's dissertation (2018). Docstrings name its sections, equations and algorithms.

Packages, from the lowest layer to the highest:

- `space`: maps, cells, visibility. `automata`: filters. `walls`: sets of places of robots that
    start anywhere. `currents`: files of ocean models. None of them imports JAX.
- `mapping`: maps of cells and their groups.
- `markov`: analyses of chains. `optimize`: weights, mixtures, covers and games.
- `bounce`: bouncing robots (chapters 2 and 3). `patrol`: patrolling (chapter 4). `drift`: drifters
    in ocean currents (chapter 5). `dynamics`: any map or vector field, on a box of cells.
- `study`: questions that programs, commands and sweeps answer. `record`: datasets and recordings.
    `robot`: real and emulated robots, without JAX. `sweep`: one study for many parameter values.

The command `jaxcell` does all of this without programming. `jaxcell.bundled` finds the bundled
maps, graphs and currents.

Cells, groups and vertices are numbered from 0. Lengths are in metres, angles in radians,
counter-clockwise from the x axis (East), times in steps or seconds. Results are frozen dataclasses
of arrays. Results of iterative solvers have a *certificate*, a record of the remaining error.
Public functions compute with 64-bit numbers, and do not change the setting of JAX. If JAX is set to
32 bits, as by default, 64-bit arrays of results are NumPy arrays, because JAX would round them.
Under `jit`, `vmap` and `grad`, functions that need 64 bits raise an error if JAX is set to 32.

Packages are imported at their first use: `import jaxcell` alone does not import JAX.

    >>> import math
    >>> from jaxcell import bounce, examples, mapping
    >>> cells = examples.lab()
    >>> bounces = bounce.bounce_map(cells, math.pi / 4)
    >>> groups = mapping.periodic_groups(bounces.image)
    >>> cells.size, int(groups.count), groups.group_period[:1].tolist()
    (152, 1, [20])
"""

import importlib
from types import ModuleType

from .base.bundled import bundled as bundled


__version__ = "0.2.0.dev0"

_MODULES = (
    "automata",
    "bounce",
    "currents",
    "drift",
    "dynamics",
    "examples",
    "mapping",
    "markov",
    "optimize",
    "patrol",
    "record",
    "robot",
    "space",
    "study",
    "sweep",
    "verify",
    "walls",
)

__all__ = ["__version__", "bundled", *_MODULES]


def __getattr__(name: str) -> ModuleType:
    if name in _MODULES:
        return importlib.import_module(f"{__name__}.{name}")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
