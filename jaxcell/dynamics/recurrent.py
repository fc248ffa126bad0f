"""Reachable cells, by images of several points of each cell."""

import functools
import itertools
from typing import Any

import jax
import numpy as np
from jaxtyping import Int

from ..space.box import Box
from .batches import with_last
from .imaging import check_begin, check_map
from .maps import Map


# Number of cells whose points are mapped at once; smaller fronts are padded to it.
_PART = 1 << 8


def unstable_set(
    map: Map, box: Box, start: Any, params: Any = None, *, samples: int = 7
) -> Int[np.ndarray, "reached"]:
    """Find the cells that a map reaches from given points, by a grid of points of each cell.

    From equilibria it is a cover of their unstable manifolds (Dellnitz & Hohmann 1996), and so of
    the attractor that contains them.

    **Arguments:**

    - `map`, `box`, `params`: as in [`jaxcell.dynamics.images`][].
    - `start`: the starting points, array `[points, axes]`.
    - `samples`: number of points along each axis of a cell, from face to face, at least 2.

    **Returns:** the cells in ascending order, including those of the start.

    A map that doubles its point:

        >>> from jaxcell import dynamics, space
        >>> box = space.Box([0], [8], cells=[8])
        >>> dynamics.unstable_set(lambda x, p: 2 * x, box, [[2.5]]).tolist()
        [2, 4, 5, 6]
    """
    check_map(map, box, params)
    check_begin(map, box, params)
    place = np.linspace(-0.5, 0.5, samples)
    offsets = np.array(list(itertools.product(place, repeat=box.dimensions)))
    reached = np.zeros(box.size, bool)
    new = np.unique(box.index(np.asarray(start, float)))
    new = new[new < box.size]
    while new.size:
        reached[new] = True
        image = np.unique(_mapped(map, box, params, new, offsets))
        image = image[image < box.size]
        new = image[~reached[image]]
    return np.flatnonzero(reached)


def _mapped(
    map: Map, box: Box, params: Any, cells: np.ndarray, offsets: np.ndarray
) -> Int[np.ndarray, "cells points"]:
    """Compute the cells of the images of points of cells, 256 cells at a time."""
    images = []
    for k in range(0, cells.size, _PART):
        part = with_last(cells[k : k + _PART], _PART)
        images.append(np.asarray(_of_part(map, box, params, part, offsets * box.width)))
    return np.concatenate(images)[: cells.size]


@functools.partial(jax.jit, static_argnames=("map", "box"))
def _of_part(map: Map, box: Box, params: Any, cells: Any, offsets: Any) -> Any:
    points = box.centre(cells)[:, None] + offsets[None]
    return box.index(jax.vmap(jax.vmap(lambda x: map(x, params)))(points))
