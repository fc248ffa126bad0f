"""Occupancy grids as polygons, and polygons as occupancy grids.

A grid is a Boolean array, true where a square is blocked, with row 0 at the bottom and column 0 at
the left; coordinates are in units of its squares.
"""

import itertools
import math

import numpy as np
import shapely
from jaxtyping import Bool, Int

from ..base.memory import check


MOST_SQUARES = 2**30


def blocked_rings(
    blocked: Bool[np.ndarray, "rows columns"],
) -> list[Int[np.ndarray, "_ 2"]]:
    """Cut the blocked squares of a grid into simple polygons that do not overlap.

    An obstacle is one ring and so cannot hold free squares inside it. The squares are therefore cut
    as in a boustrophedon decomposition: a run of blocked squares in a row continues the polygon of
    the run below it only where each of the two overlaps no other run of the other's row. A wall
    around a room becomes four polygons, and whatever is free inside stays free.

    **Arguments:**

    - `blocked`: true for blocked squares, row 0 at the bottom.

    **Returns:**

    The vertices of each polygon, counter-clockwise, in units of squares.
    """
    columns = blocked.shape[1]
    steps = np.diff(np.pad(blocked, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    row, left = np.nonzero(steps == 1)
    right = np.nonzero(steps == -1)[1]

    # Runs are sorted by row, then column, so in these keys the runs of another row that overlap
    # a run are consecutive.
    stride = columns + 1
    left_key, right_key = row * stride + left, row * stride + right
    first_above = np.searchsorted(right_key, left_key + stride, side="right")
    above = np.searchsorted(left_key, right_key + stride, side="left") - first_above
    first_below = np.searchsorted(right_key, left_key - stride, side="right")
    below = np.searchsorted(left_key, right_key - stride, side="left") - first_below

    follows = below == 1
    follows[follows] = above[first_below[follows]] == 1
    successor = np.full(row.size, -1)
    successor[first_below[follows]] = np.flatnonzero(follows)

    rings = []
    for head in np.flatnonzero(~follows).tolist():
        chain = [head]
        while (run := successor[chain[-1]]) >= 0:
            chain.append(run)
        rings.append(_outline(left[chain].tolist(), right[chain].tolist(), int(row[head])))
    return rings


def _outline(left: list[int], right: list[int], bottom: int) -> Int[np.ndarray, "_ 2"]:
    """The ring around runs stacked upwards from row `bottom`, without collinear vertices."""
    going_up, going_down = [(right[0], bottom)], [(left[0], bottom)]
    for side, ends in ((going_up, right), (going_down, left)):
        for height, (lower, upper) in enumerate(itertools.pairwise(ends), bottom + 1):
            if lower != upper:
                side += [(lower, height), (upper, height)]
        side.append((ends[-1], bottom + len(ends)))
    return np.array(going_up + going_down[::-1])


def rasterise(
    environment: shapely.Geometry,
    bounds: tuple[float, float, float, float],
    cell: float,
) -> Bool[np.ndarray, "rows columns"]:
    """The occupancy grid of a polygonal environment.

    **Arguments:**

    - `environment`: a polygon or several, in metres.
    - `bounds`: the box to cover (xmin, ymin, xmax, ymax), in metres; squares start at its lower
        left corner, and the last ones reach over its far sides if need be.
    - `cell`: side of the squares, in metres.

    **Returns:**

    True where the centre of a square does not lie in the closed environment; row 0 at the bottom.

    **Raises:**

    `ValueError` where the grid would have more than 2^30 squares; `MemoryError` where it would not
    fit the free memory with what a [`jaxcell.space.CellSpace`][] knows of it.
    """
    xmin, ymin, xmax, ymax = bounds
    # A width of 0.3 holds three squares of 0.1, although 0.3 / 0.1 may round to more than 3.
    width, height = (xmax - xmin) / cell - 1e-9, (ymax - ymin) / cell - 1e-9
    # Of a cell next to 0 they are infinite, and have no ceiling.
    if max(width, 1.0) * max(height, 1.0) > MOST_SQUARES:
        raise ValueError(
            f"cell: squares of {cell:g} m make a grid of {width:.0f} x {height:.0f}, "
            f"more than the {MOST_SQUARES} squares of the largest grid there can be"
        )
    check(
        cutting_bytes(width * height, environment.area / cell / cell),
        f"cell: a grid of {width:.0f} x {height:.0f} squares of {cell:g} m",
        "expected a larger cell",
    )
    columns, rows = math.ceil(width), math.ceil(height)
    x = xmin + (np.arange(columns) + 0.5) * cell
    y = ymin + (np.arange(rows) + 0.5) * cell
    shapely.prepare(environment)
    return np.stack([~shapely.intersects_xy(environment, x, level) for level in y])


def cutting_bytes(squares: float, positions: float | int) -> float:
    """The memory that a grid and its positions take while cells are cut, as measured."""
    return 6 * squares + 16 * positions
