"""Drifters at points instead of cells: they follow the flow, diffuse, and stop once off the map."""

import math

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from .advection import advect, in_chunks
from .flow import Flow
from .water import Water, on_grid


# The largest number of Runge-Kutta steps between two checks of whether a drifter has left.
_SUBSTEPS = 4


def drifted(
    water: Water,
    flow: Flow,
    x: Float[np.ndarray, "*points"],
    y: Float[np.ndarray, "*points"],
    start: float | int,
    end: float | int,
    longest: float | int,
    key: jax.Array | None = None,
) -> tuple[Float[np.ndarray, "*points"], Float[np.ndarray, "*points"]]:
    """Move points from one time to another; points that leave the map stay where they left it.

    **Arguments:**

    - `x`, `y`: the points, in columns and rows of the grid.
    - `start`, `end`: the times, in seconds as in `Flow.time`.
    - `longest`: the longest Runge-Kutta step, in seconds.
    - `key`: a key of `jax.random`, for the diffusivity of the flow; without a key drifters do
        not diffuse.
    """
    moves = max(1, math.ceil(abs(end - start) / (longest * _SUBSTEPS)))
    times = float(start), (end - start) / moves, moves
    grid = np.stack([water.dx, water.dy]), ~water.closed, water.gone

    def move(first: int, x: np.ndarray, y: np.ndarray) -> tuple[Array, Array]:
        chunk = None if key is None else jax.random.fold_in(key, first)
        return _drifted(flow, grid, x, y, chunk, *times)

    return in_chunks(move, x, y)


@jax.jit
def _drifted(flow, grid, x, y, key, start, length, moves):  # type: ignore[no-untyped-def]
    sides, wet, gone = grid

    def move(number, place):  # type: ignore[no-untyped-def]
        on = on_grid(wet.shape, flow.wraps, *place)
        on &= ~gone[nearest_square(wet.shape, flow.wraps, *place)]
        now = start + number * length
        after = advect(flow, *place, length, start=now, method="rk4", steps=_SUBSTEPS)
        if key is not None and flow.diffusivity:
            drawn = jax.random.fold_in(key, number)
            after = diffuse(drawn, flow, sides, wet, *after, length)
        return tuple(jnp.where(on, new, old) for new, old in zip(after, place, strict=True))

    return jax.lax.fori_loop(0, moves, move, (x, y))


@jax.jit
def diffuse(
    key: jax.Array,
    flow: Flow,
    sides: Float[Array, "axes rows columns"],
    wet: Bool[Array, "rows columns"],
    x: Float[Array, "points"],
    y: Float[Array, "points"],
    duration: Float[Array, ""] | float,
) -> tuple[Float[Array, "points"], Float[Array, "points"]]:
    """Move points in a random walk with the diffusivity of the flow.

    `sides` are the sides of the squares in metres. A point does not enter squares outside `wet`.
    """
    row, column = nearest_square(wet.shape, flow.wraps, x, y)
    far = jnp.sqrt(2 * flow.diffusivity * jnp.abs(duration))
    right, up = far * jax.random.normal(key, (2, x.size), x.dtype) / sides[:, row, column]
    on, to = (wet.shape, flow.wraps), (x + right, y + up)
    ashore = on_grid(*on, *to) & ~wet[nearest_square(*on, *to)]
    stays = ~on_grid(*on, x, y) | ashore
    return jnp.where(stays, x, to[0]), jnp.where(stays, y, to[1])


def nearest_square(shape, wraps, x, y):  # type: ignore[no-untyped-def]
    """Find the row and column of the square of the grid that is nearest to each point."""
    rows, columns = shape
    row, column = (jnp.round(place).astype(jnp.int32) for place in (y, x))
    column = column % columns if wraps else jnp.clip(column, 0, columns - 1)
    return jnp.clip(row, 0, rows - 1), column
