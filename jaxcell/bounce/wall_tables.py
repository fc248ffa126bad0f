import dataclasses

import numpy as np
from jaxtyping import Bool, Int, Int32

from ..base.shown import Shown
from ..space import CELL_BY_CELL, Motion
from ..space.steps import Steps
from .straight_runs import Runs


@dataclasses.dataclass(frozen=True, eq=False)
class Walls(Shown):
    """Tables of the next wall after each wall, for grids of one shape and any bouncing angle.

    A *way* is a class of directions with equal steps (see [`jaxcell.bounce.Moves`][]). A wall of a
    way is a free square where a step of that way bumps. A robot that bumps at a wall of way `v`,
    and turns to a direction of way `w`, next bumps at a wall of `w`. The *slot* of a wall is its
    number among the walls of its way. All ways and grids have the same number of slots. Unused
    slots lead to the last slot, which is never a wall.
    """

    way: Int[np.ndarray, "directions"]
    "The way (class of directions with equal steps) of each direction."
    count: Int32[np.ndarray, "grids ways"]
    "Number of walls of each way, a class of directions with equal steps."
    behind: Int32[np.ndarray, "grids ways slots"]
    "Number of squares behind each wall, from which the robot runs into it; -1 for no wall."
    next: Int32[np.ndarray, "grids ways ways slots"]
    "For each wall of way `v`, `next[:, v, w]` is the slot of the wall of way `w` that follows it."
    length: Int32[np.ndarray, "grids ways ways slots"]
    "Number of steps from each wall to the wall in the same entry of `next`; -1 for no wall."

    @classmethod
    def of(cls, steps: Steps) -> "Walls":
        """Tabulate the walls of each grid. The size grows with the square of the number of ways."""
        runs, ways, grids = Runs.of(steps), len(steps.offset), len(steps.free)
        way = np.repeat(np.arange(ways), np.diff(runs.begin))
        grid = runs.square // steps.free[0].size
        count = np.bincount(way * grids + grid, minlength=ways * grids).reshape(ways, grids)
        first = np.cumsum(count, axis=1) - count
        slots = int(count.max(initial=0)) + 1
        slot = np.arange(way.size) - runs.begin[way] - first[way, grid]
        behind = np.full((grids, ways, slots), -1, np.int32)
        behind[grid, way, slot] = runs.behind
        after = np.full((grids, ways, ways, slots), slots - 1, np.int32)
        length = np.full(after.shape, -1, np.int32)
        at = (grid * ways + way) * ways * slots + slot
        before = first[:, runs.bump // steps.free[0].size]
        for w in range(ways):
            after.reshape(-1)[at + w * slots] = (runs.ahead[w] - before[w])[runs.place]
            length.reshape(-1)[at + w * slots] = runs.length[w, runs.place]
        return cls(steps.way, count.T.astype(np.int32), behind, after, length)

    @property
    def slots(self) -> int:
        """Number of slots per way: an upper bound on the number of walls of a way."""
        return self.behind.shape[-1]


def walls(
    free: Bool[np.ndarray, "grids rows columns"], directions: int, *, motion: Motion = CELL_BY_CELL
) -> Walls:
    """Tabulate the walls of grids, whose obstacles are the squares that are not free.

    It runs on the host, because the number of walls depends on the grids.

    **Arguments:** masks of free squares, whose row 0 is the lowest and whose squares have sides of
    1 m; the number of directions; and a motion. **Returns:** the walls of all grids.

    An open room of two rows of three squares; two lie at the East wall, three at the North wall:

        >>> import numpy as np
        >>> from jaxcell import bounce
        >>> walls = bounce.walls(np.ones((1, 2, 3), bool), directions=4)
        >>> walls.count.tolist()
        [[2, 3, 2, 3]]
    """
    return Walls.of(Steps.on_grids(free, directions, motion))
