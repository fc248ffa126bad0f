"""The straight runs of a robot between its bumps, whatever the bouncing angle."""

import dataclasses
from collections.abc import Iterator

import numpy as np
from jaxtyping import Bool, Int, Int32

from ..space import CellSpace
from ..space.steps import Steps


# Squares that are followed to their walls at once.
_AT_ONCE = 2**20


@dataclasses.dataclass(frozen=True, eq=False)
class Runs:
    """Where the straight runs end on some grids of one shape.

    A *way* is what directions have in common in which steps do the same, and a wall of a way is a
    free square where the robot bumps in it. Walls are listed way by way, those of each by their
    squares; the squares of one grid come after those of another.
    """

    steps: Steps
    begin: Int[np.ndarray, "_"]
    "The first wall of each way, and behind the last one how many there are."
    square: Int[np.ndarray, "walls"]
    behind: Int[np.ndarray, "walls"]
    "Number of squares from which the robot runs into each wall, without its own."
    bump: Int[np.ndarray, "bumps"]
    "The squares that are walls of any way."
    place: Int[np.ndarray, "walls"]
    "The place of each wall among these."
    ahead: Int32[np.ndarray, "ways bumps"]
    "The wall ahead of each of these in each way, counted from the first one of the way."
    length: Int32[np.ndarray, "ways bumps"]
    "Steps until the robot is there."

    @classmethod
    def of(cls, steps: Steps) -> "Runs":
        """The runs where one step leads as given, found on the edges of what is free."""
        found = [_Walls.of(steps, way) for way in range(len(steps.offset))]
        square = np.concatenate([one.square for one in found])
        behind = np.concatenate([one.behind for one in found])
        begin = np.cumsum([0, *(one.square.size for one in found)])
        # A square is a wall of many ways, and the wall ahead does not depend on of which.
        bump, place = np.unique(square, return_inverse=True)
        of_line = [steps.places(line, bump) for line in range(len(steps.lines))]
        ahead, length = np.empty((2, len(found), bump.size), np.int32)
        for way, one in enumerate(found):
            here = of_line[steps.line[way]]
            # From a free square the next wall along the line is on the same run.
            following = np.searchsorted(one.along, here)
            ahead[way], length[way] = one.order[following], one.along[following] - here
        return cls(steps, begin, square, behind, bump, place, ahead, length)

    def of_way(self, way: int) -> slice:
        """The walls of a way."""
        return slice(self.begin[way], self.begin[way + 1])

    def of_directions(
        self, some: Bool[np.ndarray, "directions"]
    ) -> tuple[
        Int32[np.ndarray, "directions"], Int32[np.ndarray, "slots"], Int[np.ndarray, "slots"]
    ]:
        """The walls of some directions, by direction.

        **Arguments:**

        - `some`: which directions.

        **Returns:** the first slot of each direction; the direction and the wall of each slot.
        """
        way = self.steps.way
        count = np.where(some, np.diff(self.begin)[way], 0)
        first = np.cumsum(count) - count
        direction = np.repeat(np.arange(way.size, dtype=np.int32), count)
        wall = np.arange(direction.size) + (self.begin[way] - first)[direction]
        return first.astype(np.int32), direction, wall

    @property
    def way(self) -> Int[np.ndarray, "walls"]:
        """The way of each wall."""
        return np.repeat(np.arange(self.begin.size - 1), np.diff(self.begin))

    def followed(
        self, way: int
    ) -> Iterator[tuple[Int[np.ndarray, "some"], Int[np.ndarray, "some"], Int[np.ndarray, "some"]]]:
        """The free squares run by run, a million or so at a time: the squares, the walls that they
        run to, counted from the first one of the way, and the steps until they are there.
        """
        square, hop = self.square[self.of_way(way)], self.steps.hop(way)
        count = self.behind[self.of_way(way)] + 1
        end = np.cumsum(count)
        cuts = np.unique(np.searchsorted(end, np.arange(0, end[-1], _AT_ONCE)))
        for some in np.split(np.arange(count.size), cuts[1:]):
            wall = np.repeat(some, count[some])
            left = end[wall] - 1 - np.arange(end[some[0]] - count[some[0]], end[some[-1]])
            yield square[wall] - left * hop, wall, left

    def of_cells(
        self, cells: CellSpace
    ) -> tuple[Int32[np.ndarray, "ways positions"], Int32[np.ndarray, "ways positions"]]:
        """The wall that each position runs to in each way, counted from the first one of the way,
        and the steps until it is there.
        """
        ends, lengths = np.empty((2, self.begin.size - 1, cells.positions), np.int32)
        position = cells.position_of_square.ravel()
        for way, (end, length) in enumerate(zip(ends, lengths, strict=True)):
            for square, wall, left in self.followed(way):
                here = position[square]
                end[here], length[here] = wall, left
        return ends, lengths


@dataclasses.dataclass(frozen=True, eq=False)
class _Walls:
    """The walls of one way."""

    square: Int[np.ndarray, "walls"]
    behind: Int[np.ndarray, "walls"]
    order: Int[np.ndarray, "walls"]
    "The walls in the order in which they come along the lines of the way."
    along: Int[np.ndarray, "walls"]
    "Their places there, in this order."

    @classmethod
    def of(cls, steps: Steps, way: int) -> "_Walls":
        possible = steps.possible(way)
        square = np.flatnonzero(steps.free & ~possible)
        begins = np.flatnonzero(steps.starts(way, possible))
        begin, along = steps.places(int(steps.line[way]), np.stack([begins, square]))
        order = np.argsort(along)
        along = along[order]
        # As many runs begin as end, the next one after the end of the one before.
        behind = np.empty_like(along)
        behind[order] = along - np.sort(begin)
        return cls(square, behind, order, along)
