"""Rows of chains of noisy maps as windows of cells, computed and applied in one program of JAX."""

import functools
import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ...space.box import Box
from ...space.cells import TOLERANCE
from ..maps import Map


# Standard deviations at which the noise is cut, as in a chain.
_CUT = 8.0
# Widths of windows are multiples of it, so that few programs are compiled.
_STEP = 4
# Number of probabilities of windows that are computed at once.
_PART = 1 << 17
# Probability of leaving the box that is rounding, as in `leaving_rows` of chains.
_LEAST = 1e-12


def widths(
    map: Map,
    box: Box,
    params: Any,
    noise: Any,
    points: Float[Any, "cells samples axes"],
) -> tuple[int, ...]:
    """Find the numbers of cells along each axis that the windows of all rows need."""
    found = np.asarray(_reach(map, box, params, noise, points))
    each = np.ceil((found + 2) / _STEP) * _STEP
    # Windows along a periodic axis may be longer than it.
    most = np.where(np.array(box.axes) == "periodic", np.inf, box.cells)
    return tuple(np.minimum(each, most).astype(int).tolist())


@functools.partial(jax.jit, static_argnames=("map", "box"))
def _reach(map: Map, box: Box, params: Any, noise: Any, points: Any) -> Any:
    def reach(points: Any) -> Any:
        place, _ = _places(map, box, params, points)
        return jnp.ptp(place, axis=0)

    return jax.vmap(reach)(points).max(axis=0) + 2 * _CUT * noise / box.width


def _places(map: Map, box: Box, params: Any, points: Any) -> tuple[Any, Any]:
    """Map the points of a cell; return the images in units of cells, and which are finite."""
    image = jax.vmap(lambda x: jnp.asarray(map(x, params)))(points)
    finite = jnp.isfinite(image).all(axis=1)
    wrapped = box.wrapped(jnp.where(finite[:, None], image, 0.0))
    return (wrapped - jnp.asarray(box.lower)[None]) / box.width[None], finite


def _row(
    map: Map, box: Box, wide: tuple[int, ...], params: Any, noise: Any, points: Any
) -> tuple[Any, Any, tuple[Int[Array, "width"], ...]]:
    """Compute the probabilities of the cells in a window, and of leaving, and list the cells."""
    place, finite = _places(map, box, params, points)
    value, cells = finite[:, None].astype(float) / len(points), []
    for axis, (count, kind, width) in enumerate(zip(box.cells, box.axes, wide, strict=True)):
        scale = noise[axis] / box.width[axis]
        first = jnp.floor(jax.lax.stop_gradient(place[:, axis].min() - _CUT * scale) + TOLERANCE)
        if kind != "periodic":
            first = jnp.clip(first, 0, count - width)
        face = (first + jnp.arange(width + 1.0)[None] - place[:, axis, None]) / scale
        low, high = face[:, 0], face[:, -1]
        sink = kind == "sink"
        face = face.at[:, 0].set(jnp.where(sink & (first == 0), low, -jnp.inf))
        face = face.at[:, -1].set(jnp.where(sink & (first + width == count), high, jnp.inf))
        along = _between(face)
        cells.append((first.astype(int) + jnp.arange(width)) % count)
        if axis + 1 < box.dimensions:
            value = (value[:, :, None] * along[:, None]).reshape(len(points), -1)
        else:
            value = value.T @ along
    leaving = 1 - value.sum()
    return value.reshape(wide), jnp.where(leaving > _LEAST, leaving, 0.0), tuple(cells)


def _between(face: Float[Array, "points faces"]) -> Float[Array, "points cells"]:
    """Compute the probabilities of a normal variable between faces, with all digits."""
    # The tail beyond each face, on the side of the face where it is the smaller one.
    tail = jax.lax.erfc(jnp.abs(face) * math.sqrt(0.5)) / 2
    low, high = face[:, :-1], face[:, 1:]
    below, beyond = tail[:, :-1], tail[:, 1:]
    same = jnp.where(low > 0, below - beyond, beyond - below)
    return jnp.where((low <= 0) & (high > 0), 1 - below - beyond, same)


@functools.partial(jax.jit, static_argnames=("map", "box", "wide"))
def matrix(
    map: Map, box: Box, wide: tuple[int, ...], params: Any, noise: Any, points: Any
) -> tuple[Float[Array, "cells cells"], Float[Array, "cells"]]:
    """Compute the transition matrix, and the probability of leaving the box from each cell."""

    def row(points: Any) -> Any:
        value, leaving, cells = _row(map, box, wide, params, noise, points)
        whole = jnp.zeros(box.cells).at[jnp.ix_(*cells)].add(value)
        return whole.ravel(), leaving

    return jax.lax.map(row, points, batch_size=_batch(wide))


@functools.partial(jax.jit, static_argnames=("map", "box", "wide"))
def changes(
    map: Map,
    box: Box,
    wide: tuple[int, ...],
    params: Any,
    slope: Any,
    noise: Any,
    points: Any,
    rest: Float[Array, "cells"],
    time: Float[Array, "cells"],
    visits: Float[Array, "cells"],
) -> tuple[Float[Array, "cells"], Float[Array, "cells"], Float[Array, "cells"]]:
    """Apply a chain that stops in some cells to times, and its adjoint to visits.

    **Arguments:** the map, as for `widths`; `slope`, the direction in which the parameters change;
    `rest`, the share of each cell in which the chain does not stop; mean times and visits.
    **Returns:** the expected change of the time in a step from each cell, its derivative along
    `slope`, and the visits after a step. Probabilities of a row sum to 1, so that the change is a
    sum of differences, with all its digits where times are nearly equal.
    """
    later = (rest * time).reshape(box.cells)
    count = min(_batch(wide), box.size)

    def one(points: Any, now: Any, visits: Any) -> Any:
        def moved(params: Any) -> Any:
            value, leaving, cells = _row(map, box, wide, params, noise, points)
            ahead = later[jnp.ix_(*cells)] - now
            return jnp.sum(value * ahead) - leaving * now, (value, cells)

        change, by, (value, cells) = jax.jvp(moved, (params,), (slope,), has_aux=True)
        return change, by, visits * value, cells

    def part(after: Any, rows: Any) -> Any:
        change, by, value, cells = jax.vmap(one)(*rows)
        index = [
            one.reshape(len(one), *[1] * axis, -1, *[1] * (len(wide) - axis - 1))
            for axis, one in enumerate(cells)
        ]
        return after.at[tuple(index)].add(value), (change, by)

    filled = -(-box.size // count) * count
    rows = jax.tree.map(
        lambda each: jnp.concatenate([each, each[: filled - box.size]]).reshape(
            -1, count, *each.shape[1:]
        ),
        (points, time, visits),
    )
    known = (jnp.arange(filled) < box.size).reshape(-1, count)
    rows = rows[0], rows[1], jnp.where(known, rows[2], 0.0)
    after, found = jax.lax.scan(part, jnp.zeros(box.cells), rows)
    change, by = (each.ravel()[: box.size] for each in found)
    return change, by, rest * after.ravel()


def _batch(wide: tuple[int, ...]) -> int:
    return max(1, _PART // math.prod(wide))
