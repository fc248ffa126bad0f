"""Reachable cells, found from images of several points of each cell."""

import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from ..base.indices import check_whole
from ..space.box import Box
from .batches import padded
from .imaging import check_begin, check_map, mapped_points
from .maps import Map


# Number of cells whose points are mapped at once; smaller fronts are padded to it.
_PART = 1 << 8


def grid_images(
    map: Map, params: Any, centres: np.ndarray, width: np.ndarray, samples: int, part: int
) -> Iterator[Float[np.ndarray, "part points axes"]]:
    """Map a grid of points in each cell, and yield arrays with the images of `part` cells.

    The grid has `samples` points along each axis of a cell, including both faces."""
    place = np.linspace(-0.5, 0.5, samples)
    offsets = np.array(list(itertools.product(place, repeat=width.size))) * width
    for k in range(0, len(centres), part):
        points = centres[k : k + part, None] + offsets
        yield padded(lambda points: mapped_points(map, params, points), [points], part)


def unstable_set(
    map: Map, box: Box, start: Any, params: Any = None, *, samples: int = 7
) -> Int[np.ndarray, "reached"]:
    """Find the cells that a map reaches from given points, with a grid of points in each cell.

    From equilibria, these cells cover the unstable manifolds (Dellnitz & Hohmann 1996), and so also
    an attractor that is the closure of these manifolds.

    **Arguments:** a map, a box, starting points `[points, axes]`, parameters, and the number of
    points of a cell along each axis, including both faces, at least 2. **Returns:** the cells in
    ascending order, including the cells of the starting points.

    A map that doubles its argument:

        >>> from jaxcell import dynamics, space
        >>> box = space.Box([0], [8], cells=[8])
        >>> dynamics.unstable_set(lambda x, p: 2 * x, box, [[2.5]]).tolist()
        [2, 4, 5, 6]
    """
    samples = check_whole("samples", samples, 2)
    check_map(map, box, params)
    check_begin(map, box, params)
    reached = np.zeros(box.size, bool)
    new = np.unique(box.index(np.asarray(start, float)))
    new = new[new < box.size]
    while new.size:
        reached[new] = True
        images = grid_images(map, params, box.centre(new), box.width, samples, _PART)
        image = np.unique(np.concatenate([box.index(points).ravel() for points in images]))
        image = image[image < box.size]
        new = image[~reached[image]]
    return np.flatnonzero(reached)
