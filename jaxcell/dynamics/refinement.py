"""Finer cells where they are wanted: at boundaries of basins, and on attractors."""

import functools
import itertools
from collections.abc import Iterator
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from ..space.box import Box
from ..space.cells import TOLERANCE
from .basin import Basins
from .batches import with_last
from .imaging import CHUNK, check_begin, check_map
from .maps import Map
from .orbits import VISITS, attractor_owners, orbit_ends


# Points that are followed for what is not cut, of each level; so many cells have as many around.
_SAMPLED = 1 << 16
# Cells of a cover whose points are mapped at once; what the last lack of it is for nothing.
_PART = 1 << 12


class Refined(NamedTuple):
    """Basins whose cells at boundaries have been halved along each axis, again and again."""

    fraction: Float[np.ndarray, "attractors"]
    "The share of the box that leads to each attractor, by the finest cells and the points drawn."
    uncertain: Float[np.ndarray, "levels"]
    """The share of the box that cells at a boundary take, by level; the first is that of the
    basins. Where the boundary is fractal, what is not cut is sampled."""
    exponent: float
    "The slope of its logarithm over that of the length of cells; 1 for smooth boundaries."
    boundary: Float[np.ndarray, "cells axes"]
    "Centres of the finest cells that are at a boundary."
    basin: Int[np.ndarray, "cells"]
    "The attractor that each of them leads to, -1 for none."
    mapped: int
    "Finer cells that were followed."


def refined(map: Map, found: Basins, levels: int = 3) -> Refined:
    """Refine the boundaries of basins.

    A cell with another basin beside it is cut in two along each axis, and the centres of its parts
    are mapped until they come to a cell that has its own basin on all sides. Parts that have
    another basin beside them are cut again. A fractal boundary also passes between cells of one
    basin, which are not cut. So points of the finest level are drawn from all of the box and
    followed to their attractors: they correct the shares, and if any of them shows that a cell has
    other basins in it than those around, every point is followed so, and cells at a boundary that
    are not cut are counted among those drawn.

    **Arguments:**

    - `map`: the map that the basins are of.
    - `found`: the basins.
    - `levels`: how often cells are halved.

    **Returns:** [`Refined`][jaxcell.dynamics.Refined].

    Starts above 0.3 go up, the others down; cells of a quarter cannot say so:

        >>> import jax.numpy as jnp
        >>> from jaxcell import dynamics, space
        >>> def up_or_down(x, p):
        ...     return jnp.where(x > 0.3, 0.9, 0.1)
        >>> found = dynamics.basins(up_or_down, space.Box([0], [1], cells=[4]))
        >>> found.fraction.tolist(), dynamics.refined(up_or_down, found).fraction.round(2).tolist()
        ([0.75, 0.25], [0.7, 0.3])
    """
    box = found.box
    # By level, the cells that were followed in ascending order, and the basin of each.
    keys = [np.arange(box.size)]
    basins = [found.basin]
    edge = np.flatnonzero(_at_boundary(box, keys, basins))
    owner, visits = attractor_owners(box, found.attractor_cells), VISITS
    size = _SAMPLED // 3**box.dimensions, box.dimensions
    drawn = np.random.default_rng(0).uniform(0, box.cells, size)
    truth = _ends(map, found, owner, visits, box.lower + drawn * box.width)
    cell = _keys(box, drawn.astype(np.int64), 0)
    fractal = bool(((truth != found.basin[cell]) & ~np.isin(cell, edge)).any())
    if not fractal:
        sure = np.setdiff1d(keys[0], edge)
        owner[sure], visits = found.basin[sure], 1
    volume = np.bincount(found.basin + 1, minlength=found.attractors + 1).astype(float)
    uncertain = [edge.size / box.size]
    parts = 2**box.dimensions
    for level in range(1, levels + 1):
        new = _halved(box, keys[-1][edge], level)
        label = _ends(map, found, owner, visits, _centres(box, new, level))
        # What was said of the cells is taken back, and said of their parts.
        share = 0.5 ** (level * box.dimensions)
        volume -= share * parts * np.bincount(basins[-1][edge] + 1, minlength=volume.size)
        volume += share * np.bincount(label + 1, minlength=volume.size)
        keys.append(new)
        basins.append(label)
        edge = np.flatnonzero(_at_boundary(box, keys, basins))
        uncertain.append(edge.size * share / box.size)
    place = (drawn * 2**levels).astype(np.int64)
    for label, sign in ((truth, 1), (_basin_at(box, keys, basins, place), -1)):
        volume += sign * box.size * np.bincount(label + 1, minlength=volume.size) / len(drawn)
    for level in range(levels + 1 if fractal else 0):
        beside = np.concatenate([*_around(box, drawn * 2**level, level)])
        points = np.array(box.lower) + beside * (box.width / 2**level)
        label = _ends(map, found, owner, visits, points).reshape(-1, len(drawn))
        uncertain[level] = float(np.mean((label != truth).any(axis=0)))
    seen = np.flatnonzero(uncertain)
    slope = np.polyfit(seen, np.log2(np.array(uncertain)[seen]), 1)[0] if seen.size > 1 else np.nan
    return Refined(
        fraction=volume[1:] / box.size,
        uncertain=np.array(uncertain),
        exponent=-float(slope),
        boundary=_centres(box, keys[-1][edge], levels),
        basin=basins[-1][edge],
        mapped=sum(new.size for new in keys[1:]),
    )


def relative_attractor(
    map: Map, box: Box, params: Any = None, *, levels: int = 4, samples: int = 3
) -> Float[np.ndarray, "cells axes"]:
    """Cover what of a box has always been in it, by halving cells and dropping those not reached.

    Cells that no cell of the cover is mapped to are dropped, what is left is cut in two along each
    axis, and so on: the subdivision of Dellnitz & Hohmann 1997. The cover holds the attractors in
    the box, and the unstable sets that lead to them.

    **Arguments:**

    - `map`, `box`, `params`: as for [`jaxcell.dynamics.images`][].
    - `levels`: how often cells are halved.
    - `samples`: points along each axis of a cell that are mapped, from face to face, at least 2.

    **Returns:** the centres of the finest cells of the cover.

    Steps towards both ends of a well, from the middle:

        >>> from jaxcell import dynamics, space
        >>> box = space.Box([-2], [2], cells=[4])
        >>> cover = dynamics.relative_attractor(lambda x, p: x + (x - x**3) / 3, box, levels=2)
        >>> cover.ravel().tolist()
        [-0.875, -0.625, -0.375, -0.125, 0.125, 0.375, 0.625, 0.875, 1.125]
    """
    check_map(map, box, params)
    check_begin(map, box, params)
    place = np.linspace(-0.5, 0.5, samples)
    offsets = np.array(list(itertools.product(place, repeat=box.dimensions))) * box.width
    keys = np.arange(box.size)
    for level in range(levels + 1):
        keys = _halved(box, keys, level) if level else keys
        points = _centres(box, keys, level)[:, None] + offsets / 2**level
        hit = []
        for k in range(0, keys.size, _PART):
            part = with_last(points[k : k + _PART], _PART)
            hit.append(_keys_of(box, np.asarray(_image(map, params, part)), level))
        keys = np.intersect1d(keys, np.concatenate([keys[:0], *hit]))
    return _centres(box, keys, levels)


@functools.partial(jax.jit, static_argnames="map")
def _image(map: Map, params: Any, points: Any) -> Any:
    return jax.vmap(jax.vmap(lambda x: map(x, params)))(points)


def _keys_of(box: Box, points: Float[np.ndarray, "... axes"], level: int) -> np.ndarray:
    """The cells of a level that points are in, without those outside."""
    count = np.array(box.cells) << level
    place = np.floor((points - np.array(box.lower)) / box.width * 2**level + TOLERANCE)
    place = place.reshape(-1, box.dimensions)
    kinds = np.array(box.axes)
    place = np.where(kinds == "periodic", place % count, place)
    place = np.where(kinds == "clamp", np.clip(place, 0, count - 1), place)
    # What is not finite is not inside.
    inside = ((place >= 0) & (place < count)).all(axis=1)
    return np.unique(_keys(box, place[inside].astype(np.int64), level))


def _halved(box: Box, keys: Int[np.ndarray, "cells"], level: int) -> Int[np.ndarray, "parts"]:
    """The parts, of a level, of cells of the level before."""
    halves = np.array(list(itertools.product((0, 1), repeat=box.dimensions)))
    places = 2 * _places(box, keys, level - 1)[:, None] + halves
    return np.sort(_keys(box, places.reshape(-1, box.dimensions), level))


def _places(box: Box, keys: Int[np.ndarray, "cells"], level: int) -> Int[np.ndarray, "cells axes"]:
    """The coordinates of cells of a level, which a 32-bit box may not number."""
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
    """Which cells of the finest level have another basin beside them, or at a corner."""
    level = len(keys) - 1
    differs = np.zeros(keys[-1].size, bool)
    for beside in _around(box, _places(box, keys[-1], level) + 0.5, level):
        differs |= _basin_at(box, keys, basins, beside.astype(np.int64)) != basins[-1]
    return differs


def _around(
    box: Box, places: Float[np.ndarray, "points axes"], level: int
) -> Iterator[Float[np.ndarray, "points axes"]]:
    """What is a cell of a level away from points, in each direction, and they themselves."""
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
    """The basin of cells of the finest level, of the cell that holds them if they were not cut."""
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
    found: Basins,
    owner: Int[np.ndarray, "_"],
    visits: int,
    points: Float[np.ndarray, "cells axes"],
) -> Int[np.ndarray, "cells"]:
    """The basins of points, by the cells of an owner that they come to."""
    parts = [
        orbit_ends(map, found.box, found.params, owner, points[k : k + CHUNK], visits=visits)[0]
        for k in range(0, len(points), CHUNK)
    ]
    return np.maximum(np.concatenate([np.empty(0, np.int32), *parts]), -1)
