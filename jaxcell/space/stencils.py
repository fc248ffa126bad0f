import dataclasses
import functools
import math
from typing import TypeAlias

import numpy as np
from jaxtyping import Int

from ..base.shown import Shown
from .motion import Motion
from .segments import displacement


_Square: TypeAlias = tuple[int, int]


@dataclasses.dataclass(frozen=True, eq=False)
class Stencil(Shown):
    """The squares that have to be free for a step from the centre of a square, in each direction.

    Relative to the start, these squares are the same for every start. Directions with the same
    squares form a class, called a *way*: with steps of one square, 360 directions have 16 ways. So
    everything that depends on walls is computed once per way. Squares are `(row, column)` relative
    to the start.
    """

    way: Int[np.ndarray, "directions"]
    "The way (class of directions with the same squares) of each direction."
    offset: Int[np.ndarray, "ways 2"]
    "The square in which a step of each way (class of directions) ends."
    crossed: tuple[tuple[_Square, ...], ...]
    """For each way (class of directions), the squares whose interior the step crosses, and the last
    square."""
    beside: tuple[tuple[tuple[_Square, _Square], ...], ...]
    """For each way (class of directions) and each corner that the step touches, two squares; at
    least one of them has to be free."""


@functools.lru_cache(maxsize=64)
def stencil(directions: int, motion: Motion, grid: tuple[int, int]) -> Stencil:
    """Build the stencil of a step on a grid.

    The directions in which a step leads off the grid from every square form one way. So a stencil
    is no larger than the grid, even for a very long step.

    **Arguments:** the number of directions; a motion, for squares with sides of 1 m; and the number
    of rows and of columns. **Returns:** [`Stencil`][].

    Steps of one square in 360 directions have 16 ways; a step to the North leads one row up:

        >>> from jaxcell.space import Motion, stencil
        >>> one = stencil(360, Motion(), (20, 30))
        >>> len(one.offset), one.offset[one.way[90]].tolist()
        (16, [1, 0])
    """
    number: dict[tuple, int] = {}
    ways = (_way(k, directions, motion, grid) for k in range(directions))
    way = np.array([number.setdefault(squares, len(number)) for squares in ways], np.int32)
    offset, crossed, beside = zip(*number, strict=True)
    return Stencil(way, np.array(offset, np.int32), crossed, beside)


def _way(direction: int, directions: int, motion: Motion, grid: tuple[int, int]) -> tuple:
    dx, dy = displacement(direction, directions, motion.in_cells(1.0))
    offset = (math.floor(round(0.5 + dy, 9)), math.floor(round(0.5 + dx, 9)))
    rows, columns = grid
    if abs(offset[0]) >= rows or abs(offset[1]) >= columns:
        off = (rows, 0) if rows <= columns else (0, columns)
        return off, (off,), ()
    return offset, *motion.rule.squares(dx, dy, offset)


def line_places(
    square: Int[np.ndarray, "*shape"], grid: tuple[int, int], step: tuple[int, int]
) -> Int[np.ndarray, "*shape"]:
    """Number the squares of a grid along the lines that a robot follows by repeating one step.

    The number grows by one from each square to the next square on its line, and the numbers on
    different lines do not overlap. The squares may be in several grids of one shape, counted one
    after the other. A step moves the robot by `step`, a number of rows and of columns.
    """
    rows, columns = grid
    # The number of steps from where the line begins.
    before = np.full(square.shape, rows + columns)
    row, column = np.divmod(square % (rows * columns), columns)
    for move, place, size in zip(step, (row, column), grid, strict=True):
        if move:
            np.minimum(before, (place if move > 0 else size - 1 - place) // abs(move), out=before)
    first = square - before * (step[0] * columns + step[1])
    return first.astype(np.int64) * (rows + columns) + before
