import dataclasses
import functools
import math

import numpy as np
from jaxtyping import Int

from .motion import Motion
from .segments import displacement


@dataclasses.dataclass(frozen=True, eq=False)
class Stencil:
    """What one step from the centre of a square does, for every direction of a grid.

    From a centre a step in one direction leads to the same relative square wherever it starts, over
    the same squares on the way. Many directions do the same thing (360 directions and a step of one
    square make 16 different *ways*), so whatever depends on walls is computed once for a way, not
    for each direction. Squares are relative, `(row, column)`.
    """

    offset: Int[np.ndarray, "ways 2"]
    "Square that holds the end point."
    square: Int[np.ndarray, "squares 2"]
    "Squares that a step may depend on."
    crossed: Int[np.ndarray, "ways crossings"]
    "Those whose interior the step passes, all of which must be free; repeated to fill up."
    beside: Int[np.ndarray, "ways corners 2"]
    "Those beside each corner that it passes, of which one must be free; repeated likewise."
    way: Int[np.ndarray, "directions"]
    "The way of each direction."
    lines: tuple[tuple[int, int], ...]
    "The offsets that differ: ways of one offset run along the same lines."
    line: Int[np.ndarray, "ways"]
    "Which of them is that of each way."

    @property
    def looks(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """What to look at from a square, and where that leads."""
        return self.square, self.crossed, self.beside, self.offset


@functools.lru_cache(maxsize=64)
def stencil(directions: int, motion: Motion, grid: tuple[int, int]) -> Stencil:
    """The stencil of a step on a grid.

    Directions in which a step leads off the grid from every square are one way, so that a stencil
    is no larger than the grid, however long the step.

    **Arguments:**

    - `directions`: number of directions in a full turn.
    - `motion`: how a robot moves; the side of a square is 1 m.
    - `grid`: number of rows and of columns.

    **Returns:** [`Stencil`][].

    Steps of one square in 360 directions do 16 different things; North leads one row up:

        >>> from jaxcell.space import Motion, stencil
        >>> one = stencil(360, Motion(), (20, 30))
        >>> len(one.offset), one.offset[one.way[90]].tolist()
        (16, [1, 0])
    """
    ways: dict[tuple, int] = {}
    found = (_way(k, directions, motion, grid) for k in range(directions))
    way = [ways.setdefault(one, len(ways)) for one in found]
    # What fills up is the end square, which has to be free anyway.
    crossings = max(len(crossed) for _, crossed, _ in ways)
    corners = max(1, *(len(beside) for _, _, beside in ways))
    crossed = np.array([c + (o,) * (crossings - len(c)) for o, c, _ in ways])
    beside = np.array([b + ((o, o),) * (corners - len(b)) for o, _, b in ways])
    seen = np.concatenate([crossed.reshape(-1, 2), beside.reshape(-1, 2)])
    square, index = np.unique(seen, axis=0, return_inverse=True)
    index = index.reshape(-1).astype(np.int32)
    lines = sorted({o for o, _, _ in ways})
    return Stencil(
        offset=np.array([o for o, _, _ in ways], np.int32),
        square=square.astype(np.int32),
        crossed=index[: crossed.size // 2].reshape(crossed.shape[:-1]),
        beside=index[crossed.size // 2 :].reshape(beside.shape[:-1]),
        way=np.array(way, np.int32),
        lines=tuple(lines),
        line=np.array([lines.index(o) for o, _, _ in ways], np.int32),
    )


def line_places(
    square: Int[np.ndarray, "*some"], grid: tuple[int, int], step: tuple[int, int]
) -> Int[np.ndarray, "*some"]:
    """Numbers that ascend by one from square to square along the lines that steps of an offset
    follow; those of different lines do not mix.

    **Arguments:**

    - `square`: squares of a grid, or of many grids of one shape, one after the other.
    - `grid`: its number of rows and of columns.
    - `step`: the offset, `(row, column)`.

    In two rows of three squares, along the columns:

        >>> import numpy as np
        >>> from jaxcell.space.stencils import line_places
        >>> line_places(np.array([0, 3, 1, 4]), (2, 3), (1, 0)).tolist()
        [0, 1, 5, 6]
    """
    rows, columns = grid
    before = steps_before(square % (rows * columns), grid, step)
    first = square - before * (step[0] * columns + step[1])
    return first.astype(np.int64) * (rows + columns) + before


def steps_before(
    square: Int[np.ndarray, "*some"], grid: tuple[int, int], step: tuple[int, int]
) -> Int[np.ndarray, "*some"]:
    """How many steps of an offset lead to each square from where its line begins."""
    before = np.full(square.shape, sum(grid))
    for move, place, size in zip(step, np.divmod(square, grid[1]), grid, strict=True):
        if move:
            np.minimum(before, (place if move > 0 else size - 1 - place) // abs(move), out=before)
    return before


def _way(direction: int, directions: int, motion: Motion, grid: tuple[int, int]) -> tuple:
    dx, dy = displacement(direction, directions, motion.in_cells(1.0))
    offset = (math.floor(round(0.5 + dy, 9)), math.floor(round(0.5 + dx, 9)))
    rows, columns = grid
    if abs(offset[0]) >= rows or abs(offset[1]) >= columns:
        off = (rows, 0) if rows <= columns else (0, columns)
        return off, (off,), ()
    return offset, *motion.rule.squares(dx, dy, offset)
