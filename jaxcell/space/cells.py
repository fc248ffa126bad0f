import dataclasses
import functools
import math
import os
from typing import Any

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int

from ..base.doubts import Doubt, warn
from ..base.limits import Crop, Piece, Unknown
from ..base.shown import Pictured
from ..base.wide import namespace
from .occupancy import TOLERANCE, in_squares, rasterise
from .workspace import RoomLike, Workspace, edges


MAX_CELLS = 2**31 - 1
# The least number of positions on a map that suggests no side of a cell.
_POSITIONS = 200
# Largest side or coordinate in metres, and angle in radians; no product with it overflows.
_LARGEST = 1e9


@dataclasses.dataclass(frozen=True, eq=False)
class CellSpace(Pictured):
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
    def of(cls, workspace: RoomLike, cell: float, directions: int) -> "CellSpace":
        """Divide the free space of a map into cells with sides of `cell` metres.

        `workspace` may also be a file, a polygon or a grid; see [`Workspace.of_input`][].

        **Raises:** `ValueError` if no cell is free, or if there are more than `2**31 - 1` cells;
        `MemoryError` if the squares do not fit in the free memory.
        """
        _check_side(cell)
        workspace = Workspace.of_input(workspace)
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

        Lengths are in metres. If the map suggests no side of a cell, the side is a round length,
        for at least 200 positions, and a warning names it; there are 8 directions if the map
        suggests none.

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
        return in_squares(edges(self.room.free_space), self.origin, self.cell)

    def centre(self, z: Int[Any, "..."] | int) -> tuple[Any, Any, Any]:
        """Compute the centre `(x, y, theta)` of each cell, in metres and radians.

        It works under `jit` and `vmap`, where a cell that does not exist has no centre, but NaN.
        """
        xp, (z,) = _arrays(None, z)
        away = (z < 0) | (z >= self.size)
        if xp is np and away.any():
            raise ValueError(
                f"cell {z[away].flat[0]} does not exist; cells are 0 to {self.size - 1}"
            )
        direction, position = xp.divmod(z, self.positions)
        square = xp.divmod(xp.asarray(self.square)[position], self.free.shape[1])
        row, column, direction = (xp.asarray(one, float) for one in (*square, direction))
        x = self.origin[0] + (column + 0.5) * self.cell
        y = self.origin[1] + (row + 0.5) * self.cell
        theta = 2 * np.pi * direction / self.directions
        if xp is np:
            return np.asarray(x), np.asarray(y), np.asarray(theta)
        return tuple(xp.where(away, np.nan, place) for place in (x, y, theta))

    def index(
        self, x: Float[Any, "..."] | float, y: Float[Any, "..."] | float, theta: Any = 0.0
    ) -> Int[Any, "..."]:
        """Find the cell of each configuration; coordinates are in metres and radians.

        The square of a point must be free. A point on an edge is in the upper or right square. It
        works under `jit` and `vmap`, where a point whose square is not free has no cell, but -1.
        """
        xp, (x, y, theta) = _arrays(float, x, y, theta)
        if xp is np and not all((np.abs(values) <= _LARGEST).all() for values in (x, y, theta)):
            raise ValueError(
                f"a configuration needs finite numbers x, y, theta of at most {_LARGEST:g}"
            )
        square, inside = _squares(xp, self, x, y)
        position = xp.where(inside, xp.asarray(self.position_of_square)[square], -1)
        if xp is not np:
            known = (position >= 0) & xp.isfinite(theta)
            return xp.where(known, _numbered(xp, self, position, theta), -1)
        if (position < 0).any():
            bad = np.argmax(np.atleast_1d(position) < 0)
            where = (
                "lies in an obstacle or too near a wall" if inside.flat[bad] else "is off the map"
            )
            raise ValueError(f"the point ({x.flat[bad]:g}, {y.flat[bad]:g}) {where}")
        return _numbered(np, self, position, theta)


def nearest_cell(cells: CellSpace, x: Any, y: Any, theta: Any) -> Int[Any, "..."]:
    """Find the cell of each configuration, in the nearest free square. It works under `jit`.

    **Arguments:** a cell space, and coordinates in metres and radians. Points may lie off the map
    or in obstacles, unlike in [`jaxcell.space.CellSpace.index`][]. **Returns:** the cells.

    A robot that has slipped a little off a map of three squares:

        >>> from jaxcell import examples, space
        >>> cells = examples.corridor()
        >>> int(space.nearest_cell(cells, 2.5, 1.01, 0.0))
        2
    """
    xp, (x, y, theta) = _arrays(float, x, y, theta)
    square, _ = _squares(xp, cells, x, y)
    return _numbered(xp, cells, xp.asarray(_nearest_positions(cells))[square], theta)


@functools.lru_cache(maxsize=8)
def _nearest_positions(cells: CellSpace) -> Int[np.ndarray, "rows columns"]:
    # A robot that only carries a filter does not have SciPy.
    from scipy import ndimage

    row, column = ndimage.distance_transform_edt(
        ~cells.free, return_distances=False, return_indices=True
    )
    return cells.position_of_square[row, column]


def _arrays(kind: type | None, *values: Any) -> tuple[Any, Any]:
    """Return the namespace of values, that of JAX if it traces them, and the values as arrays."""
    xp = namespace(*values)
    arrays = [xp.asarray(value) for value in values]
    for array in arrays:
        if array.dtype.kind not in "biuf":
            raise ValueError(f"expected numbers of cells, metres or radians, got {array}")
    return xp, xp.broadcast_arrays(*(xp.asarray(array, kind) for array in arrays))


def _squares(xp: Any, cells: CellSpace, x: Any, y: Any) -> tuple[tuple[Any, ...], Any]:
    """Find the row and column of the square nearest to each point, and mask the points in it."""
    square: tuple[Any, ...] = ()
    inside: Any = True
    for place, low, count in zip((y, x), cells.origin[::-1], cells.free.shape, strict=True):
        along = xp.floor(xp.round((place - low) / cells.cell, 9))
        inside = inside & (along >= 0) & (along < count)
        square += (xp.clip(along, 0, count - 1).astype(np.int32),)
    return square, inside


def _numbered(xp: Any, cells: CellSpace, position: Any, theta: Any) -> Any:
    turn = 2 * np.pi / cells.directions
    direction = xp.floor(xp.round(theta / turn + 0.5, 9)) % cells.directions
    return xp.asarray(direction.astype(np.int32) * cells.positions + position, np.int32)


def _check_side(cell: float) -> None:
    if not (math.isfinite(cell) and cell > 0):
        raise ValueError(f"cell: the side must be a positive number of metres, got {cell}")
    if cell > _LARGEST:
        raise ValueError(f"cell: the side must be at most {_LARGEST:g} m, got {cell}")


def suggested(
    room: RoomLike,
    cell: float | None,
    directions: int | None,
    robot_radius: float | None,
    unknown: Unknown = "wall",
    piece: Piece | None = None,
    crop: Crop = None,
) -> tuple[Workspace, float, int]:
    """Read a map; return it with the given or suggested side of a cell and number of directions."""
    workspace = Workspace.of_input(room, unknown, crop)
    changed: dict[str, Any] = {"robot_radius": robot_radius, "piece": piece}
    if changed := {name: value for name, value in changed.items() if value is not None}:
        workspace = dataclasses.replace(workspace, **changed)
    if piece is None and workspace.piece == "all" and workspace.pieces > 1:
        many = f"the free space has {workspace.pieces:,} separate pieces"
        warn(f"{workspace.name}: {many}: all are used; for one of them, set `piece`", Doubt)
    side = workspace.cell if cell is None else cell
    if side is None:
        side = _usual_side(workspace)
        place = workspace.name if room is workspace else room
        doubt = (
            f"{place}: the map suggests no side of a cell, so cells are squares of {side:g} m; "
            "set another side with `cell`"
        )
        warn(doubt, Doubt)
    return workspace, side, (workspace.directions or 8) if directions is None else directions


def _usual_side(workspace: Workspace) -> float:
    """Return a round side of cells in metres, for at least as many positions as `_POSITIONS`."""
    most = math.sqrt(workspace.free_space.area / _POSITIONS)
    power = 10.0 ** math.floor(math.log10(most))
    sides = [digit * power for digit in (1.0, 2.0, 2.5, 5.0)]
    return max(side for side in sides if side <= most * (1 + TOLERANCE))


def along_grid(walls: Float[np.ndarray, "walls 2 2"]) -> bool:
    """Check whether all walls run along edges of squares. Coordinates are in cells."""
    on_lines = np.abs(walls - np.round(walls)) < TOLERANCE
    level = np.abs(walls[:, 0] - walls[:, 1]) < TOLERANCE
    return bool(on_lines.all() and level.any(axis=1).all())


def free_space_in_cells(cells: CellSpace) -> shapely.Geometry:
    """Return the free space, in cells from the lower left corner of the grid."""
    if cells.workspace is None:
        row, column = np.divmod(cells.square, cells.position_of_square.shape[1])
        return shapely.union_all(shapely.box(column, row, column + 1, row + 1))
    return shapely.transform(
        cells.workspace.free_space, lambda at: in_squares(at, cells.origin, cells.cell)
    )
