"""Reachable cells, by images of several points of each cell."""

import itertools
from typing import Any

import numpy as np
from jaxtyping import Int

from ..space.box import Box
from .batches import with_last
from .imaging import check_begin, check_map, mapped_points
from .maps import Map


# Number of cells whose points are mapped at once; smaller fronts are padded to it.
_PART = 1 << 8


def unstable_set(
    map: Map, box: Box, start: Any, params: Any = None, *, samples: int = 7
) -> Int[np.ndarray, "reached"]:
    """Find the cells that a map reaches from given points, by a grid of points of each cell.

    From equilibria, these cells cover their unstable manifolds (Dellnitz & Hohmann 1996), and so
    the attractor that contains them.

    **Arguments:** a map, a box, starting points `[points, axes]`, parameters, and the number of
    points of a cell along each axis, from face to face, at least 2. **Returns:** the cells in
    ascending order, including the cells of the starting points.

    A map that doubles its point:

        >>> from jaxcell import dynamics, space
        >>> box = space.Box([0], [8], cells=[8])
        >>> dynamics.unstable_set(lambda x, p: 2 * x, box, [[2.5]]).tolist()
        [2, 4, 5, 6]
    """
    check_map(map, box, params)
    check_begin(map, box, params)
    place = np.linspace(-0.5, 0.5, samples)
    offsets = np.array(list(itertools.product(place, repeat=box.dimensions))) * box.width
    reached = np.zeros(box.size, bool)
    new = np.unique(box.index(np.asarray(start, float)))
    new = new[new < box.size]
    while new.size:
        reached[new] = True
        images = []
        for k in range(0, new.size, _PART):
            points = box.centre(with_last(new[k : k + _PART], _PART))[:, None] + offsets
            images.append(box.index(np.asarray(mapped_points(map, params, points))).ravel())
        image = np.unique(np.concatenate(images))
        image = image[image < box.size]
        new = image[~reached[image]]
    return np.flatnonzero(reached)
