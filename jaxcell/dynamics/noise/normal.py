"""Probabilities of the cells of a box after normal noise, from its distribution function."""

import functools
import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy.sparse import csr_array
from scipy.special import ndtr

from ...base.wide import traced
from ...space.box import Axis, Box
from ...space.cells import TOLERANCE


# Standard deviations beyond which the normal distribution function is 0 in 64 bits.
_NEVER = 40


def transition_rows(
    box: Box,
    image: Float[np.ndarray, "rows points axes"],
    deviation: Float[np.ndarray, "*points axes"],
    cut: float,
    correlation: float = 0.0,
) -> csr_array:
    """Compute the probabilities of all cells after normal noise is added to images of points.

    Each row is the mean over its points, which may have deviations of their own. Along an axis, the
    probability of a cell is the difference between the values of the distribution function at its
    two faces. Cells up to `cut` standard
    deviations from an image have a probability. The last of these cells also gets the probability
    of all points that are farther away, so that no mass is lost. Points outside the box, and images
    that are not finite, are missing from the row. The noise along two axes may have a correlation.
    """
    points, scale = image.shape[1], np.broadcast_to(deviation / box.width, image.shape)
    finite = np.isfinite(image).all(axis=2)
    weight = finite / points
    place = (box.wrapped(np.where(finite[..., None], image, 0.0)) - box.lower) / box.width
    far = np.where(np.array(box.axes) == "periodic", np.inf, 1 + _NEVER * scale)
    place = np.clip(place, -far, box.cells + far)
    # One window of cells is enough for the points of a row, if their images are near each other.
    near = (np.ptp(place, axis=1) <= cut * scale.max(axis=1) + 1).all(axis=1)
    alone = np.flatnonzero(~near)
    parts = [
        (np.flatnonzero(near), place[near], weight[near], scale[near]),
        (
            np.repeat(alone, points),
            place[alone].reshape(-1, 1, box.dimensions),
            weight[alone].reshape(-1, 1),
            scale[alone].reshape(-1, 1, box.dimensions),
        ),
    ]
    listing = functools.partial(_correlated, correlation) if correlation else _entries
    entries = [listing(box, *part, cut) for part in parts if part[0].size]
    row, column, value = (np.concatenate(each) for each in zip(*entries, strict=True))
    kept = value > 0
    entry = value[kept], (row[kept], column[kept])
    return csr_array(entry, shape=(len(image), box.size))


def _entries(
    box: Box,
    row: Int[np.ndarray, "windows"],
    place: Float[np.ndarray, "windows points axes"],
    weight: Float[np.ndarray, "windows points"],
    scale: Float[np.ndarray, "windows points axes"],
    cut: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """List rows, columns and probabilities of the cells in one window for each of the rows."""
    value = weight.reshape(*place.shape[:2], 1)
    column = np.zeros((len(row), 1), np.int64)
    for axis, (count, kind) in enumerate(zip(box.cells, box.axes, strict=True)):
        first, along = _along(count, kind, place[..., axis], scale[..., axis], cut)
        index = (first[:, None] + np.arange(along.shape[-1])) % count
        column = (count * column[:, :, None] + index[:, None]).reshape(len(row), -1)
        if axis + 1 < box.dimensions:
            value = (value[..., None] * along[:, :, None]).reshape(*place.shape[:2], -1)
        else:
            value = value.swapaxes(1, 2) @ along
    return np.repeat(row, column.shape[1]), column.ravel(), value.ravel()


def nodes(correlation: float, scale: float) -> int:
    """Return the number of nodes in a cell of the first axis, for correlated noise.

    `scale` is the standard deviation along this axis, in cells. In 75 laws, the rule of Gauss and
    Legendre with this number had errors below 1e-14; a probability of 1e-30 had seven digits.
    """
    steep = abs(correlation) / math.sqrt(1 - correlation**2)
    return math.ceil(4 + 3 * max(1.0, steep) / scale) if correlation else 1


def _correlated(
    correlation: float,
    box: Box,
    row: Int[np.ndarray, "windows"],
    place: Float[np.ndarray, "windows points 2"],
    weight: Float[np.ndarray, "windows points"],
    scale: Float[np.ndarray, "windows points 2"],
    cut: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """List rows, columns and probabilities as `_entries`, for correlated noise along two axes.

    The noise along the second axis is normal, given that along the first one. So the probability of
    a cell is an integral over its first axis of differences of the distribution function.
    """
    (count, other), (kind, across) = box.cells, box.axes
    here, deviation = place[..., 0], scale[..., 0]
    # Points beyond a clamped side keep their distribution along the second axis.
    first, mass = _along(count, "periodic", here, deviation, cut)
    cell = first[:, None] + np.arange(mass.shape[-1])
    node, rule = np.polynomial.legendre.leggauss(nodes(correlation, float(deviation.min())))
    away = cell[:, None, :, None] + (node + 1) / 2 - here[..., None, None]
    z = away / deviation[..., None, None]
    # The sum over the nodes of a cell is its exact mass, however small.
    density = rule * np.exp(((z**2).min(axis=-1, keepdims=True) - z**2) / 2)
    share = (weight[..., None] * mass)[..., None] * density / density.sum(axis=-1, keepdims=True)
    kept = (cell >= 0) & (cell < count) | (kind != "sink")

    def by_cell(values: Any) -> Float[np.ndarray, "kept nodes"]:
        each = np.broadcast_to(values, z.shape).swapaxes(1, 2)[kept]
        return each.reshape(len(each), -1)

    mean = place[..., None, None, 1] + correlation * scale[..., None, None, 1] * z
    rest = math.sqrt(1 - correlation**2) * scale[..., None, None, 1]
    start, chance = _along(other, across, by_cell(mean), by_cell(rest), cut)
    value = by_cell(share)[:, None] @ chance
    index = cell % count if kind == "periodic" else np.clip(cell, 0, count - 1)
    column = other * index[kept][:, None] + (start[:, None] + np.arange(chance.shape[-1])) % other
    row = np.broadcast_to(row[:, None], cell.shape)[kept]
    return np.repeat(row, chance.shape[-1]), column.ravel(), value.ravel()


def _along(
    count: int,
    kind: Axis,
    place: Float[np.ndarray, "windows points"],
    scale: Float[np.ndarray, "windows points"],
    cut: float,
) -> tuple[Int[np.ndarray, "windows"], Float[np.ndarray, "windows points width"]]:
    """Compute the first cell of windows along one axis, and the probabilities of their cells.

    `place` and the standard deviations `scale` are in units of cells.
    """
    ends = (place - cut * scale).min(axis=1), (place + cut * scale).max(axis=1)
    first, last = (np.floor(end + TOLERANCE).astype(np.int64) for end in ends)
    width = int((last - first).max()) + 1
    if kind != "periodic":
        width = min(width, count)
        first = np.clip(first, 0, count - width)
    face = (first[:, None] + np.arange(width + 1.0))[:, None] - place[..., None]
    leaves = kind == "sink"
    face[~(leaves & (first == 0)), :, 0] = -np.inf
    face[~(leaves & (first + width == count)), :, -1] = np.inf
    still = (scale == 0)[..., None]
    sure = np.where(face > TOLERANCE, np.inf, -np.inf)
    face = np.where(still, sure, face / np.where(still, 1.0, scale[..., None]))
    return first, _between(face[..., :-1], face[..., 1:])


def _between(low: Any, high: Any) -> Any:
    """Compute the probability that a normal variable is between two numbers, with all digits."""
    xp = low.__array_namespace__()
    # Differences in the upper tail would lose all digits: they are taken in the lower one.
    above = low > 0
    low, high = xp.where(above, -high, low), xp.where(above, -low, high)
    below = ndtr if xp is np else jax.scipy.special.ndtr
    return below(high) - below(low)


def all_probabilities(
    box: Box, image: Float[Array, "points axes"], noise: tuple[Any, ...]
) -> Float[Array, "cells"]:
    """Compute the mean over points of the probabilities of all cells after noise, in JAX.

    The results are those of [`transition_rows`][] without a cut. They have derivatives by the
    images and by `noise`, a standard deviation, or one per point, for each axis, where it is not
    the number 0.
    """
    finite = jnp.isfinite(image).all(axis=1, keepdims=True)
    place = box.wrapped(jnp.where(finite, image, 0.0))
    value = finite.astype(float) / len(image)
    for axis, deviation in enumerate(noise):
        chance = _along_all(box, axis, place[:, axis], deviation)
        if axis + 1 < box.dimensions:
            value = (value[:, :, None] * chance[:, None]).reshape(len(image), -1)
        else:
            value = value.T @ chance
    return value.ravel()


def _along_all(
    box: Box, axis: int, place: Float[Array, "points"], noise: Any
) -> Float[Array, "points cells"]:
    count, kind, width = box.cells[axis], box.axes[axis], float(box.width[axis])
    still = not traced(noise) and not np.any(noise)
    turns = 0
    if kind == "periodic":
        if traced(noise):
            raise ValueError("noise: along a periodic axis expected a number, got a traced array")
        turns = math.ceil(_NEVER * float(np.max(noise)) / width / count)
    faces = np.arange(-turns * count, (turns + 1) * count + 1.0)
    face = faces[None] - ((place - box.lower[axis]) / width)[:, None]
    at = (
        jnp.where(face > TOLERANCE, _NEVER, -_NEVER)
        if still
        else face * width / jnp.reshape(noise, (-1, 1))
    )
    # Far out the distribution function is constant, and has no infinite derivatives.
    at = jnp.clip(at, -_NEVER, _NEVER).astype(float)
    if kind != "sink":
        at = at.at[:, 0].set(-_NEVER).at[:, -1].set(_NEVER)
    return _between(at[:, :-1], at[:, 1:]).reshape(len(place), -1, count).sum(axis=1)


def distributed_rows(
    box: Box, image: Float[np.ndarray, "rows points axes"], below: Callable[[Any, Any], Any]
) -> csr_array:
    """Compute the probabilities of all cells for points that are distributed around images.

    `below(faces, images)` is the distribution function along each axis, of arrays `[..., axes]`.
    """
    finite = np.isfinite(image).all(axis=2, keepdims=True)
    place = np.where(finite, image, 0.0)
    value = finite.astype(float) / image.shape[1]
    faces = box.lower + np.arange(max(box.cells) + 1)[:, None] * box.width
    each = np.asarray(below(*np.broadcast_arrays(faces, place[:, :, None])))
    for axis, (count, kind) in enumerate(zip(box.cells, box.axes, strict=True)):
        along = each[:, :, : count + 1, axis].copy()
        if kind != "sink":
            along[..., 0], along[..., -1] = 0.0, 1.0
        chance = np.maximum(np.diff(along), 0)
        value = (value[..., None] * chance[:, :, None]).reshape(*image.shape[:2], -1)
    return csr_array(value.sum(axis=1))
