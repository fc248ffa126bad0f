"""Attractors found from orbits: orbits that visit the same part of a cell are on one attractor."""

import itertools

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ..space.box import Box


# Least number of orbits on each of two attractors that are separated within half a cell.
_MIN_APART = 8


def merged(
    box: Box, orbit: Float[np.ndarray, "starts window axes"], follow: int
) -> Int[np.ndarray, "starts"]:
    """Return a number for the attractor of each orbit, or -1 if the orbit leaves the box."""
    last = box.index(orbit[:, -1 - follow :])
    stays = np.flatnonzero((last < box.size).any(axis=1))
    place = (orbit[stays] - np.array(box.lower)) / box.width
    label = _linked(box, place, 2)
    # Attractors within half a cell separate at a quarter of it, if enough orbits can decide this.
    # Orbits on one large attractor are still linked.
    for k in np.flatnonzero(np.bincount(label) >= 2 * _MIN_APART):
        own = np.flatnonzero(label == k)
        finer = _linked(box, place[own], 4)
        size = np.bincount(finer)
        apart = np.flatnonzero(size >= max(_MIN_APART, own.size / 5))
        if apart.size > 1 and size[apart].sum() >= 0.9 * own.size:
            finer = np.where(np.isin(finer, apart), finer, size.argmax())
            label[own] = label.max() + 1 + finer
    _, first, label = np.unique(label, return_index=True, return_inverse=True)
    attractor = np.full(orbit.shape[0], -1)
    attractor[stays] = np.argsort(np.argsort(first))[label]
    return attractor


def _linked(
    box: Box, place: Float[np.ndarray, "orbits window axes"], parts: int
) -> Int[np.ndarray, "orbits"]:
    """Label orbits so that those that visit the same part of a cell have the same label.

    Parts are `1 / parts` of a cell wide and overlap by half; `place` is in units of cells.
    """
    orbits = len(place)
    bits = orbits.bit_length()
    orbit, halves = _visited(box, place, parts)
    along = []
    for half, cells, kind in zip(halves, box.cells, box.axes, strict=True):
        both = half >> 1, (half + 1) >> 1
        if kind == "periodic":
            both = both[0], both[1] % (parts * cells)
        along.append([place_on_axis + 1 for place_on_axis in both])
    label = np.arange(orbits)
    for corner in itertools.product(*along):
        key = np.zeros(orbit.size, np.int64)
        for digit, cells in zip(corner, box.cells, strict=True):
            key = key * (parts * cells + 3) + digit
        # Sorting by cells makes orbits in one cell neighbours.
        key = np.sort((key << bits) + label[orbit])
        between = key[1:] ^ key[:-1]
        two = np.flatnonzero((between > 0) & (between < 1 << bits))
        ends = key[two] & ((1 << bits) - 1), key[two + 1] & ((1 << bits) - 1)
        meets = coo_array((np.ones(two.size, np.int8), ends), shape=(orbits, orbits))
        label = connected_components(meets, directed=False)[1][label]
    return np.unique(label, return_inverse=True)[1]


def _visited(
    box: Box, place: Float[np.ndarray, "orbits window axes"], parts: int
) -> tuple[Int[np.ndarray, "visits"], list[Int[np.ndarray, "visits"]]]:
    """List visits to halves of parts (see `_linked`): orbits, and the halves' indices per axis."""
    halves = []
    new = np.zeros(place.shape[:2], bool)
    new[:, 0] = True
    for axis, (cells, kind) in enumerate(zip(box.cells, box.axes, strict=True)):
        count, half = 2 * parts * cells, np.floor(2 * parts * place[..., axis])
        half[~np.isfinite(half)] = -2
        if kind == "periodic":
            half -= count * np.floor(half / count)
        halves.append(np.clip(half, -2, count + 2).astype(np.int32))
        new[:, 1:] |= halves[-1][:, 1:] != halves[-1][:, :-1]
    return np.nonzero(new)[0], [half[new] for half in halves]
