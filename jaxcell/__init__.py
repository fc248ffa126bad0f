"""The global behaviour of simple robots, computed by cell-to-cell mapping.

The state space of a robot, or of a drifter in the sea, is cut into *cells*, and every cell is
mapped to its *image*, the cell where one step from its centre leads. If that is known, it is a
*simple* map, a graph in which each cell has one successor; if not, it is a *generalized* one, a
finite Markov chain. What one asks of the system is then asked of that map: where it ends up (its
periodic or persistent groups), when, and with what probability; which observations reveal where it
is; and which plan, policy or mixture is best. This is the method of T. Alam's dissertation (2018),
whose sections, equations and algorithms the packages name.

Packages, from the ground floor up; each says in its own page of help what it computes and how:

- `space`: maps, cells, what is visible. `automata`: filters. `walls`: where a robot may be that
    starts anywhere. None of them imports JAX.
- `mapping`: cell maps and their groups.
- `markov`: what one asks of chains. `optimize`: weights, mixtures, covers and games.
- `bounce`: bouncing robots (chapters 2 and 3). `patrol`: patrolling (chapter 4). `drift`: drifters
    in ocean currents (chapter 5). `dynamics`: any map or field, on a box of cells.
- `study`: questions, for programs, commands and sweeps. `record`: datasets and recordings.
    `robot`: real and emulated robots, without JAX. `sweep`: one study for many parameters.

The command `jaxcell` does all of this without a program; `jaxcell.bundled` finds the maps, graphs
and the small sea that come with it.

Cells, groups and vertices are numbered from 0. Lengths are in metres, angles in radians,
counter-clockwise from the x axis (East), times in steps or seconds. Results are frozen dataclasses
of arrays; those of iterative solves have a *certificate*, the error that is left. Probabilities and
solves need 64-bit numbers, which the library does not turn on by itself: set `JAX_ENABLE_X64=1`, or
call `jax.config.update("jax_enable_x64", True)` first. What needs them says so otherwise; many of
the examples do.

Packages are imported on first use: `import jaxcell` alone does not import JAX.

    >>> import math
    >>> from jaxcell import bounce, examples, mapping
    >>> cells = examples.lab()
    >>> found = bounce.bounce_map(cells, math.pi / 4)
    >>> groups = mapping.periodic_groups(found.image)
    >>> cells.size, int(groups.count), groups.group_period[:1].tolist()
    (152, 1, [20])
"""

import importlib
from types import ModuleType

from .base.bundled import bundled as bundled


__version__ = "0.1.0"

_MODULES = (
    "automata",
    "bounce",
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
