import math

import numpy as np
import shapely

from ..space import CellSpace


# In cells. A step that comes no nearer to a wall than this, or crosses it by more, is a clear case.
_NEAR = 1e-7


class Walker:
    """One step of a robot at a time, by predicates of shapely on the free space."""

    def __init__(self, cells: CellSpace, step: float | None, collision: str) -> None:
        """**Arguments:** as for [`jaxcell.bounce.moves`][]; `cells` are those of a map."""
        assert cells.workspace is not None
        self.cells, self.collision = cells, collision
        self.step = cells.cell if step is None else step
        near, space = _NEAR * cells.cell, cells.workspace.free_space
        self.shrunk, self.grown = (space.buffer(by, join_style="mitre") for by in (-near, near))
        shapely.prepare(self.shrunk)
        shapely.prepare(self.grown)

    def target(self, z: int) -> int | None:
        """The position that a step from a cell leads to, its own where the robot bumps.

        `None` where that hangs on what a step is that touches walls on both sides, or runs into a
        corner.
        """
        cells = self.cells
        direction, position = divmod(z, cells.positions)
        row, column = divmod(int(cells.square[position]), cells.free.shape[1])
        angle = 2 * math.pi * direction / cells.directions
        across, up = (self.step / cells.cell * f(angle) for f in (math.cos, math.sin))
        to_column = math.floor(round(column + 0.5 + across, 9))
        to_row = math.floor(round(row + 0.5 + up, 9))
        rows, columns = cells.free.shape
        if not (0 <= to_row < rows and 0 <= to_column < columns and cells.free[to_row, to_column]):
            return position
        free = self._free(column + 0.5, row + 0.5, across, up)
        if free is None:
            return None
        return int(cells.position_of_square[to_row, to_column]) if free else position

    def _free(self, column: float, row: float, across: float, up: float) -> bool | None:
        start = np.array([column, row])
        way = np.array([start, start + np.array([across, up])])
        if self.collision == "endpoint":
            # The space is closed: what is on a wall is in it.
            return bool(self.grown.covers(shapely.Point(self._metres(way[1]))))
        if self.shrunk.covers(self._line(way)):
            return True
        if not self.grown.covers(self._line(way)):
            return False
        # It touches a wall. If that is on one side, a step a little to the other side is free.
        aside = 10 * _NEAR * np.array([-up, across]) / math.hypot(across, up)
        if any(self.grown.covers(self._line(way + by)) for by in (aside, -aside)):
            return True
        return None

    def _metres(self, places: np.ndarray) -> np.ndarray:
        return places * self.cells.cell + np.array(self.cells.origin)

    def _line(self, way: np.ndarray) -> shapely.LineString:
        return shapely.LineString(self._metres(way))
