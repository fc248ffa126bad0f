"""Rows of chains of noisy maps as windows of cells, computed and applied in one program of JAX."""

import dataclasses
import functools
import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...space.box import Box
from ...space.cells import TOLERANCE
from ..maps import Map


# Standard deviations at which the noise is cut, as in a chain.
_CUT = 8.0
# Widths of windows are multiples of it, so that few programs are compiled.
_STEP = 4
# Number of rows, one after the other, that share a window.
_BLOCK = 16
# Probability of leaving the box that is rounding, as in `leaving_rows` of chains.
_LEAST = 1e-12


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Windows:
    """A chain of a noisy map that stops in regions: blocks of rows share a window of cells.

    The probability of a cell is the product of those along the axes, so that a block is applied as
    a product of matrices. The box has one more cell beyond each clamped side, as `Ends.around`.
    """

    map: Map = dataclasses.field(metadata={"static": True})
    box: Box = dataclasses.field(metadata={"static": True})
    wide: tuple[int, ...] = dataclasses.field(metadata={"static": True})
    params: Any
    noise: Any
    points: Any
    "The points of each row `[blocks, rows, points, axes]`, where the last row may be repeated."
    rest: Any
    "The share of each cell of the box in which the chain goes on."
    row: Any
    "The row of each cell of the box in which the chain goes on."

    @classmethod
    def of(
        cls, map: Map, box: Box, params: Any, noise: Any, points: Any, rest: Any, row: Any
    ) -> "Windows":
        """Find the number of cells that the longest window needs along each axis.

        The points are those of each row `[rows, points, axes]`.
        """
        size = len(points)
        count = min(_BLOCK, size)
        points = points[np.minimum(np.arange(-(-size // count) * count), size - 1)]
        points = points.reshape(-1, count, *points.shape[1:])
        reach = np.asarray(_reach(map, box, params, points)) + 2 * _CUT * noise / box.width
        each = np.ceil((reach + 2) / _STEP) * _STEP
        # Windows along a periodic axis may be longer than it.
        most = np.where(np.array(box.axes) == "periodic", np.inf, box.cells)
        wide = tuple(np.minimum(each, most).astype(int).tolist())
        return cls(map, box, wide, params, noise, points, rest, row)


@functools.partial(jax.jit, static_argnames=("map", "box"))
def _reach(map: Map, box: Box, params: Any, points: Any) -> Any:
    each = jax.vmap(lambda points: jnp.ptp(_places(map, box, params, points)[0], axis=0))(points)
    return each.max(axis=0)


def _places(map: Map, box: Box, params: Any, points: Any) -> tuple[Any, Any]:
    """Map the points of a block; return the images in units of cells, and which are finite."""
    flat = points.reshape(-1, box.dimensions)
    image = jax.vmap(lambda x: jnp.asarray(map(x, params)))(flat)
    finite = jnp.isfinite(image).all(axis=1)
    wrapped = box.wrapped(jnp.where(finite[:, None], image, 0.0))
    return (wrapped - jnp.asarray(box.lower)[None]) / box.width[None], finite


def _block(windows: Windows, params: Any, points: Any) -> tuple[Any, Any, Any, tuple[Any, ...]]:
    """Compute the probabilities of the cells in the window of a block.

    **Returns:** for each point of each row, the probabilities along all axes but the last, times
    the weight of the point, and those along the last axis; the probability of leaving for each row;
    and the cells along each axis.
    """
    box, noise = windows.box, windows.noise
    place, finite = _places(windows.map, box, params, points)
    value, along = finite[:, None].astype(float) / points.shape[1], jnp.ones((len(place), 1))
    cells: list[Any] = []
    for axis, (count, kind, width) in enumerate(
        zip(box.cells, box.axes, windows.wide, strict=True)
    ):
        value = (value[:, :, None] * along[:, None]).reshape(len(place), -1)
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
    leaving = 1 - (value.sum(axis=1) * along.sum(axis=1)).reshape(points.shape[:2]).sum(axis=1)
    return value, along, jnp.where(leaving > _LEAST, leaving, 0.0), tuple(cells)


def _between(face: Float[Array, "points faces"]) -> Float[Array, "points cells"]:
    """Compute the probabilities of a normal variable between faces, with all digits."""
    # The tail beyond each face, on the side of the face where it is the smaller one.
    tail = jax.lax.erfc(jnp.abs(face) * math.sqrt(0.5)) / 2
    low, high = face[:, :-1], face[:, 1:]
    below, beyond = tail[:, :-1], tail[:, 1:]
    same = jnp.where(low > 0, below - beyond, beyond - below)
    return jnp.where((low <= 0) & (high > 0), 1 - below - beyond, same)


@jax.jit
def matrix(windows: Windows) -> Float[Array, "rows rows"]:
    """Compute the transition matrix between the cells in which the chain goes on.

    The rows include those that fill the last block.
    """

    def block(points: Any) -> Any:
        value, last, _, cells = _block(windows, windows.params, points)
        each = (part.reshape(*points.shape[:2], -1) for part in (value, last))
        inside = jnp.einsum("rpi,rpj->rij", *each).reshape(len(points), *windows.wide)
        whole = jnp.zeros((len(points), *windows.box.cells))
        whole = whole.at[:, *jnp.ix_(*cells)].add(inside).reshape(len(points), -1)
        return jax.vmap(lambda row: _folded(windows, row))(whole)

    found = jax.lax.map(block, windows.points)
    return found.reshape(-1, found.shape[-1])


@jax.jit
def changes(
    windows: Windows,
    slope: Any,
    time: Float[Array | np.ndarray, "rows"],
    visits: Float[Array | np.ndarray, "rows"],
) -> tuple[Float[Array, "rows"], Float[Array, "rows"], Float[Array, "rows"]]:
    """Apply a chain to times, and its adjoint to visits.

    **Arguments:** the chain; `slope`, the direction in which its parameters change; mean times and
    visits. **Returns:** the expected change of the time in a step from each cell, its derivative
    along `slope`, and the visits after a step. The times enter as what they lack to the longest
    one: of long times that are nearly equal, the sum has all digits.
    """
    box, size = windows.box, len(time)
    longest = time.max()
    lacks = (longest - windows.rest * jnp.asarray(time)[windows.row]).reshape(box.cells)

    def part(after: Any, block: Any) -> Any:
        points, lack, visits = block

        def moved(params: Any) -> Any:
            value, last, leaving, cells = _block(windows, params, points)
            there = lacks[jnp.ix_(*cells)].reshape(-1, windows.wide[-1])
            lost = (value * (last @ there.T)).sum(axis=1).reshape(points.shape[:2]).sum(axis=1)
            return lack - lost - leaving * longest, (value, last, cells)

        change, by, (value, last, cells) = jax.jvp(moved, (windows.params,), (slope,), has_aux=True)
        each = jnp.repeat(visits, points.shape[1])
        moves = ((value * each[:, None]).T @ last).reshape(windows.wide)
        return after.at[jnp.ix_(*cells)].add(moves), (change, by)

    shape = windows.points.shape[:2]
    filled = [jnp.zeros(shape[0] * shape[1]).at[:size].set(one) for one in (longest - time, visits)]
    blocks = windows.points, *(one.reshape(shape) for one in filled)
    after, found = jax.lax.scan(part, jnp.zeros(box.cells), blocks)
    change, by = (each.ravel()[:size] for each in found)
    return change, by, _folded(windows, after.ravel())[:size]


def _folded(windows: Windows, each: Any) -> Any:
    """Add the probabilities of the cells of the box in which the chain goes on to its rows."""
    size = windows.points.shape[0] * windows.points.shape[1]
    return jnp.zeros(size).at[windows.row].add(windows.rest * each)
