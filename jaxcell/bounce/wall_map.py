import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Int, Int32

from ..mapping.section import bucket
from ..space import CELL_BY_CELL, CellSpace, Motion
from ..space.steps import Steps
from .runs import Runs


@dataclasses.dataclass(frozen=True, eq=False)
class Walls:
    """Which wall follows which in grids of one shape, whatever the bouncing angle.

    A *way* is what directions have in common in which steps do the same (see
    [`jaxcell.bounce.Moves`][]), and a wall of a way is a free square where it bumps. At a wall of
    way `v` the robot turns; if it then goes in way `w`, it next bumps at a wall of `w`. Walls of a
    way are in slots, as many for every way and grid, the last of which is nowhere in use.
    """

    way: Int[np.ndarray, "directions"]
    "The way of each direction."
    count: Int32[np.ndarray, "grids ways"]
    "Number of walls of each way."
    behind: Int32[np.ndarray, "grids ways slots"]
    "Number of squares from which the robot runs into a wall, without its own; -1 where is none."
    next: Int32[np.ndarray, "grids ways ways slots"]
    "`next[:, v, w]` is the slot of the wall of way `w` after each wall of way `v`."
    length: Int32[np.ndarray, "grids ways ways slots"]
    "Steps that the robot makes to there from where it bumped, -1 where there is no wall."

    @property
    def slots(self) -> int:
        """Number of slots of a way."""
        return self.behind.shape[-1]

    def machine(
        self, shifts: Sequence[int], grid: int = 0
    ) -> tuple[
        Int[np.ndarray, "shifts walls"], Int[np.ndarray, "shifts walls"], Int[np.ndarray, "walls"]
    ]:
        """The walls of all directions of one grid as the states of a machine.

        **Arguments:**

        - `shifts`: by how many directions the robot may turn at a bump.
        - `grid`: the number of the grid.

        **Returns:** the next wall after each turn, the steps to it, and the squares behind each.
        """
        count = self.count[grid, self.way]
        first = np.cumsum([0, *count])
        images, lengths = np.empty((2, len(shifts), first[-1]), np.int64)
        for i, shift in enumerate(shifts):
            for d, way in enumerate(self.way.tolist()):
                after = (d + shift) % self.way.size
                here = grid, way, self.way[after], slice(count[d])
                images[i, first[d] : first[d + 1]] = first[after] + self.next[here]
                lengths[i, first[d] : first[d + 1]] = self.length[here]
        behind = [self.behind[grid, way, :size] for way, size in zip(self.way, count, strict=True)]
        return images, lengths, np.concatenate(behind)


def walls(
    free: Bool[np.ndarray, "grids rows columns"],
    directions: int,
    *,
    motion: Motion = CELL_BY_CELL,
) -> Walls:
    """Which wall follows which on grids whose blocked squares are the obstacles.

    **Arguments:** as for [`jaxcell.bounce.grid_moves`][], but for a batch of grids.

    **Returns:** [`Walls`][].

    An open room of two rows of three squares; two of them lie at the East wall and three at the
    North wall:

        >>> import numpy as np
        >>> from jaxcell import bounce
        >>> walls = bounce.walls(np.ones((1, 2, 3), bool), directions=4)
        >>> walls.count.tolist()
        [[2, 3, 2, 3]]
    """
    return wall_tables(Steps.on_grids(free, directions, motion))


def cell_walls(cells: CellSpace, *, motion: Motion = CELL_BY_CELL) -> Walls:
    """Which wall follows which on a map, as a batch of one.

    **Arguments:** as for [`jaxcell.bounce.moves`][].

    **Returns:** [`Walls`][]. Where directions have few steps in common they are many: the square of
    the number of ways, times slots.

    **Raises:** as [`jaxcell.bounce.moves`][].

    A corridor of three squares, with the directions East and West:

        >>> from jaxcell import bounce, examples
        >>> cells = examples.corridor()
        >>> bounce.cell_walls(cells).behind[0, :, 0].tolist()
        [2, 2]
    """
    return wall_tables(Steps.of(cells, motion))


def wall_tables(steps: Steps) -> Walls:
    """Which wall follows which where one step leads as given.

    **Arguments:**

    - `steps`: the steps on some grids of one shape.

    **Returns:** [`Walls`][].
    """
    runs, ways, grids = Runs.of(steps), len(steps.offset), len(steps.free)
    way, grid = runs.way, runs.square // steps.free[0].size
    count = np.bincount(way * grids + grid, minlength=ways * grids).reshape(ways, grids)
    first = np.cumsum(count, axis=1) - count
    slots = bucket(int(count.max(initial=0)) + 1)
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
    return Walls(steps.way, count.T.astype(np.int32), behind, after, length)
