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
# Number of probabilities of windows that are computed at once.
_PART = 1 << 17
# Probability of leaving the box that is rounding, as in `leaving_rows` of chains.
_LEAST = 1e-12


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Windows:
    """A chain of a noisy map that stops in regions: each row is a window of cells of a box.

    The box has one more cell beyond each clamped side, as `Ends.around`.
    """

    map: Map = dataclasses.field(metadata={"static": True})
    box: Box = dataclasses.field(metadata={"static": True})
    wide: tuple[int, ...] = dataclasses.field(metadata={"static": True})
    params: Any
    noise: Any
    points: Any
    rest: Any
    "The share of each cell of the box in which the chain goes on."
    nearest: Any
    "The row of each cell of the box."

    @classmethod
    def of(
        cls, map: Map, box: Box, params: Any, noise: Any, points: Any, rest: Any, nearest: Any
    ) -> "Windows":
        """Find the number of cells that the longest window needs along each axis."""
        reach = np.asarray(_reach(map, box, params, points)) + 2 * _CUT * noise / box.width
        each = np.ceil((reach + 2) / _STEP) * _STEP
        # Windows along a periodic axis may be longer than it.
        most = np.where(np.array(box.axes) == "periodic", np.inf, box.cells)
        wide = tuple(np.minimum(each, most).astype(int).tolist())
        return cls(map, box, wide, params, noise, points, rest, nearest)

    @property
    def batch(self) -> int:
        """The number of rows that are computed at once."""
        return min(max(1, _PART // math.prod(self.wide)), len(self.points))


@functools.partial(jax.jit, static_argnames=("map", "box"))
def _reach(map: Map, box: Box, params: Any, points: Any) -> Any:
    each = jax.vmap(lambda points: jnp.ptp(_places(map, box, params, points)[0], axis=0))(points)
    return each.max(axis=0)


def _places(map: Map, box: Box, params: Any, points: Any) -> tuple[Any, Any]:
    """Map the points of a cell; return the images in units of cells, and which are finite."""
    image = jax.vmap(lambda x: jnp.asarray(map(x, params)))(points)
    finite = jnp.isfinite(image).all(axis=1)
    wrapped = box.wrapped(jnp.where(finite[:, None], image, 0.0))
    return (wrapped - jnp.asarray(box.lower)[None]) / box.width[None], finite


def _row(windows: Windows, params: Any, points: Any) -> tuple[Any, Any, tuple[Any, ...]]:
    """Compute the probabilities of the cells in a window, and of leaving, and list the cells."""
    box, wide, noise = windows.box, windows.wide, windows.noise
    place, finite = _places(windows.map, box, params, points)
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


@jax.jit
def matrix(windows: Windows) -> Float[Array, "rows rows"]:
    """Compute the transition matrix between the cells in which the chain goes on."""

    def row(points: Any) -> Any:
        value, _, cells = _row(windows, windows.params, points)
        whole = jnp.zeros(windows.box.cells).at[jnp.ix_(*cells)].add(value).ravel()
        return _folded(windows, whole)

    return jax.lax.map(row, windows.points, batch_size=windows.batch)


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
    along `slope`, and the visits after a step. Probabilities of a row sum to 1, so that the change
    is a sum of differences, with all its digits where times are nearly equal.
    """
    box, count, size = windows.box, windows.batch, len(windows.points)
    later = (windows.rest * jnp.asarray(time)[windows.nearest]).reshape(box.cells)

    def one(points: Any, now: Any, visits: Any) -> Any:
        def moved(params: Any) -> Any:
            value, leaving, cells = _row(windows, params, points)
            ahead = later[jnp.ix_(*cells)] - now
            return jnp.sum(value * ahead) - leaving * now, (value, cells)

        change, by, (value, cells) = jax.jvp(moved, (windows.params,), (slope,), has_aux=True)
        return change, by, visits * value, cells

    def part(after: Any, rows: Any) -> Any:
        change, by, value, cells = jax.vmap(one)(*rows)
        index = [
            one.reshape(len(one), *[1] * axis, -1, *[1] * (box.dimensions - axis - 1))
            for axis, one in enumerate(cells)
        ]
        return after.at[tuple(index)].add(value), (change, by)

    filled = -(-size // count) * count
    rows = jax.tree.map(
        lambda each: jnp.concatenate([each, each[: filled - size]]).reshape(
            -1, count, *each.shape[1:]
        ),
        (windows.points, time, visits),
    )
    known = (jnp.arange(filled) < size).reshape(-1, count)
    rows = rows[0], rows[1], jnp.where(known, rows[2], 0.0)
    after, found = jax.lax.scan(part, jnp.zeros(box.cells), rows)
    change, by = (each.ravel()[:size] for each in found)
    return change, by, _folded(windows, after.ravel())


def _folded(windows: Windows, each: Any) -> Any:
    """Add the probabilities of the cells of the box in which the chain goes on to its rows."""
    return jnp.zeros(len(windows.points)).at[windows.nearest].add(windows.rest * each)
