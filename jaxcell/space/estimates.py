"""Estimates of the peak memory of studies of cell spaces, in bytes.

The factors were measured on maps of up to 10^8 cells. The memory of Python and its libraries,
`jaxcell.base.memory.LIBRARIES`, is not included.
"""

import dataclasses
import functools
import math
from collections.abc import Callable, Iterator, Sequence
from typing import TypeAlias

from ..base import memory
from ..base.limits import MAX_CELLS, MAX_VERTICES
from ..base.shown import own_names
from .cells import CellSpace
from .extent import Extent
from .motion import Motion
from .occupancy import cutting_bytes
from .segments import STEPS_AT_ONCE


__dir__ = functools.partial(own_names, globals())
Need: TypeAlias = Callable[[Extent], float | int]

# Bytes per cell: an image with groups and steps; a roadmap; a choice of angles to localize with.
IMAGE, ROADMAP, CHOICE = 30, 40, 250

# Bytes per cell for coverage: a policy; a branch of a chain with its matrix; the groups and the
# limiting distribution of an angle; the solve in a persistent cell, and its part for each branch.
POLICY, CHAIN, KEPT, SOLVE, SOLVED = 30, 16, 45, 620, 9

# Bytes of compiled programs: groups on a section, coverage, a team, and the patrol of a map.
SECTION, COVER, TEAM, PATROL = 80_000_000, 70_000_000, 150_000_000, 350_000_000

# Tables of successive walls grow with the square of the number of ways.
MAX_WALL_WAYS = 32

# Round sides of cells to suggest.
_ROUND = (1.0, 1.25, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0)


def cutting(extent: Extent) -> float | int:
    """Estimate the bytes needed to divide a map into cells: those of the grid and the positions."""
    return cutting_bytes(extent.squares, extent.positions)


def moves(extent: Extent, motion: Motion) -> float | int:
    """Estimate the bytes of the moves: the ends of the steps from every position."""
    ways = extent.ways(motion)
    any_shape = (50 + extent.directions) * extent.near_walls(motion)
    listed = 16 * extent.directions
    return 4.5 * ways * extent.positions + 12 * extent.squares + any_shape + listed


def section(extent: Extent, motion: Motion) -> float | int:
    """Estimate the bytes needed to find the periodic groups from the cells where robots bump."""
    walls = extent.ways(motion) * extent.bumps(motion) / extent.directions
    return _walls(extent, motion, 40 * walls + SECTION + 25 * extent.bumps(motion))


def groups(extent: Extent, motion: Motion) -> float | int:
    """Estimate the bytes needed to find the periodic group of each cell, and the runs to walls."""
    return section(extent, motion) + 8 * extent.ways(motion) * extent.positions


def counts(extent: Extent, motion: Motion) -> float | int:
    """Estimate the bytes needed to count the periodic groups without listing their cells."""
    ways = extent.ways(motion)
    if ways > MAX_WALL_WAYS:
        return section(extent, motion)
    return _walls(extent, motion, 18 * ways**2 * extent.bumps(motion) / extent.directions)


def _walls(extent: Extent, motion: Motion, tables: float | int) -> float | int:
    """Estimate the bytes of the grid, plus `tables` or, if more, the bytes to test steps."""
    tested = min(extent.near_walls(motion) * extent.directions, STEPS_AT_ONCE)
    return (5 if extent.gridded else 10) * extent.squares + max(tables, 40 * tested)


def images(extent: Extent, angles: int, motion: Motion) -> float | int:
    """Estimate the bytes of the periodic groups and the images of all cells, for several angles."""
    return groups(extent, motion) + IMAGE * angles * extent.size


def by_direction(extent: Extent, motion: Motion) -> float | int:
    """Estimate the bytes needed to find the periodic groups and list them by direction."""
    return section(extent, motion) + 50 * extent.positions


def localization(extent: Extent, motion: Motion) -> float | int:
    """Estimate the bytes of the images of all cells and a localization filter.

    The size of a filter is unknown before its construction, which checks the free memory again. In
    measurements, filters of maps with longer sides had more states per cell.
    """
    filter = 250 + 1.2 * (extent.rows + extent.columns)
    return moves(extent, motion) + (IMAGE + filter) * extent.size


def plans(extent: Extent, motion: Motion) -> float | int:
    """Estimate the bytes of a roadmap and the plan to one goal."""
    runs = 8 * extent.ways(motion) * extent.positions
    return _walls(extent, motion, runs) + ROADMAP * extent.size


def choice(extent: Extent, motion: Motion) -> float | int:
    """Estimate the bytes of a roadmap and a policy that localizes a robot."""
    return plans(extent, motion) + CHOICE * extent.size


def coverage(extent: Extent, motion: Motion, *, angles: int, branches: int) -> float | int:
    """Estimate the bytes of the coverage by several noisy bouncing angles, computed one by one.

    Persistent cells take the most memory. In measurements, all cells were persistent if bumps led
    to three of eight directions, and a proportionally smaller share if they led to fewer.
    """
    persistent = min(1, 8 / 3 * branches / extent.directions) if branches > 1 else 0
    solve = persistent * (SOLVE + SOLVED * branches)
    bytes_of_cell = POLICY + CHAIN * branches + KEPT * angles + solve
    return COVER + moves(extent, motion) + extent.size * bytes_of_cell


def team(extent: Extent, motion: Motion) -> float | int:
    """Estimate the bytes of the moves and the trajectories of a team."""
    return TEAM + moves(extent, motion) + 80 * extent.size


def drift(cells: Sequence[int]) -> float | int:
    """Estimate the bytes of drift maps of several layers, from their numbers of cells.

    This includes the solution of linear equations for one layer at a time.
    """
    return 200 * sum(cells) + 1500 * max(cells)


def draws(cells: int, samples: int) -> float | int:
    """Estimate the bytes of a bootstrap of observed drifters, with a number per cell and sample."""
    return 80 * cells * samples


def walk(vertices: int, edges: int, weighted: bool) -> float | int:
    """Estimate the bytes of a walk on a graph; a weighted walk has a matrix over pairs of edges."""
    return 200 * vertices**2 + (20 * edges**2 if weighted else 0)


def patrol(extent: Extent) -> float | int:
    """Estimate the bytes of a patrol of a map, with matrices over pairs of cells or edges."""
    cells = min(extent.positions, MAX_CELLS)
    return PATROL + cutting(extent) + 60 * cells**2 + 140 * min(cells, MAX_VERTICES) ** 2


def check(
    extent: Extent, need: Need, doing: str, step: float | None, also: str = ""
) -> float | int:
    """Estimate the bytes of a study, and refuse the study if less memory is free.

    `need` estimates the bytes. In the error, `doing` describes the study, and `also` is a text
    before the suggested remedy. If the remedy is larger cells, their side is at most `step`, the
    length of a step in metres (`None` for no limit).
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
    """Refuse a computation on cells that takes more memory than is free, as [`check`][] does."""
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
        for digits in _ROUND:
            larger = float(f"{digits}e{exponent}")
            if cell < larger <= most:
                yield larger
        exponent += 1
