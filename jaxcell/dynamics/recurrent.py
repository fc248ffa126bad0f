"""Reachable and recurrent cells, by images of several points of each cell."""

import functools
import itertools
from collections.abc import Sequence
from typing import Any, Literal

import jax
import numpy as np
from jaxtyping import Int
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

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


def morse_sets(
    map: Map,
    box: Box,
    params: Any = None,
    *,
    points: Literal["corners", "centre"] | int = "corners",
    padding: int = 0,
    closed: bool = True,
) -> tuple[Sequence[Int[np.ndarray, "cells"]], csr_array]:
    """Find the recurrent components of a multivalued map of cells, and which lead to which.

    The image of a cell is the smallest block of cells around the images of its points, with
    `padding` more cells on all sides. A Morse set is a maximal set of cells that all lead to each
    other.

    **Arguments:**

    - `map`, `box`, `params`: as in [`jaxcell.dynamics.images`][].
    - `points`: `"corners"` or `"centre"` of a cell, or the number of points along each axis.
    - `padding`: number of cells that are added on each side of an image.
    - `closed`: whether an image that ends on a face includes the cells on both sides of it.

    **Returns:** the cells of each Morse set, and a Boolean matrix: entry `i, j` is true if `i`
    leads to `j`.

    A saddle in the middle leads to both ends:

        >>> from jaxcell import dynamics, space
        >>> box = space.Box([0], [1], cells=[7], axes="clamp")
        >>> sets, leads = dynamics.morse_sets(lambda x, p: 4 * x - 1.5, box, points=3)
        >>> [cells.tolist() for cells in sets], leads.toarray().tolist()
        ([[0], [6], [3]], [[False, False, False], [False, False, False], [True, True, False]])
    """
    check_map(map, box, params)
    check_begin(map, box, params)
    count = points if isinstance(points, int) else {"corners": 2, "centre": 1}[points]
    place = np.linspace(-0.5, 0.5, count) if count > 1 else np.zeros(1)
    offsets = np.array(list(itertools.product(place, repeat=box.dimensions)))
    cells = np.arange(box.size, dtype=np.int32)
    low, high = _blocks(map, box, params, cells, offsets, 1e-9 if closed else -1e-9)
    low, high = low - padding, high + padding
    source, image = [], []
    size = high - low + 1
    for step in itertools.product(*(range(int(n)) for n in size.max(axis=0))):
        at = low + np.array(step)
        used = (np.array(step) < size).all(axis=1)
        index = np.zeros(box.size, np.int64)
        for axis, (n, kind) in enumerate(zip(box.cells, box.axes, strict=True)):
            along = at[:, axis]
            if kind == "periodic":
                along = along % n
            elif kind == "clamp":
                along = np.clip(along, 0, n - 1)
            used &= (along >= 0) & (along < n)
            index = index * n + along
        source.append(cells[used])
        image.append(index[used])
    row, column = np.concatenate(source), np.concatenate(image)
    graph = csr_array((np.ones(row.size, np.int8), (row, column)), shape=(box.size,) * 2)
    _, label = connected_components(graph, directed=True, connection="strong")
    recurs = np.bincount(label, minlength=label.max() + 1) > 1
    recurs[label[row[row == column]]] = True
    names = np.cumsum(recurs) - 1
    inside = recurs[label]
    order = np.argsort(label[inside], kind="stable")
    cycles = np.flatnonzero(inside)[order]
    sets = np.split(cycles, np.flatnonzero(np.diff(label[cycles])) + 1) if cycles.size else []
    edges = csr_array(
        (np.ones(row.size, np.int32), (label[row], label[column])), shape=(recurs.size,) * 2
    )
    return sets, _reachable(edges, np.flatnonzero(recurs), names)


def _reachable(edges: csr_array, sets: np.ndarray, names: np.ndarray) -> csr_array:
    """Find which Morse sets lead to which, through components that do not recur."""
    leads = np.zeros((sets.size, sets.size), bool)
    indptr, indices = edges.indptr, edges.indices
    for name, component in enumerate(sets):
        seen = np.zeros(edges.shape[0], bool)
        front = np.array([component])
        while front.size:
            seen[front] = True
            after = np.unique(np.concatenate([indices[indptr[c] : indptr[c + 1]] for c in front]))
            front = after[~seen[after]]
        leads[name] = seen[sets]
        leads[name, name] = False
    return csr_array(leads)


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


def _blocks(
    map: Map, box: Box, params: Any, cells: np.ndarray, offsets: np.ndarray, edge: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the lowest and highest cell, on each axis, of the images of points of each cell."""
    points = box.centre(cells)[:, None] + offsets * box.width
    image = np.asarray(mapped_points(map, params, points))
    place = (image - np.array(box.lower)) / box.width
    low = np.ceil(place.min(axis=1) - edge) - 1 if edge > 0 else np.floor(place.min(axis=1) - edge)
    high = np.floor(place.max(axis=1) + edge)
    return low.astype(np.int64), np.maximum(high, low).astype(np.int64)
