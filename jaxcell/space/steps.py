import dataclasses
import math
from collections.abc import Callable

import numpy as np
import shapely
from jaxtyping import Bool, Int, Int32

from .cells import TOLERANCE, CellSpace
from .motion import CELL_BY_CELL, Motion
from .segments import displacement
from .stencils import line_places, stencil


# Squares along the side of a block that is tested as a whole.
_BLOCK = 32


@dataclasses.dataclass(frozen=True, eq=False)
class Steps:
    """The end of one step from each square of several grids of one shape.

    Directions form a class, called a *way*, if from each square their steps have the same end. The
    squares from which a step is possible are computed for one way at a time, to save memory.
    """

    free: Bool[np.ndarray, "grids rows columns"]
    way: Int[np.ndarray, "directions"]
    "The way (class of directions with equal steps) of each direction."
    offset: Int[np.ndarray, "ways 2"]
    "The numbers of rows and columns by which a step of each way (class of directions) moves."
    possible: Callable[[int], Bool[np.ndarray, "grids rows columns"]]
    """A function that takes a way (class of directions), and returns a mask of the squares from
    which a step of this way is possible."""

    @classmethod
    def on_grids(
        cls, free: Bool[np.ndarray, "grids rows columns"], directions: int, motion: Motion
    ) -> "Steps":
        """Build the steps on grids of squares of 1 m; squares that are not free are obstacles."""
        rows, columns = free.shape[1:]
        shape = stencil(directions, motion, (rows, columns))
        margin = max(max(map(abs, square)) for way in shape.crossed for square in way)
        framed = np.pad(free, ((0, 0), (margin, margin), (margin, margin)))

        def look(square: tuple[int, int]) -> Bool[np.ndarray, "grids rows columns"]:
            up, across = square
            return framed[:, margin + up :, margin + across :][:, :rows, :columns]

        def possible(way: int) -> Bool[np.ndarray, "grids rows columns"]:
            passes = free.copy()
            for square in shape.crossed[way]:
                passes &= look(square)
            for left, right in shape.beside[way]:
                passes &= look(left) | look(right)
            return passes

        return cls(free, shape.way, shape.offset, possible)

    @classmethod
    def of(cls, cells: CellSpace, motion: Motion) -> "Steps":
        """Build the steps in a cell space, as a batch of one grid."""
        if cells.gridded:
            in_squares = Motion(motion.in_cells(cells.cell), motion.collision)
            return cls.on_grids(cells.free[None], cells.directions, in_squares)
        return cls.among_walls(cells, motion)

    @classmethod
    def among_walls(cls, cells: CellSpace, motion: Motion) -> "Steps":
        """Build the steps in a cell space from its walls, which may have any shape."""
        ends_only = Motion(motion.in_cells(cells.cell), "endpoint")
        ends = cls.on_grids(cells.free[None], cells.directions, ends_only)
        near, blocked = _blocked_steps(cells, motion)
        # Walls separate directions that lead to the same square, if this square is free.
        able = np.stack([ends.possible(way).ravel()[near] for way in range(len(ends.offset))])
        blocked = blocked.T & able[ends.way]
        number: dict[tuple[int, bytes], int] = {}
        kinds = zip(ends.way.tolist(), map(bytes, np.packbits(blocked, axis=1)), strict=True)
        way = np.array([number.setdefault(kind, len(number)) for kind in kinds], np.int32)
        _, first = np.unique(way, return_index=True)
        of_end, blocked = ends.way[first], blocked[first]

        def possible(way: int) -> Bool[np.ndarray, "grids rows columns"]:
            passes = ends.possible(int(of_end[way]))
            passes.reshape(-1)[near[blocked[way]]] = False
            return passes

        return cls(ends.free, way, ends.offset[of_end], possible)

    def starts(
        self, way: int, possible: Bool[np.ndarray, "grids rows columns"]
    ) -> Bool[np.ndarray, "grids rows columns"]:
        """Find the free squares in which no step of the class `way` ends.

        `possible` is a mask of the squares from which a step of the way is possible.
        """
        begins = self.free.copy()
        end: tuple[slice, ...] = (slice(None),)
        start: tuple[slice, ...] = (slice(None),)
        for move, size in zip(self.offset[way].tolist(), self.free.shape[1:], strict=True):
            end += (slice(max(move, 0), size + min(move, 0)),)
            start += (slice(max(-move, 0), size - max(move, 0)),)
        begins[end] &= ~possible[start]
        return begins

    def targets(self, cells: CellSpace) -> Int32[np.ndarray, "ways positions"]:
        """List the position at the end of each step; an impossible step ends where it starts."""
        targets = np.tile(np.arange(cells.positions, dtype=np.int32), (len(self.offset), 1))
        for way, target in enumerate(targets):
            able = self.possible(way).ravel()[cells.square]
            target[able] = cells.position_of_square.ravel()[cells.square[able] + self.hop(way)]
        return targets

    def places(self, way: int, square: Int[np.ndarray, "*shape"]) -> Int[np.ndarray, "*shape"]:
        """Number squares along the lines of repeated steps of `way`; see [`line_places`][]."""
        up, across = self.offset[way].tolist()
        return line_places(square, self.free.shape[1:], (up, across))

    def hop(self, way: int) -> int:
        """Return the number of the square where a step ends minus that of its start."""
        up, across = self.offset[way].tolist()
        return int(up * self.free.shape[2] + across)


def _blocked_steps(
    cells: CellSpace, motion: Motion
) -> tuple[Int[np.ndarray, "near"], Bool[np.ndarray, "near directions"]]:
    """Find the steps that walls of any shape block, with a tolerance of 1e-9 of a cell.

    Returns the free squares within a step of a wall, and a mask of the directions in which a wall
    blocks the step from the centre of the square. From other squares only the end has to be free.
    """
    rows, columns = cells.free.shape
    # All longer steps lead off the map, too.
    length = min(motion.in_cells(cells.cell), math.hypot(rows, columns) + 1)
    steps = np.array([displacement(k, cells.directions, length) for k in range(cells.directions)])
    parts = motion.rule.part(np.stack([0 * steps, steps], axis=1))
    # The part of a step may lie beside the step.
    reach = max(length, float(np.linalg.norm(shapely.get_coordinates(parts), axis=1).max()))
    reach += TOLERANCE
    tree = shapely.STRtree(shapely.linestrings(cells.walls))
    # Blocks of squares are tested first: they are far fewer than squares.
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
    """Find the position at the end of a step from each centre, among walls of any shape.

    It runs on the host, because shapely finds the walls ahead.

    **Arguments:** a cell space and a motion. **Returns:** positions by direction; a step that is
    not possible ends where it starts.

    In a corridor of three squares, with the directions East and West:

        >>> from jaxcell import examples, space
        >>> cells = examples.corridor()
        >>> space.free_steps(cells).tolist()
        [[1, 2, 2], [0, 0, 1]]
    """
    steps = Steps.among_walls(cells, motion)
    return steps.targets(cells)[steps.way]
