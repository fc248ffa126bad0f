"""Drifters at points instead of cells: they follow the flow, diffuse, and stop once off the map."""

import math

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from .advection import advected, in_chunks
from .flow import Flow, crossing_time, nearest_square
from .water import Water, on_grid


# A number of steps that exceeds a whole number by less than this is that number.
_ROUNDING = 1e-9


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

    A point has left if it is off the map at any stage of a Runge-Kutta step.

    **Arguments:**

    - `x`, `y`: the points, in columns and rows of the grid.
    - `start`, `end`: the times, in seconds as in `Flow.time`.
    - `longest`: the longest Runge-Kutta step, in seconds.
    - `key`: a key of `jax.random`, for the diffusivity of the flow; without a key drifters do
        not diffuse.
    """
    steps = max(1, math.ceil(abs(end - start) / longest - _ROUNDING))
    times = float(start), float(end - start), steps
    grid = np.stack([water.dx, water.dy]), ~water.closed, water.gone

    def move(first: int, x: np.ndarray, y: np.ndarray) -> tuple[Array, Array]:
        chunk = None if key is None else jax.random.fold_in(key, first)
        return _drifted(flow, grid, x, y, chunk, *times)

    return in_chunks(move, x, y)


def longest_step(water: Water, flow: Flow) -> float:
    """Return the longest Runge-Kutta step, in seconds, with which drifters follow a flow.

    It moves drifters by at most half a cell on average, and is at most the time between records.
    """
    between = np.diff(np.asarray(flow.time)).min(initial=np.inf)
    return min(crossing_time(water, flow) / 2, between)


@jax.jit
def _drifted(flow, grid, x, y, key, start, duration, steps):  # type: ignore[no-untyped-def]
    sides, wet, gone = grid
    if key is None or not flow.diffusivity:
        return advected(flow, x, y, duration, start, "rk4", steps, gone)
    length = duration / steps

    def step(number, place):  # type: ignore[no-untyped-def]
        x, y = place
        after = advected(flow, x, y, length, start + number * length, "rk4", 1, gone)
        drawn = jax.random.fold_in(key, number)
        return diffuse(drawn, flow, sides, wet, gone, *after, length)

    return jax.lax.fori_loop(0, steps, step, (x, y))


@jax.jit
def diffuse(
    key: jax.Array,
    flow: Flow,
    sides: Float[Array, "axes rows columns"],
    wet: Bool[Array, "rows columns"],
    gone: Bool[Array, "rows columns"],
    x: Float[Array, "points"],
    y: Float[Array, "points"],
    duration: Float[Array, ""] | float,
) -> tuple[Float[Array, "points"], Float[Array, "points"]]:
    """Move points in a random walk with the diffusivity of the flow.

    `sides` are the sides of the squares in metres. A point does not enter squares outside `wet`,
    and does not move from squares in `gone` or from places off the grid.
    """
    row, column = nearest_square(wet.shape, flow.wraps, x, y)
    far = jnp.sqrt(2 * flow.diffusivity * jnp.abs(duration))
    right, up = far * jax.random.normal(key, (2, x.size), x.dtype) / sides[:, row, column]
    on, to = (wet.shape, flow.wraps), (x + right, y + up)
    ashore = on_grid(*on, *to) & ~wet[nearest_square(*on, *to)]
    stays = ~on_grid(*on, x, y) | gone[row, column] | ashore
    return jnp.where(stays, x, to[0]), jnp.where(stays, y, to[1])
