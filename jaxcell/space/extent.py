import dataclasses
import functools
import math

import numpy as np
from jaxtyping import Float

from ..base.shown import Shown
from .cells import MAX_CELLS, TOLERANCE, CellSpace, along_grid
from .motion import Motion
from .occupancy import MOST_SQUARES, in_squares
from .stencils import stencil
from .workspace import Workspace, edges


# More directions give no new ways for steps of a few squares.
_MAX_DIRECTIONS = 3600
# Stencils that cross more squares take too long to list.
_MAX_CROSSED = 50_000


@dataclasses.dataclass(frozen=True, eq=False)
class Extent(Shown):
    """The size of a cell space, from which its memory is estimated before the space is created."""

    workspace: Workspace | None
    rows: int
    columns: int
    positions: float | int
    directions: int
    cell: float
    walls: Float[np.ndarray, "walls 2 2"]
    "The ends of each wall, in cells."

    @classmethod
    def about(cls, workspace: Workspace, cell: float, directions: int) -> "Extent | None":
        """Estimate the extent of a cell space; `None` if [`CellSpace.of`][] would not create it."""
        area = workspace.free_space.area
        corner = workspace.boundary.min(axis=0)
        sides = workspace.boundary.max(axis=0) - corner
        if not (0 < cell < math.inf and sides.max() < cell * MOST_SQUARES and directions >= 1):
            return None
        width, height = (sides / cell).tolist()
        positions = area / cell / cell
        if width * height > MOST_SQUARES or positions * directions > MAX_CELLS:
            return None
        walls = in_squares(edges(workspace.free_space)[:, 1:], corner, cell)
        rows, columns = math.ceil(height - TOLERANCE), math.ceil(width - TOLERANCE)
        return cls(workspace, rows, columns, positions, directions, cell, walls)

    @classmethod
    def of(cls, cells: CellSpace) -> "Extent":
        walls = np.empty((0, 2, 2)) if cells.workspace is None else cells.walls[:, 1:]
        rows, columns = cells.free.shape
        sizes = cells.positions, cells.directions, cells.cell
        return cls(cells.workspace, rows, columns, *sizes, walls)

    @functools.cached_property
    def gridded(self) -> bool:
        return along_grid(self.walls)

    @functools.cached_property
    def wall_length(self) -> float:
        """The sum of the lengths of the walls, in cells."""
        return float(np.hypot(*(self.walls[:, 1] - self.walls[:, 0]).T).sum())

    @property
    def squares(self) -> float:
        """Number of squares of the grid, whether free or not."""
        return float(self.rows) * self.columns

    @property
    def size(self) -> float | int:
        return self.positions * self.directions

    def ways(self, motion: Motion) -> int:
        """Estimate the largest number of ways, which are classes of directions with equal steps."""
        length = min(motion.in_cells(self.cell), 1e9)
        directions = min(self.directions, _MAX_DIRECTIONS)
        grid = (self.rows, self.columns)
        if not self.gridded:
            # Slanted walls separate some directions that share a way on a grid, as measured.
            return min(self.directions, 32 + round(0.45 * self.directions))
        if length * directions > _MAX_CROSSED:
            ends = stencil(directions, Motion(length, "endpoint"), grid)
            inside = (np.abs(ends.offset) < grid).all(axis=1)[ends.way]
            return int(np.count_nonzero(inside)) + (not inside.all())
        return len(stencil(directions, Motion(length, motion.collision), grid).offset)

    def bumps(self, motion: Motion) -> float | int:
        """Estimate the number of cells from which a step is not possible."""
        length = motion.in_cells(self.cell)
        return self.directions * min(self.positions, self.wall_length * length / 2)

    def near_walls(self, motion: Motion) -> float | int:
        """Estimate the number of pairs of a position and a wall within a step of it."""
        length = motion.in_cells(self.cell)
        around = 2 * length * self.wall_length + len(self.walls) * math.pi * length**2
        return 0.0 if self.gridded else min(around, len(self.walls) * self.positions)
