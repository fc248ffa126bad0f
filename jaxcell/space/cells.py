import dataclasses
import functools
import math
import os
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from .occupancy import TOLERANCE, rasterise
from .workspace import Workspace, edges


MAX_CELLS = 2**31 - 1
# Largest side or coordinate in metres, and angle in radians; no product with it overflows.
_LARGEST = 1e9


@dataclasses.dataclass(frozen=True, eq=False)
class CellSpace:
    """The free configurations of a robot, divided into cells (Alam 2018, section 2.3.2).

    Squares of side `cell` cover the bounding box of the map; a square is free if its centre lies in
    the closed free space. The free squares are the *positions*, counted row by row from the bottom
    left, x fastest. A cell is a position and a direction, with the number `z = direction *
    positions + position`. Direction `k` points at `2 * pi * k / directions`, counter-clockwise from
    the x axis (East).

    [`CellSpace.load`][] makes a cell space from a map file, [`CellSpace.of`][] from a map, and
    [`CellSpace.of_grid`][] from a grid.

    In a corridor of three squares with two directions, cell 4 is the middle square facing West:

        >>> from jaxcell import space
        >>> room = space.Workspace([(0, 0), (3, 0), (3, 1), (0, 1)])
        >>> cells = space.CellSpace.of(room, cell=1.0, directions=2)
        >>> cells.positions, cells.size
        (3, 6)
        >>> [float(number) for number in cells.centre(4)]
        [1.5, 0.5, 3.141592653589793]
        >>> int(cells.index(1.5, 0.5, theta=3.0))
        4
    """

    workspace: Workspace | None
    cell: float
    directions: int
    origin: tuple[float, float]
    free: Bool[np.ndarray, "rows columns"]

    def __post_init__(self) -> None:
        _check_side(self.cell)
        if isinstance(self.directions, bool) or int(self.directions) != self.directions:
            raise ValueError(f"directions: expected a whole number, got {self.directions!r}")
        if self.directions < 1:
            raise ValueError(f"directions: at least 1 is needed, got {self.directions}")
        if self.positions == 0:
            raise ValueError(
                f"cell: no cell of side {self.cell:g} m has its centre in the free space"
            )
        if self.positions * self.directions > MAX_CELLS:
            raise ValueError(
                f"{self.positions} positions x {self.directions} directions are more than the "
                f"{MAX_CELLS} cells that 32 bits can count; use larger cells or fewer directions"
            )

    @classmethod
    def of(cls, workspace: Workspace, cell: float, directions: int) -> "CellSpace":
        """Divide the free space of a map into cells with sides of `cell` metres.

        **Raises:** `ValueError` if no cell is free, or if there are more than `2**31 - 1` cells;
        `MemoryError` if the squares do not fit in the free memory.
        """
        _check_side(cell)
        left, bottom = workspace.boundary.min(axis=0).tolist()
        right, top = workspace.boundary.max(axis=0).tolist()
        blocked = rasterise(workspace.free_space, (left, bottom, right, top), cell)
        return cls(workspace, float(cell), directions, (left, bottom), ~blocked)

    @classmethod
    def load(
        cls,
        path: str | os.PathLike[str],
        *,
        cell: float | None = None,
        directions: int | None = None,
    ) -> "CellSpace":
        """Read a map file and divide its free space into cells, by default as the map suggests.

        Lengths are in metres; there are 8 directions if the map suggests none.

        A lab whose map suggests cells of 1 m:

            >>> from jaxcell import bundled, space
            >>> cells = space.CellSpace.load(bundled("maps/lab_a.json"), directions=4)
            >>> cells.positions, cells.size
            (19, 76)
        """
        return cls.of(*suggested(path, cell, directions, None))

    @classmethod
    def of_grid(
        cls,
        free: Bool[np.ndarray, "rows columns"],
        directions: int,
        *,
        cell: float = 1.0,
        origin: tuple[float, float] = (0.0, 0.0),
    ) -> "CellSpace":
        """Create the cell space of a grid.

        Squares that are not free are obstacles, and row 0 is lowest. The side of a square and the
        lower left corner of the grid are in metres.
        """
        return cls(None, float(cell), directions, origin, np.array(free))

    @property
    def room(self) -> Workspace:
        """The map of the cells. **Raises:** `ValueError` if the cells were created from a grid."""
        if self.workspace is None:
            raise ValueError("cells: expected cells of a map, got cells of a grid")
        return self.workspace

    @functools.cached_property
    def square(self) -> Int[np.ndarray, "positions"]:
        """The square of each position, `row * columns + column`."""
        return np.flatnonzero(self.free).astype(np.int32)

    @functools.cached_property
    def position_of_square(self) -> Int[np.ndarray, "rows columns"]:
        """The position of each square, -1 where it is not free."""
        position = np.full(self.free.size, -1, np.int32)
        position[self.square] = np.arange(self.positions, dtype=np.int32)
        return position.reshape(self.free.shape)

    @functools.cached_property
    def positions(self) -> int:
        """Number of free squares."""
        return int(np.count_nonzero(self.free))

    @property
    def size(self) -> int:
        """Number of cells, `positions * directions`."""
        return self.positions * self.directions

    @functools.cached_property
    def gridded(self) -> bool:
        """True if all walls run along edges of squares, and so `free` determines the walls."""
        if self.workspace is None:
            return True
        return along_grid(self.walls[:, 1:])

    @functools.cached_property
    def walls(self) -> Float[np.ndarray, "walls 3 2"]:
        """The edges of the free space: the corner before each edge, its start and its end.

        Coordinates are in cells, relative to `origin`. The free space lies to the left of an edge.
        """
        return (edges(self.room.free_space) - np.array(self.origin)) / self.cell

    def centre(
        self, z: Int[np.ndarray, "..."] | int
    ) -> tuple[Float[np.ndarray, "..."], Float[np.ndarray, "..."], Float[np.ndarray, "..."]]:
        """Compute the centre `(x, y, theta)` of each cell, in metres and radians."""
        z = np.asarray(z)
        if z.size and (z.min() < 0 or z.max() >= self.size):
            wrong = z[(z < 0) | (z >= self.size)].flat[0]
            raise ValueError(f"cell {wrong} does not exist; cells are 0 to {self.size - 1}")
        direction, position = np.divmod(z, self.positions)
        row, column = np.divmod(self.square[position], self.free.shape[1])
        x = self.origin[0] + (column + 0.5) * self.cell
        y = self.origin[1] + (row + 0.5) * self.cell
        theta = 2 * np.pi * direction / self.directions
        return np.asarray(x), np.asarray(y), np.asarray(theta)

    def index(
        self,
        x: Float[np.ndarray, "..."] | float,
        y: Float[np.ndarray, "..."] | float,
        theta: Float[np.ndarray, "..."] | float = 0.0,
    ) -> Int[np.ndarray, "..."]:
        """Find the cell of each configuration; coordinates are in metres and radians.

        The square of a point must be free. A point on an edge is in the upper or right square.
        """
        x, y, theta = np.broadcast_arrays(
            np.asarray(x, float), np.asarray(y, float), np.asarray(theta, float)
        )
        if not all((np.abs(values) <= _LARGEST).all() for values in (x, y, theta)):
            raise ValueError(
                f"a configuration needs finite numbers x, y, theta of at most {_LARGEST:g}"
            )
        rows, columns = self.free.shape
        row, column = _squares(self, x, y)
        inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
        position = np.where(
            inside,
            self.position_of_square[np.clip(row, 0, rows - 1), np.clip(column, 0, columns - 1)],
            -1,
        )
        if (position < 0).any():
            bad = np.argmax(np.atleast_1d(position) < 0)
            where = (
                "lies in an obstacle or too near a wall" if inside.flat[bad] else "is off the map"
            )
            raise ValueError(f"the point ({x.flat[bad]:g}, {y.flat[bad]:g}) {where}")
        return _numbered(self, position, theta)


def nearest_cell(cells: CellSpace, x: Any, y: Any, theta: Any) -> Int[np.ndarray, "..."]:
    """Find the cell of each configuration, in the nearest free square.

    **Arguments:** a cell space, and coordinates in metres and radians. Points may lie off the map
    or in obstacles, unlike in [`jaxcell.space.CellSpace.index`][]. **Returns:** the cells.

    A robot that has slipped a little off a map of three squares:

        >>> from jaxcell import examples, space
        >>> cells = examples.corridor()
        >>> int(space.nearest_cell(cells, 2.5, 1.01, 0.0))
        2
    """
    square = tuple(
        np.clip(place, 0, size - 1)
        for place, size in zip(_squares(cells, x, y), cells.free.shape, strict=True)
    )
    return _numbered(cells, _nearest_positions(cells)[square], theta)


@functools.lru_cache(maxsize=8)
def _nearest_positions(cells: CellSpace) -> Int[np.ndarray, "rows columns"]:
    # A robot that only carries a filter does not have SciPy.
    from scipy import ndimage

    row, column = ndimage.distance_transform_edt(
        ~cells.free, return_distances=False, return_indices=True
    )
    return cells.position_of_square[row, column]


def _squares(cells: CellSpace, x: Any, y: Any) -> tuple[Any, Any]:
    row, column = (
        np.floor(np.round((place - low) / cells.cell, 9)).astype(np.int64)
        for place, low in zip((y, x), cells.origin[::-1], strict=True)
    )
    return row, column


def _numbered(cells: CellSpace, position: Any, theta: Any) -> Int[np.ndarray, "..."]:
    turn = 2 * np.pi / cells.directions
    direction = np.floor(np.round(theta / turn + 0.5, 9)).astype(np.int64) % cells.directions
    return np.asarray(direction * cells.positions + position, np.int32)


def _check_side(cell: float) -> None:
    if not (math.isfinite(cell) and cell > 0):
        raise ValueError(f"cell: the side must be a positive number of metres, got {cell}")
    if cell > _LARGEST:
        raise ValueError(f"cell: the side must be at most {_LARGEST:g} m, got {cell}")


def suggested(
    path: str | os.PathLike[str],
    cell: float | None,
    directions: int | None,
    robot_radius: float | None,
) -> tuple[Workspace, float, int]:
    """Read a map; return it with the given or suggested side of a cell and number of directions."""
    workspace = Workspace.load(path)
    if robot_radius is not None:
        workspace = dataclasses.replace(workspace, robot_radius=robot_radius)
    side = workspace.cell if cell is None else cell
    if side is None:
        raise ValueError(
            f"cell: {os.fspath(path)} suggests no side of a cell; expected one in metres"
        )
    return workspace, side, (workspace.directions or 8) if directions is None else directions


def along_grid(walls: Float[np.ndarray, "walls 2 2"]) -> bool:
    """Check whether all walls run along edges of squares. Coordinates are in cells."""
    on_lines = np.abs(walls - np.round(walls)) < TOLERANCE
    level = np.abs(walls[:, 0] - walls[:, 1]) < TOLERANCE
    return bool(on_lines.all() and level.any(axis=1).all())
