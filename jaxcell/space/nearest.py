import functools
from typing import Any

import numpy as np
from jaxtyping import Int

from .cells import CellSpace


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
    rows, columns = cells.free.shape
    row, column = (
        np.clip(np.floor(np.round((v - low) / cells.cell, 9)), 0, n - 1).astype(np.int64)
        for v, low, n in zip((y, x), cells.origin[::-1], (rows, columns), strict=True)
    )
    position = _nearest_positions(cells)[row, column]
    turn = 2 * np.pi / cells.directions
    direction = np.floor(np.round(theta / turn + 0.5, 9)).astype(np.int64) % cells.directions
    return np.asarray(direction * cells.positions + position, np.int32)


@functools.lru_cache(maxsize=8)
def _nearest_positions(cells: CellSpace) -> Int[np.ndarray, "rows columns"]:
    # A robot that only carries a filter does not have SciPy.
    from scipy import ndimage

    row, column = ndimage.distance_transform_edt(
        ~cells.free, return_distances=False, return_indices=True
    )
    return cells.position_of_square[row, column]
