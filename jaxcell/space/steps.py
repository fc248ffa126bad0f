"""Where one step leads on a map of any shape, one way at a time."""

import dataclasses
import functools
import math
from collections.abc import Callable

import numpy as np
import shapely
from jaxtyping import Bool, Int, Int32

from .cells import TOLERANCE, CellSpace
from .motion import CELL_BY_CELL, Motion
from .segments import displacement
from .stencils import Stencil, line_places, stencil


# Places of all squares of grids up to this size are kept.
_SMALL = 2**16
# Squares in a row of a block.
_BLOCK = 32


@dataclasses.dataclass(frozen=True, eq=False)
class Steps:
    """Where one step leads from each square of some grids of one shape.

    A *way* is what directions have in common in which steps do the same. Only one way at a time is
    held for all squares, as a bit each.
    """

    free: Bool[np.ndarray, "grids rows columns"]
    "Which squares are free."
    way: Int[np.ndarray, "directions"]
    "The way of each direction."
    offset: Int[np.ndarray, "ways 2"]
    "By how many rows and columns a step leads."
    lines: tuple[tuple[int, int], ...]
    "The offsets that differ: ways of one offset run along the same lines."
    line: Int[np.ndarray, "ways"]
    "Which of them is that of each way."
    possible: Callable[[int], Bool[np.ndarray, "grids rows columns"]]
    "From which squares a step is possible in a way, which leads to a free one."

    @classmethod
    def on_grids(
        cls,
        free: Bool[np.ndarray, "grids rows columns"],
        directions: int,
        motion: Motion,
    ) -> "Steps":
        """Steps on grids whose blocked squares are the obstacles.

        **Arguments:**

        - `free`: which squares are free; row 0 is the lowest.
        - `directions`: number of directions.
        - `motion`: how a robot moves; the side of a square is 1 m.
        """
        rows, columns = free.shape[1:]
        shape = stencil(directions, motion, (rows, columns))
        margin = int(np.abs(shape.square).max())
        framed = np.pad(free, ((0, 0), (margin, margin), (margin, margin)))

        needed = _needed(shape)

        def look(up: int, across: int) -> Bool[np.ndarray, "grids rows columns"]:
            return framed[:, margin + up :, margin + across :][:, :rows, :columns]

        def possible(way: int) -> Bool[np.ndarray, "grids rows columns"]:
            passes = free.copy()
            crossed, beside = needed[way]
            for square in crossed:
                passes &= look(*square)
            for left, right in beside:
                passes &= look(*left) | look(*right)
            return passes

        return cls(free, shape.way, shape.offset, shape.lines, shape.line, possible)

    @classmethod
    def of(cls, cells: CellSpace, motion: Motion) -> "Steps":
        """Steps in a cell space, as a batch of one grid.

        **Arguments:**

        - `cells`: the cell space.
        - `motion`: how the robot moves.

        **Raises:** `ValueError` for a step that is not finite, or shorter than a cell.
        """
        if cells.gridded:
            return cls.on_grids(cells.free[None], cells.directions, in_squares(motion, cells.cell))
        return cls.among_walls(cells, motion)

    @classmethod
    def among_walls(cls, cells: CellSpace, motion: Motion) -> "Steps":
        """The same by the walls themselves, which may have any shape."""
        length = motion.in_cells(cells.cell)
        ends = cls.on_grids(cells.free[None], cells.directions, Motion(length, "endpoint"))
        near, blocked = _blocked_steps(cells, motion)
        # Walls part directions that lead to the same square, but not where it is not free.
        able = np.stack([ends.possible(way).ravel()[near] for way in range(len(ends.offset))])
        blocked = blocked.T & able[ends.way]
        kinds: dict[tuple[int, bytes], int] = {}
        kind = zip(ends.way.tolist(), map(bytes, np.packbits(blocked, axis=1)), strict=True)
        way = np.array([kinds.setdefault(one, len(kinds)) for one in kind], np.int32)
        _, first = np.unique(way, return_index=True)
        of_end, blocked = ends.way[first], blocked[first]

        def possible(way: int) -> Bool[np.ndarray, "grids rows columns"]:
            passes = ends.possible(int(of_end[way]))
            passes.reshape(-1)[near[blocked[way]]] = False
            return passes

        return cls(ends.free, way, ends.offset[of_end], ends.lines, ends.line[of_end], possible)

    def starts(
        self, way: int, possible: Bool[np.ndarray, "grids rows columns"]
    ) -> Bool[np.ndarray, "grids rows columns"]:
        """The free squares to which no step leads in a way from those where it is possible."""
        begins = self.free.copy()
        there: tuple[slice, ...] = (slice(None),)
        here: tuple[slice, ...] = (slice(None),)
        for move, size in zip(self.offset[way].tolist(), self.free.shape[1:], strict=True):
            there += (slice(max(move, 0), size + min(move, 0)),)
            here += (slice(max(-move, 0), size - max(move, 0)),)
        begins[there] &= ~possible[here]
        return begins

    def targets(self, cells: CellSpace) -> Int32[np.ndarray, "ways positions"]:
        """The position where a step leads, the same one where none is possible."""
        here = np.arange(cells.positions, dtype=np.int32)
        found = np.tile(here, (len(self.offset), 1))
        for way, target in enumerate(found):
            able = self.possible(way).ravel()[cells.square]
            target[able] = cells.position_of_square.ravel()[cells.square[able] + self.hop(way)]
        return found

    def places(self, line: int, square: Int[np.ndarray, "*some"]) -> Int[np.ndarray, "*some"]:
        """The numbers of squares along the lines of an offset; see `line_places`."""
        grid, step = self.free.shape[1:], self.lines[line]
        if self.free[0].size > _SMALL:
            return line_places(square, grid, step)
        which, square = np.divmod(square, self.free[0].size)
        return _listed(grid, step)[square] + which * (self.free[0].size * sum(grid))

    def hop(self, way: int) -> int:
        """By how much the number of a square grows with a step."""
        up, across = self.offset[way].tolist()
        return int(up * self.free.shape[2] + across)


@functools.lru_cache(maxsize=64)
def _listed(grid: tuple[int, int], step: tuple[int, int]) -> Int[np.ndarray, "squares"]:
    return line_places(np.arange(grid[0] * grid[1]), grid, step)


@functools.lru_cache(maxsize=64)
def _needed(shape: Stencil) -> list[tuple[list, list]]:
    """The squares that must be free for a step of each way, and the pairs of which one must be."""
    square = list(map(tuple, shape.square.tolist()))
    # What fills up the lists of a stencil are repeats.
    crossed = [[square[i] for i in dict.fromkeys(one)] for one in shape.crossed.tolist()]
    beside = [dict.fromkeys(map(tuple, one)) for one in shape.beside.tolist()]
    pairs = [[(square[left], square[right]) for left, right in one] for one in beside]
    return list(zip(crossed, pairs, strict=True))


def in_squares(motion: Motion, cell: float) -> Motion:
    """Give the motion on a grid of unit squares that stand for cells."""
    return dataclasses.replace(motion, step=motion.in_cells(cell))


def _blocked_steps(
    cells: CellSpace, motion: Motion
) -> tuple[Int[np.ndarray, "near"], Bool[np.ndarray, "near directions"]]:
    """Find the steps that walls of any shape block, to a tolerance of 1e-9 of a cell.

    **Returns:** the free squares within a step of a wall, and the directions in which a wall blocks
    the step from the centre of each. From other squares only the end has to be free.
    """
    rows, columns = cells.free.shape
    # All longer ones lead off the map too.
    length = min(motion.in_cells(cells.cell), math.hypot(rows, columns) + 1)
    steps = np.array([displacement(k, cells.directions, length) for k in range(cells.directions)])
    reach = float(np.linalg.norm(steps[0])) + TOLERANCE
    tree = shapely.STRtree(shapely.linestrings(cells.walls))
    # Blocks of squares are tested, which are far fewer, and then the squares of those near walls.
    blocks = np.zeros((-(-rows // _BLOCK), -(-columns // _BLOCK)), bool)
    bottom, left = np.indices(blocks.shape).reshape(2, -1) * _BLOCK
    boxes = shapely.box(left, bottom, left + _BLOCK, bottom + _BLOCK)
    blocks.flat[tree.query(boxes, predicate="dwithin", distance=reach)[0]] = True
    around = blocks.repeat(_BLOCK, 0).repeat(_BLOCK, 1)[:rows, :columns]
    square = np.argwhere(cells.free & around)
    centres = square[:, ::-1] + 0.5
    near, wall = tree.query(shapely.points(centres), predicate="dwithin", distance=reach)
    near, blocked = motion.rule.blocked(cells, centres, steps, near, wall)
    return square[near] @ (columns, 1), blocked


def free_steps(
    cells: CellSpace, motion: Motion = CELL_BY_CELL
) -> Int[np.ndarray, "directions positions"]:
    """The position where a step from each centre in each direction leads, among walls of any shape.

    A step that is not possible leads to the same position.

    **Arguments:**

    - `cells`: the cell space.
    - `motion`: how the robot moves.

    **Returns:** the positions, by direction and position.

    **Raises:** `ValueError` for a space made from a grid, which has no walls of other shapes.

    In a corridor of three squares, with the directions East and West:

        >>> from jaxcell import examples, space
        >>> cells = examples.corridor()
        >>> space.free_steps(cells).tolist()
        [[1, 2, 2], [0, 0, 1]]
    """
    steps = Steps.among_walls(cells, motion)
    return steps.targets(cells)[steps.way]
