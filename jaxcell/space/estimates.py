"""How much memory a study of a cell space takes at its peak, before it begins.

The numbers are bytes as measured on maps of up to some 10^8 cells, without what Python and its
libraries take themselves, `jaxcell.base.memory.LIBRARIES`.
"""

import dataclasses
import math
from collections.abc import Callable, Iterator, Sequence
from typing import TypeAlias

from ..base import memory
from ..base.limits import MAX_CELLS, MAX_VERTICES
from .cells import CellSpace
from .extent import Extent
from .motion import Motion
from .occupancy import cutting_bytes
from .segments import STEPS_AT_ONCE


Need: TypeAlias = Callable[[Extent], float | int]

# Bytes of a cell: an image with groups and steps; a roadmap with what makes it; a choice of angles
# to localize with.
IMAGE, ROADMAP, CHOICE = 30, 40, 250

# Bytes of a cell for coverage: a policy; a branch of a chain with its matrix; the groups and the
# limiting distribution of an angle; in a persistent cell the solve, and its part for each branch.
POLICY, CHAIN, KEPT, SOLVE, SOLVED = 30, 16, 45, 620, 9

# Bytes of compiling what finds groups on a section, what covers, what drives a team, and what
# patrols a map.
SECTION, COVER, TEAM, PATROL = 80_000_000, 70_000_000, 150_000_000, 350_000_000

# Tables of which wall follows which grow with the square of the number of ways.
MAX_WALL_WAYS = 32

# Sides of cells that people choose.
_ROUND = (1.0, 1.25, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0)


def cutting(extent: Extent) -> float | int:
    """Bytes of the squares and the positions."""
    return cutting_bytes(extent.squares, extent.positions)


def moves(extent: Extent, motion: Motion) -> float | int:
    """Bytes of where a step leads from every position."""
    ways = extent.ways(motion)
    any_shape = (50 + extent.directions) * extent.near_walls(motion)
    listed = 16 * extent.directions
    return 4.5 * ways * extent.positions + 12 * extent.squares + any_shape + listed


def section(extent: Extent, motion: Motion) -> float | int:
    """Bytes of the periodic groups known at the walls: the runs between these, and the section."""
    ways = extent.ways(motion)
    walls = ways * extent.bumps(motion) / extent.directions
    return _known(extent, motion, 40 * walls + SECTION + 25 * extent.bumps(motion))


def groups(extent: Extent, motion: Motion) -> float | int:
    """Bytes of the periodic groups, and of the runs from all positions."""
    ways = extent.ways(motion)
    return section(extent, motion) + 8 * ways * extent.positions


def counts(extent: Extent, motion: Motion) -> float | int:
    """Bytes of the numbers of periodic groups, which are found from the walls."""
    ways = extent.ways(motion)
    if ways > MAX_WALL_WAYS:
        return section(extent, motion)
    return _known(extent, motion, 18 * ways**2 * extent.bumps(motion) / extent.directions)


def _known(extent: Extent, motion: Motion, walls: float | int) -> float | int:
    """Bytes of what is known of walls, if so many, or of the tests of which steps these block."""
    tested = min(extent.near_walls(motion) * extent.directions, STEPS_AT_ONCE)
    return (5 if extent.gridded else 10) * extent.squares + max(walls, 40 * tested)


def images(extent: Extent, angles: int, motion: Motion) -> float | int:
    """Bytes of the groups, and of images and steps of all cells for some bouncing angles."""
    return groups(extent, motion) + IMAGE * angles * extent.size


def by_direction(extent: Extent, motion: Motion) -> float | int:
    """Bytes of the groups on the section, and of the cells of one direction at a time."""
    return section(extent, motion) + 50 * extent.positions


def localization(extent: Extent, motion: Motion) -> float | int:
    """Bytes of the images and a filter.

    How many states a filter has is not known before: that it takes the longer to localize the
    larger the map was measured. States are watched while they are made too.
    """
    filter = 250 + 1.2 * (extent.rows + extent.columns)
    return moves(extent, motion) + (IMAGE + filter) * extent.size


def plans(extent: Extent, motion: Motion) -> float | int:
    """Bytes of a roadmap and the plan to one goal."""
    ways = extent.ways(motion)
    return _known(extent, motion, 8 * ways * extent.positions) + ROADMAP * extent.size


def choice(extent: Extent, motion: Motion) -> float | int:
    """Bytes of a roadmap and the choice of angles by which a robot localizes itself."""
    return plans(extent, motion) + CHOICE * extent.size


def coverage(extent: Extent, motion: Motion, *, angles: int, branches: int) -> float | int:
    """Bytes of the noisy maps of some bouncing angles, one at a time, and what is kept of them.

    Cells are persistent, as measured, where turns spread over three of eight directions; where they
    spread less, as many fewer.
    """
    persistent = min(1, 8 / 3 * branches / extent.directions) if branches > 1 else 0
    solve = persistent * (SOLVE + SOLVED * branches)
    bytes_of_cell = POLICY + CHAIN * branches + KEPT * angles + solve
    return COVER + moves(extent, motion) + extent.size * bytes_of_cell


def team(extent: Extent, motion: Motion) -> float | int:
    """Bytes of the moves, and of the trajectories of a team."""
    return TEAM + moves(extent, motion) + 80 * extent.size


def drift(cells: Sequence[int]) -> float | int:
    """Bytes of the maps of a drifter in some layers, and of the solves for one at a time.

    **Arguments:**

    - `cells`: cells of water of each layer.
    """
    return 200 * sum(cells) + 1500 * max(cells)


def draws(cells: int, samples: int) -> float | int:
    """Bytes of what is asked of every cell for each of some draws of observed drifters.

    **Arguments:**

    - `cells`, `samples`: their numbers.
    """
    return 80 * cells * samples


def walk(vertices: int, edges: int, weighted: bool) -> float | int:
    """Bytes of a walk on a graph with what is measured between all pairs of vertices.

    **Arguments:**

    - `vertices`, `edges`: their numbers.
    - `weighted`: whether weights of edges are sought for short commutes, by a matrix of all pairs
        of edges.
    """
    return 200 * vertices**2 + (20 * edges**2 if weighted else 0)


def patrol(extent: Extent) -> float | int:
    """Bytes of the patrol of a map: matrices of cells by cells, and of edges by edges on few."""
    cells = min(extent.positions, MAX_CELLS)
    return PATROL + cutting(extent) + 60 * cells**2 + 140 * min(cells, MAX_VERTICES) ** 2


def check(
    extent: Extent, need: Need, doing: str, step: float | None, also: str = ""
) -> float | int:
    """Refuse a study that takes more memory than is free.

    **Arguments:**

    - `extent`: how large the cell space is.
    - `need`: the bytes that the study of a cell space takes.
    - `doing`: what takes them.
    - `step`: length of a step in metres, which no cell may be larger than, or `None`.
    - `also`: what else would fit.

    **Returns:** the bytes.

    **Raises:** `MemoryError`, in one line with the numbers, and with the smallest cell that would
    fit.
    """
    needed = need(extent)
    memory.check(needed, doing, lambda free: also + _instead(extent, need, free, step))
    return needed


def check_cells(
    cells: CellSpace,
    motion: Motion,
    need: Callable[[Extent, Motion], float | int],
    doing: str,
    also: str = "",
) -> None:
    """Refuse a computation on existing cells that takes more memory than is free.

    **Arguments:** as for [`check`][].
    """
    check(Extent.of(cells), lambda extent: need(extent, motion), doing, motion.step, also)


def _instead(extent: Extent, need: Need, available: int, step: float | None) -> str:
    workspace, directions = extent.workspace, extent.directions
    if workspace is not None:
        for cell in _larger(extent.cell, extent.cell * 1e5 if step is None else step):
            larger = Extent.about(workspace, cell, directions)
            if larger is not None and need(larger) <= available:
                return f"a cell of {cell:g} m would fit"
    for parts in range(2, 100):
        fewer = dataclasses.replace(extent, directions=directions // parts)
        if directions % parts == 0 and need(fewer) <= available:
            return f"{fewer.directions} directions would fit"
    return "use larger cells or fewer directions"


def _larger(cell: float, most: float) -> Iterator[float]:
    exponent = math.floor(math.log10(cell))
    while 10.0**exponent <= most:
        for one in _ROUND:
            larger = float(f"{one}e{exponent}")
            if cell < larger <= most:
                yield larger
        exponent += 1
