"""Finer cells at boundaries of basins, and on attractors."""

import itertools
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from ...base.indices import check_whole
from ...space.box import Box
from ...space.cells import TOLERANCE
from ..basin import Basins
from ..batches import slices
from ..imaging import check_begin, check_map
from ..maps import Map
from ..orbits import VISITS, attractor_owners, orbit_ends
from ..recurrent import grid_images


# Number of points per level that sample cells without cuts, divided by those of a neighbourhood.
_SAMPLED = 1 << 16
# Number of cells of a cover whose points are mapped at once; the last ones are padded to it.
_PART = 1 << 12


class Refined(NamedTuple):
    """Basins whose cells at boundaries are repeatedly halved along each axis."""

    fraction: Float[np.ndarray, "attractors"]
    "Share of the box that leads to each attractor, from the finest cells and random points."
    uncertain: Float[np.ndarray, "levels"]
    """The share of the box in cells at a boundary, before refinement and after each halving of
    cells. It is estimated from random points if the boundary is fractal."""
    exponent: float
    "The slope of log `uncertain` over the log of the length of cells; 1 for smooth boundaries."
    boundary: Float[np.ndarray, "cells axes"]
    "Centres of the finest cells at a boundary."
    basin: Int[np.ndarray, "cells"]
    "The attractor to which each cell in `boundary` leads, or -1 if it leads to no attractor."
    mapped: int
    "Number of finer cells whose images were computed."


def refined(map: Map, basins: Basins, levels: int = 3) -> Refined:
    """Halve the cells at the boundaries of basins repeatedly.

    A cell next to a cell of another basin is halved along each axis. The centres of its parts are
    mapped until they reach a cell whose neighbours all belong to the same basin. Parts next to
    another basin are halved again. To correct the shares, random points of the whole box are
    followed to their attractors. The boundary counts as fractal if such a point leads to another
    attractor than its cell, although all neighbours of the cell belong to the same basin. In this
    case the centres of all parts are followed to their attractors, and the random points also
    estimate the share of cells at the boundary.

    **Arguments:** a map, its basins, and the number of times that cells are halved. **Returns:**
    [`Refined`][jaxcell.dynamics.boundary.refinement.Refined].

    Starts above 0.3 go up and other starts go down, which cells of length 0.25 cannot resolve:

        >>> import jax.numpy as jnp
        >>> from jaxcell import dynamics, space
        >>> def up_or_down(x, p):
        ...     return jnp.where(x > 0.3, 0.9, 0.1)
        >>> basins = dynamics.basins(up_or_down, space.Box([0], [1], cells=[4]))
        >>> finer = dynamics.refined(up_or_down, basins)
        >>> basins.fraction.tolist(), finer.fraction.round(2).tolist()
        ([0.75, 0.25], [0.7, 0.3])
    """
    levels, box = check_whole("levels", levels), basins.box
    # The followed cells of each level, in ascending order, and their labels.
    keys = [np.arange(box.size)]
    labels = [basins.basin]
    edge = np.flatnonzero(_at_boundary(box, keys, labels))
    owner, visits = attractor_owners(box, basins.attractor_cells), VISITS
    size = _SAMPLED // 3**box.dimensions, box.dimensions
    drawn = np.random.default_rng(0).uniform(0, box.cells, size)
    truth = _ends(map, basins, owner, visits, box.lower + drawn * box.width)
    cell = _keys(box, drawn.astype(np.int64), 0)
    fractal = bool(((truth != basins.basin[cell]) & ~np.isin(cell, edge)).any())
    if not fractal:
        sure = np.setdiff1d(keys[0], edge)
        owner[sure], visits = basins.basin[sure], 1
    volume = np.bincount(basins.basin + 1, minlength=basins.attractors + 1).astype(float)
    uncertain = [edge.size / box.size]
    parts = 2**box.dimensions
    for level in range(1, levels + 1):
        new = _halved(box, keys[-1][edge], level)
        label = _ends(map, basins, owner, visits, _centres(box, new, level))
        # The volume of the parts replaces the volume of their cells.
        share = 0.5 ** (level * box.dimensions)
        volume -= share * parts * np.bincount(labels[-1][edge] + 1, minlength=volume.size)
        volume += share * np.bincount(label + 1, minlength=volume.size)
        keys.append(new)
        labels.append(label)
        edge = np.flatnonzero(_at_boundary(box, keys, labels))
        uncertain.append(edge.size * share / box.size)
    place = (drawn * 2**levels).astype(np.int64)
    for label, sign in ((truth, 1), (_basin_at(box, keys, labels, place), -1)):
        volume += sign * box.size * np.bincount(label + 1, minlength=volume.size) / len(drawn)
    for level in range(levels + 1 if fractal else 0):
        beside = np.concatenate([*_around(box, drawn * 2**level, level)])
        points = np.array(box.lower) + beside * (box.width / 2**level)
        label = _ends(map, basins, owner, visits, points).reshape(-1, len(drawn))
        uncertain[level] = float(np.mean((label != truth).any(axis=0)))
    seen = np.flatnonzero(uncertain)
    slope = np.polyfit(seen, np.log2(np.array(uncertain)[seen]), 1)[0] if seen.size > 1 else np.nan
    return Refined(
        fraction=volume[1:] / box.size,
        uncertain=np.array(uncertain),
        exponent=-float(slope),
        boundary=_centres(box, keys[-1][edge], levels),
        basin=labels[-1][edge],
        mapped=sum(new.size for new in keys[1:]),
    )


def relative_attractor(
    map: Map, box: Box, params: Any = None, *, levels: int = 4, samples: int = 3
) -> Float[np.ndarray, "cells axes"]:
    """Cover the relative global attractor: the points with a past orbit that never left a box.

    Cells that contain no image of a point in the cover are dropped, the other cells are halved
    along each axis, and so on: the subdivision of Dellnitz & Hohmann 1997. The cover contains the
    attractors in the box, and the unstable sets that lead to them.

    **Arguments:** a map, a box and parameters. `levels` is the number of times that cells are
    halved. `samples`, at least 2, is the number of points of a cell along each axis, including both
    faces. **Returns:** the centres of the finest cells of the cover.

    A map whose steps lead from 0 towards the attractors -1 and 1:

        >>> from jaxcell import dynamics, space
        >>> box = space.Box([-2], [2], cells=[4])
        >>> cover = dynamics.relative_attractor(lambda x, p: x + (x - x**3) / 3, box, levels=2)
        >>> cover.ravel().tolist()
        [-0.875, -0.625, -0.375, -0.125, 0.125, 0.375, 0.625, 0.875, 1.125]
    """
    levels, samples = check_whole("levels", levels), check_whole("samples", samples, 2)
    check_map(map, box, params)
    check_begin(map, box, params)
    keys = np.arange(box.size)
    for level in range(levels + 1):
        keys = _halved(box, keys, level) if level else keys
        width, centres = box.width / 2**level, _centres(box, keys, level)
        images = grid_images(map, params, centres, width, samples, _PART)
        hit = [_keys_of(box, points, level) for points in images]
        keys = np.intersect1d(keys, np.concatenate([keys[:0], *hit]))
    return _centres(box, keys, levels)


def _keys_of(box: Box, points: Float[np.ndarray, "... axes"], level: int) -> np.ndarray:
    """Return the numbers of the cells that contain points of the box, after `level` halvings."""
    count = np.array(box.cells) << level
    place = np.floor((points - np.array(box.lower)) / box.width * 2**level + TOLERANCE)
    place = place.reshape(-1, box.dimensions)
    kinds = np.array(box.axes)
    place = np.where(kinds == "periodic", place % count, place)
    place = np.where(kinds == "clamp", np.clip(place, 0, count - 1), place)
    # Points that are not finite are not inside.
    inside = ((place >= 0) & (place < count)).all(axis=1)
    return np.unique(_keys(box, place[inside].astype(np.int64), level))


def _halved(box: Box, keys: Int[np.ndarray, "cells"], level: int) -> Int[np.ndarray, "parts"]:
    halves = np.array(list(itertools.product((0, 1), repeat=box.dimensions)))
    places = 2 * _places(box, keys, level - 1)[:, None] + halves
    return np.sort(_keys(box, places.reshape(-1, box.dimensions), level))


def _places(box: Box, keys: Int[np.ndarray, "cells"], level: int) -> Int[np.ndarray, "cells axes"]:
    return np.stack(np.unravel_index(keys, tuple(n << level for n in box.cells)), axis=-1)


def _keys(box: Box, places: Int[np.ndarray, "cells axes"], level: int) -> Int[np.ndarray, "cells"]:
    return np.ravel_multi_index(tuple(places.T), tuple(n << level for n in box.cells))


def _centres(
    box: Box, keys: Int[np.ndarray, "cells"], level: int
) -> Float[np.ndarray, "cells axes"]:
    return np.array(box.lower) + (_places(box, keys, level) + 0.5) * (box.width / 2**level)


def _at_boundary(
    box: Box, keys: list[Int[np.ndarray, "_"]], basins: list[Int[np.ndarray, "_"]]
) -> Bool[np.ndarray, "cells"]:
    """Return a mask over the finest cells, `keys[-1]`: `True` for cells next to another basin."""
    level = len(keys) - 1
    differs = np.zeros(keys[-1].size, bool)
    for beside in _around(box, _places(box, keys[-1], level) + 0.5, level):
        differs |= _basin_at(box, keys, basins, beside.astype(np.int64)) != basins[-1]
    return differs


def _around(
    box: Box, places: Float[np.ndarray, "points axes"], level: int
) -> Iterator[Float[np.ndarray, "points axes"]]:
    """Yield copies of points, shifted by -1, 0 or 1 cells of level `level` along each axis."""
    count = np.array(box.cells) << level
    periodic = np.array(box.axes) == "periodic"
    for step in itertools.product((-1, 0, 1), repeat=box.dimensions):
        beside = places + np.array(step)
        yield np.where(periodic, beside % count, np.clip(beside, 0, count * (1 - 1e-12)))


def _basin_at(
    box: Box,
    keys: list[Int[np.ndarray, "_"]],
    basins: list[Int[np.ndarray, "_"]],
    places: Int[np.ndarray, "cells axes"],
) -> Int[np.ndarray, "cells"]:
    """Return the basin at each place, from the finest cell around it; `keys` has cells by level."""
    finest = len(keys) - 1
    basin = basins[0][_keys(box, places >> finest, 0)]
    for level in range(1, finest + 1):
        if not keys[level].size:
            break
        wanted = _keys(box, places >> (finest - level), level)
        at = np.minimum(np.searchsorted(keys[level], wanted), keys[level].size - 1)
        basin = np.where(keys[level][at] == wanted, basins[level][at], basin)
    return basin


def _ends(
    map: Map,
    basins: Basins,
    owner: Int[np.ndarray, "_"],
    visits: int,
    points: Float[np.ndarray, "cells axes"],
) -> Int[np.ndarray, "cells"]:
    """Return the attractor that each point reaches, or -1; `orbit_ends` explains the arguments."""
    options = {"follow": basins.follow, "visits": visits}
    parts = [
        orbit_ends(map, basins.box, basins.params, owner, points[part], **options)[0]
        for part in slices(len(points))
    ]
    return np.maximum(np.concatenate([np.empty(0, np.int32), *parts]), -1)
