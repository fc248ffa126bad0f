"""Convert occupancy grids to polygons, and polygons to occupancy grids.

A grid is a Boolean array, true where a square is blocked, with row 0 at the bottom and column 0 at
the left.
"""

import math

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int

from ..base.memory import check
from .copies import copies


MOST_SQUARES = 2**30
# Coordinates are compared in units of a cell, to this tolerance: a point closer than this to a
# wall or to an edge between cells lies on it, on every platform. It covers the rounding of
# coordinates, because `in_squares` removes digits that coordinates in metres do not have.
TOLERANCE = 1e-9


def in_squares(
    metres: Float[np.ndarray, "*points 2"],
    corner: tuple[float, float] | Float[np.ndarray, "2"],
    cell: float,
) -> Float[np.ndarray, "*points 2"]:
    """Convert coordinates of a map to squares from a corner, and round them to their precision.

    Coordinates far from the origin, such as those of UTM, have few digits after the point: two
    points that are meant to be equal may differ by more than `TOLERANCE`.
    """
    precision = 4 * np.spacing(np.abs(metres).max(initial=cell)) / cell
    digits = math.floor(-math.log10(precision))
    return np.round((metres - np.asarray(corner)) / cell, digits)


def blocked_rings(
    blocked: Bool[np.ndarray, "rows columns"],
) -> tuple[Int[np.ndarray, "corners 2"], Int[np.ndarray, "_"]]:
    """Divide the blocked squares of a grid into simple polygons that do not overlap.

    A polygon has no holes, so it cannot surround free squares. The squares are therefore divided as
    in a boustrophedon decomposition: a run of blocked squares in a row continues the polygon of the
    run below it only if neither of the two overlaps a third run in these rows. A wall around a room
    becomes four polygons.

    **Returns:** the vertices of all polygons, counter-clockwise and in units of squares; and the
    indices of the first vertices of all polygons but the first, as `np.split` takes them.
    """
    columns = blocked.shape[1]
    steps = np.diff(np.pad(blocked, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    row, left = np.nonzero(steps == 1)
    right = np.nonzero(steps == -1)[1]

    # Runs are sorted by row and column, so the runs of another row that overlap a run have
    # consecutive keys.
    stride = columns + 1
    left_key, right_key = row * stride + left, row * stride + right
    first_above = np.searchsorted(right_key, left_key + stride, side="right")
    above = np.searchsorted(left_key, right_key + stride, side="left") - first_above
    first_below = np.searchsorted(right_key, left_key - stride, side="right")
    below = np.searchsorted(left_key, right_key - stride, side="left") - first_below

    follows = below == 1
    follows[follows] = above[first_below[follows]] == 1
    head = np.where(follows, first_below, np.arange(row.size))
    while (head[head] != head).any():
        head = head[head]
    # Both ends of the right side of each run, going up, then those of the left side, going down.
    height = 2 * row + np.array([[0], [1], [0], [1]])
    side = np.array([[1], [1], [-1], [-1]])
    order = np.lexsort(((side * height).ravel(), np.repeat(-side, row.size), np.tile(head, 4)))
    corners = np.stack([np.where(side > 0, right, left), (height + 1) // 2], axis=2)
    corners, ring = corners.reshape(-1, 2)[order], np.tile(head, 4)[order]
    # Where a side continues straight, the ends of its runs are equal.
    straight = np.zeros(ring.size, bool)
    straight[:-1] = (ring[1:] == ring[:-1]) & (corners[1:] == corners[:-1]).all(axis=1)
    bend = ~(straight | np.roll(straight, 1))
    return corners[bend], np.unique(ring[bend], return_index=True)[1][1:]


def rasterise(
    environment: shapely.Geometry, bounds: tuple[float, float, float, float], cell: float
) -> Bool[np.ndarray, "rows columns"]:
    """Make the occupancy grid of a polygonal environment.

    The environment is a polygon, or several polygons that do not overlap, in metres. Squares begin
    at the lower left corner of `bounds` (xmin, ymin, xmax, ymax), and the last squares may extend
    beyond the other sides. A square is blocked if its centre is farther than 10^-9 of a square from
    the environment. Row 0 is at the bottom.

    **Raises:** `ValueError` for more than 2^30 squares; `MemoryError` if the grid and the arrays of
    a [`jaxcell.space.CellSpace`][] do not fit in the free memory.
    """
    xmin, ymin, xmax, ymax = bounds
    # A width of 0.3 holds three squares of 0.1, although 0.3 / 0.1 may round to more than 3.
    width, height = (xmax - xmin) / cell - 1e-9, (ymax - ymin) / cell - 1e-9
    # For a cell close to 0 they are infinite, and have no ceiling.
    if max(width, 1.0) * max(height, 1.0) > MOST_SQUARES:
        raise ValueError(
            f"cell: squares of {cell:g} m make a grid of {width:.0f} x {height:.0f}, "
            f"more than the {MOST_SQUARES} squares of the largest grid"
        )
    check(
        cutting_bytes(width * height, environment.area / cell / cell),
        f"cell: a grid of {width:.0f} x {height:.0f} squares of {cell:g} m",
        "expected a larger cell",
    )
    columns, rows = math.ceil(width), math.ceil(height)
    local = shapely.transform(environment, lambda points: in_squares(points, (xmin, ymin), cell))
    # The number of free intervals around each centre, on a line just below it and one just above.
    # So a centre that lies on a wall is free, whatever the rounding.
    around = np.zeros((rows, columns + 1), np.int8)
    for shift in (-TOLERANCE, TOLERANCE):
        row, x = _crossings(local, rows, shift)
        for side, step, margin in ((0, 1, -TOLERANCE), (1, -1, TOLERANCE)):
            column = np.ceil(x[side::2] + margin).astype(int)
            np.add.at(around, (row[side::2], np.clip(column, 0, columns)), step)
    np.add.accumulate(around, axis=1, out=around)
    free = around[:, :columns] > 0
    # Neither line may meet a wedge whose tip is a centre.
    tips = shapely.get_coordinates(local) - 0.5
    square = np.rint(tips)
    at = (np.abs(tips - square) <= TOLERANCE) & (square >= 0) & (square < (columns, rows))
    column, row = square[at.all(axis=1)].astype(int).T
    free[row, column] = True
    return ~free


def _crossings(
    environment: shapely.Geometry, rows: int, shift: float
) -> tuple[Int[np.ndarray, "crossings"], Float[np.ndarray, "crossings"]]:
    """Find the points where walls cross the lines that are `shift` above the middles of rows.

    **Returns:** the row and the column of each point, sorted. The unit is a square, and the column
    of a centre is a whole number.
    """
    points, ring = shapely.get_coordinates(
        shapely.get_rings(shapely.get_parts(environment)), return_index=True
    )
    # The origin is the centre of the lower left square, on its line.
    points = points - (0.5, 0.5 + shift)
    same = ring[1:] == ring[:-1]
    (xa, ya), (xb, yb) = points[:-1][same].T, points[1:][same].T
    low, high = (np.clip(np.ceil(f(ya, yb)), 0, rows).astype(int) for f in (np.minimum, np.maximum))
    wall, number = copies(high - low)
    row = low[wall] + number
    x = xa[wall] + (row - ya[wall]) * ((xb - xa)[wall] / (yb - ya)[wall])
    order = np.lexsort((x, row))
    return row[order], x[order]


def cutting_bytes(squares: float, positions: float | int) -> float:
    """Estimate the bytes of a grid and its positions while a cell space is created."""
    return 6 * squares + 16 * positions
