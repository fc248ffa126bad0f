import dataclasses
import math

import numpy as np
from jaxtyping import Float

from .cells import MAX_CELLS, TOLERANCE, CellSpace, along_grid
from .motion import Motion
from .occupancy import MOST_SQUARES
from .stencils import stencil
from .workspace import Workspace, edges


# More directions give no new ways for steps of a few squares.
_MAX_DIRECTIONS = 3600
# Stencils that cross more squares take too long to list.
_MAX_CROSSED = 50_000


@dataclasses.dataclass(frozen=True)
class Extent:
    """The size of a cell space, from which its memory is estimated before it is made."""

    workspace: Workspace | None
    rows: int
    columns: int
    positions: float | int
    directions: int
    cell: float
    gridded: bool
    "True if all walls run along edges of squares."
    walls: int
    "Number of walls."
    wall_length: float
    "The sum of the lengths of the walls, in cells."

    @classmethod
    def about(cls, workspace: Workspace, cell: float, directions: int) -> "Extent | None":
        """Estimate the extent of a cell space before it is made, from the area of its free space.

        Returns `None` if [`CellSpace.of`][] refuses the space.

        A room of 4 x 2 m has 800 cells of 0.1 m, whatever the number of directions:

            >>> from jaxcell import space
            >>> from jaxcell.space.extent import Extent
            >>> room = space.Workspace([(0, 0), (4, 0), (4, 2), (0, 2)])
            >>> round(Extent.about(room, cell=0.1, directions=8).positions)
            800
        """
        area = workspace.free_space.area
        corner = workspace.boundary.min(axis=0)
        sides = workspace.boundary.max(axis=0) - corner
        if not (0 < cell < math.inf and sides.max() < cell * MOST_SQUARES and directions >= 1):
            return None
        width, height = (sides / cell).tolist()
        positions = area / cell / cell
        if width * height > MOST_SQUARES or positions * directions > MAX_CELLS:
            return None
        walls = (edges(workspace.free_space) - corner) / cell
        shape = math.ceil(height - TOLERANCE), math.ceil(width - TOLERANCE)
        return cls._of(workspace, walls, shape, positions, directions, cell)

    @classmethod
    def of(cls, cells: CellSpace) -> "Extent":
        """Measure the extent of a cell space."""
        walls = np.empty((0, 3, 2)) if cells.workspace is None else cells.walls
        rows, columns = cells.free.shape
        return cls._of(
            cells.workspace, walls, (rows, columns), cells.positions, cells.directions, cells.cell
        )

    @classmethod
    def _of(
        cls,
        workspace: Workspace | None,
        walls: Float[np.ndarray, "walls 3 2"],
        shape: tuple[int, int],
        positions: float | int,
        directions: int,
        cell: float,
    ) -> "Extent":
        length = float(np.hypot(*(walls[:, 2] - walls[:, 1]).T).sum())
        gridded = along_grid(walls[:, 1:])
        rows, columns = shape
        return cls(
            workspace, rows, columns, positions, directions, cell, gridded, len(walls), length
        )

    @property
    def squares(self) -> float:
        """Number of squares of the grid, whether free or not."""
        return float(self.rows) * self.columns

    @property
    def size(self) -> float | int:
        """Number of cells."""
        return self.positions * self.directions

    def ways(self, motion: Motion) -> int:
        """Estimate the number of ways, sets of directions with equal steps, from above."""
        length = min(motion.in_cells(self.cell), 1e9)
        directions = min(self.directions, _MAX_DIRECTIONS)
        grid = (self.rows, self.columns)
        if not self.gridded:
            # Slanted walls separate some directions that share a way on a grid, as measured.
            return min(self.directions, 32 + round(0.45 * self.directions))
        if motion.collision != "endpoint" and length * directions > _MAX_CROSSED:
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
        around = 2 * length * self.wall_length + self.walls * math.pi * length**2
        return 0.0 if self.gridded else min(around, self.walls * self.positions)
