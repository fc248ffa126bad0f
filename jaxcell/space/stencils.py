import dataclasses
import functools
import math

import numpy as np
from jaxtyping import Int

from .cells import TOLERANCE


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
def stencil(directions: int, step: float, collision: str, grid: tuple[int, int]) -> Stencil:
    """The stencil of a step on a grid.

    Directions in which a step leads off the grid from every square are one way, so that a stencil
    is no larger than the grid, however long the step.

    **Arguments:**

    - `directions`: number of directions in a full turn.
    - `step`: length of a step, in sides of a square.
    - `collision`: `"endpoint"` asks only that the end point be free, `"swept"` the same of all the
        way.
    - `grid`: number of rows and of columns.

    **Returns:** [`Stencil`][].

    Steps of one square in 360 directions do 16 different things; North leads one row up:

        >>> from jaxcell.space import stencil
        >>> one = stencil(360, 1.0, "swept", (20, 30))
        >>> len(one.offset), one.offset[one.way[90]].tolist()
        (16, [1, 0])
    """
    ways: dict[tuple, int] = {}
    found = (_way(k, directions, step, collision, grid) for k in range(directions))
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


def displacement(direction: int, directions: int, step: float) -> tuple[float, float]:
    """End point of a step from the origin, rounded so that ties are ties on every platform."""
    angle = 2 * math.pi * direction / directions
    return round(step * math.cos(angle), 9), round(step * math.sin(angle), 9)


def _way(
    direction: int, directions: int, step: float, collision: str, grid: tuple[int, int]
) -> tuple:
    dx, dy = displacement(direction, directions, step)
    offset = (math.floor(round(0.5 + dy, 9)), math.floor(round(0.5 + dx, 9)))
    rows, columns = grid
    if abs(offset[0]) >= rows or abs(offset[1]) >= columns:
        off = (rows, 0) if rows <= columns else (0, columns)
        return off, (off,), ()
    if collision == "endpoint":
        return offset, (offset,), ()
    crossed, beside = {offset: None}, []
    east, north = int(math.copysign(1, dx)), int(math.copysign(1, dy))
    # The step meets the lines between columns at x = 1/2, 3/2, ... from its start, and rows
    # likewise.
    to_column = [(m + 0.5) / abs(dx) for m in range(int(abs(dx) + 0.5))] if dx else []
    to_row = [(m + 0.5) / abs(dy) for m in range(int(abs(dy) + 0.5))] if dy else []
    row = column = 0
    while to_column or to_row:
        next_column, next_row = (to_column or [math.inf])[0], (to_row or [math.inf])[0]
        if abs(next_column - next_row) < TOLERANCE:
            corner = (row, column + east), (row + north, column)
            row, column = row + north, column + east
            to_column, to_row = to_column[1:], to_row[1:]
            # A corner at the end is not passed, unless the end square lies beyond it.
            if next_row < 1 - TOLERANCE or (row, column) == offset:
                beside.append(corner)
        elif next_column < next_row:
            column, to_column = column + east, to_column[1:]
        else:
            row, to_row = row + north, to_row[1:]
        if min(next_column, next_row) < 1 - TOLERANCE:
            crossed[row, column] = None
    return offset, tuple(crossed), tuple(beside)
