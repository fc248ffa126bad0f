import dataclasses
from collections.abc import Iterator

import numpy as np
from jaxtyping import Bool, Int, Int32

from ..space import CellSpace
from ..space.copies import copies
from ..space.steps import Steps


AT_ONCE = 2**20
"""The approximate number of squares that `Runs.followed` yields at a time."""


@dataclasses.dataclass(frozen=True, eq=False)
class Runs:
    """The ends of straight runs on grids of one shape. They do not depend on the bouncing angle.

    A *way* is a class of directions with equal steps, as in `jaxcell.space.steps.Steps`. A *wall*
    of a way is a free square where a robot that moves in one of these directions bumps. Walls are
    listed way by way, and within a way by their squares. Squares are numbered grid by grid.
    """

    steps: Steps
    begin: Int[np.ndarray, "_"]
    "The first wall of each way (class of directions); the last entry is the number of walls."
    square: Int[np.ndarray, "walls"]
    behind: Int[np.ndarray, "walls"]
    "Number of squares behind each wall, from which the robot runs into it."
    bump: Int[np.ndarray, "bumps"]
    "The squares where a robot bumps in at least one direction, in ascending order."
    place: Int[np.ndarray, "walls"]
    "For each wall, the index in `bump` of its square."
    ahead: Int32[np.ndarray, "ways bumps"]
    "The wall ahead of each square of `bump` in each way, counted from the first wall of the way."
    length: Int32[np.ndarray, "ways bumps"]
    "Number of steps from each square of `bump` to the wall that the robot meets in each way."

    @classmethod
    def of(cls, steps: Steps) -> "Runs":
        walls = [_walls(steps, way) for way in range(len(steps.offset))]
        squares, behind, order, along = zip(*walls, strict=True)
        begin = np.cumsum([0, *map(len, squares)])
        square = np.concatenate(squares)
        # A square may be a wall of many ways. The wall ahead of it depends on the next way only.
        bump, place = np.unique(square, return_inverse=True)
        ahead, length = np.empty((2, len(walls), bump.size), np.int32)
        places: dict[tuple[int, ...], Int[np.ndarray, bumps]] = {}
        for way, offset in enumerate(map(tuple, steps.offset.tolist())):
            if offset not in places:
                places[offset] = steps.places(way, bump)
            # From a free square the next wall along the line is on the same run.
            following = np.searchsorted(along[way], places[offset])
            ahead[way] = order[way][following]
            length[way] = along[way][following] - places[offset]
        return cls(steps, begin, square, np.concatenate(behind), bump, place, ahead, length)

    def of_way(self, way: int) -> slice:
        """Return the slice that selects the walls of one way from an array over all walls."""
        return slice(self.begin[way], self.begin[way + 1])

    def of_directions(
        self, chosen: Bool[np.ndarray, "directions"]
    ) -> tuple[
        Int32[np.ndarray, "directions"], Int32[np.ndarray, "slots"], Int[np.ndarray, "slots"]
    ]:
        """List the walls of the `chosen` directions, one direction after the other.

        **Returns:** the index of the first wall of each direction in this list, and the direction
        and the number of each listed wall.
        """
        way = self.steps.way
        count = np.where(chosen, np.diff(self.begin)[way], 0)
        first = np.cumsum(count) - count
        direction, number = copies(count)
        wall = self.begin[way[direction]] + number
        return first.astype(np.int32), direction.astype(np.int32), wall

    def followed(
        self, way: int
    ) -> Iterator[tuple[Int[np.ndarray, "part"], Int[np.ndarray, "part"], Int[np.ndarray, "part"]]]:
        """Yield the free squares, sorted by the straight runs of a way, about a million at a time.

        Each part has the squares, the walls at the ends of their runs, counted from the first wall
        of the way, and the numbers of steps to these walls.
        """
        square, hop = self.square[self.of_way(way)], self.steps.hop(way)
        count = self.behind[self.of_way(way)] + 1
        end = np.cumsum(count)
        cuts = np.unique(np.searchsorted(end, np.arange(0, end[-1], AT_ONCE)))
        for part in np.split(np.arange(count.size), cuts[1:]):
            wall = np.repeat(part, count[part])
            left = end[wall] - 1 - np.arange(end[part[0]] - count[part[0]], end[part[-1]])
            yield square[wall] - left * hop, wall, left

    def of_cells(
        self, cells: CellSpace
    ) -> tuple[Int32[np.ndarray, "ways positions"], Int32[np.ndarray, "ways positions"]]:
        """Find the wall to which the robot runs from each position, and the number of steps.

        The results have a row for each way (class of directions with equal steps). Walls are
        counted from the first wall of the way.
        """
        ends, lengths = np.empty((2, self.begin.size - 1, cells.positions), np.int32)
        position = cells.position_of_square.ravel()
        for way, (end, length) in enumerate(zip(ends, lengths, strict=True)):
            for square, wall, left in self.followed(way):
                end[position[square]], length[position[square]] = wall, left
        return ends, lengths


def _walls(steps: Steps, way: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Find the walls of one way, a class of directions with equal steps.

    **Returns:** the squares of the walls; the number of squares behind each wall, from which the
    robot runs into it; the order of the walls along the lines on which robots run, as indices; and
    the positions of the walls on these lines, in this order.
    """
    possible = steps.possible(way)
    square = np.flatnonzero(steps.free & ~possible)
    begins = np.flatnonzero(steps.starts(way, possible))
    begin, along = steps.places(way, np.stack([begins, square]))
    order = np.argsort(along)
    along = along[order]
    # As many runs begin as end, and the next run begins after the end of the one before.
    behind = np.empty_like(along)
    behind[order] = along - np.sort(begin)
    return square, behind, order, along
