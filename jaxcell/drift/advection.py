"""Motion of points: a flow carries them, and they diffuse, until they leave the map."""

import dataclasses
import functools
import math
from collections.abc import Callable
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..base.wide import traced
from ..mapping.section import bucket
from .flow import Flow, between, crossing_time, in_squares, nearest_square
from .water import Water, on_grid


# For each stage of a method: its time as a part of the step, and its weight in the mean.
_STAGES = {"euler": ((0.0, 1.0),), "rk4": ((0.0, 1.0), (0.5, 2.0), (0.5, 2.0), (1.0, 1.0))}
METHODS = tuple(_STAGES)
# The number of points that are moved together, chosen to fit the cache of a processor.
_CHUNK = 1 << 16
# Fewer points are padded to this number, so that one compiled program serves them all.
_FEW_POINTS = 1024
# A number of steps that exceeds a whole number by less than this is that number.
_ROUNDING = 1e-9

_Pair: TypeAlias = tuple[Array, Array]
_Points: TypeAlias = Float[Any, "*points"]
_Time: TypeAlias = Float[Array, ""] | float | int


@functools.partial(jax.jit, static_argnames=("method", "steps"))
def advect(
    flow: Flow,
    x: Float[Array, "*points"],
    y: Float[Array, "*points"],
    duration: Float[Array, ""] | float,
    *,
    start: Float[Array, ""] | float = 0.0,
    method: str = "euler",
    steps: int = 1,
) -> tuple[Float[Array, "*points"], Float[Array, "*points"]]:
    """Move points with the flow. The function works under `jit`, `vmap` and `grad`.

    **Arguments:**

    - `flow`: the flow.
    - `x`, `y`: the points, in columns and rows of the grid.
    - `duration`: the duration in seconds; negative to move points backward in time.
    - `start`: the time at the beginning, in seconds as in `Flow.time`.
    - `method`: `"euler"`, Eq. 5.3 of Alam 2018, or `"rk4"`, the Runge-Kutta method of order 4.
    - `steps`: number of steps of the method.

    **Returns:** `x` and `y` of the points at the end.

    A uniform and steady flow to the East, of a tenth of a cell per second:

        >>> import jax.numpy as jnp
        >>> from jaxcell import drift
        >>> rate = jnp.stack([jnp.full((3, 5), 0.1), jnp.zeros((3, 5))])[None]
        >>> flow = drift.Flow(rate, jnp.zeros(1))
        >>> x, y = drift.advect(flow, jnp.array([1.0]), jnp.array([2.0]), 20.0)
        >>> x.round(6).tolist(), y.tolist()
        ([3.0], [2.0])
    """
    if method not in METHODS:
        raise ValueError(f"method: expected 'euler' or 'rk4', got {method!r}")
    if steps < 1:
        raise ValueError(f"steps: expected 1 or more, got {steps}")
    return advected(flow, x, y, duration, start, method, steps)


def carried(
    flow: Flow,
    x: _Points,
    y: _Points,
    duration: _Time,
    start: _Time,
    method: str,
    steps: int,
    gone: Bool[np.ndarray, "rows columns"] | None = None,
) -> tuple[_Points, _Points]:
    """Move points like [`advect`][], with one compilation for many numbers of points or steps.

    If JAX traces the flow or a time, they move in the program.
    """
    if traced(flow, duration, start):
        return advected(flow, x, y, duration, start, method, steps, gone)
    seconds = float(duration), float(start)
    # The diffusivity is static, and has no effect on advection.
    flow = dataclasses.replace(flow, diffusivity=0.0)
    return in_chunks(lambda _, x, y: _carried(flow, x, y, *seconds, method, steps, gone), x, y)


def in_chunks(
    move: Callable[[int, np.ndarray, np.ndarray], _Pair], x: _Points, y: _Points
) -> tuple[_Points, _Points]:
    """Apply `move` to chunks of points that fit into the cache of a processor, for speed.

    The arguments of `move` are the index of the first point of a chunk, and `x` and `y` of the
    points in the chunk. It returns their new `x` and `y`.
    """
    begin, ends = np.stack([x.ravel(), y.ravel()]), np.empty((2, x.size))
    for first in range(0, x.size, _CHUNK):
        part = begin[:, first : first + _CHUNK]
        size = max(_FEW_POINTS, bucket(part.shape[1]))
        moved = move(first, *(np.resize(place, size) for place in part))
        ends[:, first : first + _CHUNK] = np.stack(moved)[:, : part.shape[1]]
    return ends[0].reshape(x.shape), ends[1].reshape(x.shape)


def advected(flow, x, y, duration, start, method, steps, gone=None):  # type: ignore[no-untyped-def]
    """Move points like [`advect`][]; a point stays where a stage puts it off the grid or in `gone`.

    `gone` is a mask of squares. Without it, points move on.
    """
    length = duration / steps
    ahead, weight = (jnp.asarray(row, jnp.float64) for row in zip(*_STAGES[method], strict=True))
    share = length * weight / jnp.sum(weight)

    # The loop runs over single stages, and each adds the rates of the previous stage: if the body
    # had several stages, XLA would compute early stages again in later ones. The flow in squares
    # comes from the previous stage too: else XLA would compute it for each point.
    def stage(number, state):  # type: ignore[no-untyped-def]
        begun, reached, rates, rate = state
        step, stage = (number + 1) // ahead.size, (number + 1) % ahead.size
        place = _moved(begun, rates, length * ahead[stage - 1])
        rates = between(flow, rate, *place)
        if gone is not None:
            on = on_grid(gone.shape, flow.wraps, *place)
            on &= ~jnp.asarray(gone)[nearest_square(gone.shape, flow.wraps, *place)]
            begun, reached = (_chosen(on, places, place) for places in (begun, reached))
            rates = _chosen(on, rates, (0.0, 0.0))
        reached = _moved(reached, rates, share[stage - 1])
        begun = _chosen(stage, begun, reached)
        now = start + step.astype(jnp.float64) * length + length * ahead[stage]
        return begun, reached, rates, in_squares(flow, now)

    begun = jnp.asarray(x, jnp.float64), jnp.asarray(y, jnp.float64)
    still = jnp.zeros_like(begun[0]), jnp.zeros_like(begun[1])
    first = in_squares(flow, jnp.asarray(start, jnp.float64))
    state = jax.lax.fori_loop(0, ahead.size * steps, stage, (begun, begun, still, first))
    return state[1]


_carried = jax.jit(advected, static_argnames="method")


def _moved(places: _Pair, rates: _Pair, time: Any) -> _Pair:
    return places[0] + time * rates[0], places[1] + time * rates[1]


def _chosen(chosen: Any, pair: Any, other: Any) -> _Pair:
    return jnp.where(chosen, pair[0], other[0]), jnp.where(chosen, pair[1], other[1])


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
    # One program for all diffusivities above 0.
    spreads = None if key is None or not flow.diffusivity else flow.diffusivity
    flow = dataclasses.replace(flow, diffusivity=0.0)

    def move(first: int, x: np.ndarray, y: np.ndarray) -> tuple[Array, Array]:
        chunk = None if key is None else jax.random.fold_in(key, first)
        return _drifted(flow, grid, x, y, chunk, spreads, *times)

    return in_chunks(move, x, y)


def longest_step(water: Water, flow: Flow) -> float:
    """Return the longest Runge-Kutta step, in seconds, with which drifters follow a flow.

    It moves drifters by at most half a cell on average, and is at most the time between records.
    """
    between = np.diff(np.asarray(flow.time)).min(initial=np.inf)
    return min(crossing_time(water, flow) / 2, between)


@jax.jit
def _drifted(flow, grid, x, y, key, diffusivity, start, duration, steps):  # type: ignore[no-untyped-def]
    sides, wet, gone = grid
    if diffusivity is None:
        return advected(flow, x, y, duration, start, "rk4", steps, gone)
    length = duration / steps

    def step(number, place):  # type: ignore[no-untyped-def]
        x, y = place
        after = advected(flow, x, y, length, start + number * length, "rk4", 1, gone)
        drawn = jax.random.fold_in(key, number)
        return diffuse(drawn, diffusivity, flow.wraps, sides, wet, gone, *after, length)

    return jax.lax.fori_loop(0, steps, step, (x, y))


@functools.partial(jax.jit, static_argnames="wraps")
def diffuse(
    key: jax.Array,
    diffusivity: Float[Array, ""] | float,
    wraps: bool,
    sides: Float[Array, "axes rows columns"],
    wet: Bool[Array, "rows columns"],
    gone: Bool[Array, "rows columns"],
    x: Float[Array, "points"],
    y: Float[Array, "points"],
    duration: Float[Array, ""] | float,
) -> tuple[Float[Array, "points"], Float[Array, "points"]]:
    """Move points in a random walk with a diffusivity in m²/s.

    `sides` are the sides of the squares in metres. A point does not enter squares outside `wet`,
    and does not move from squares in `gone` or from places off the grid.
    """
    row, column = nearest_square(wet.shape, wraps, x, y)
    far = jnp.sqrt(2 * diffusivity * jnp.abs(duration))
    right, up = far * jax.random.normal(key, (2, x.size), x.dtype) / sides[:, row, column]
    on, to = (wet.shape, wraps), (x + right, y + up)
    ashore = on_grid(*on, *to) & ~wet[nearest_square(*on, *to)]
    stays = ~on_grid(*on, x, y) | gone[row, column] | ashore
    return jnp.where(stays, x, to[0]), jnp.where(stays, y, to[1])
