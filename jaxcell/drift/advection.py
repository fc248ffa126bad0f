"""Where a flow takes points of its grid."""

import dataclasses
import functools
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..mapping.section import bucket
from .flow import Flow, between, crossing_time, in_squares
from .water import Water


# For each stage of a method, how much of the step it is ahead, and its weight in the mean.
_STAGES = {
    "euler": ((0.0, 1.0),),
    "rk4": ((0.0, 1.0), (0.5, 2.0), (0.5, 2.0), (1.0, 1.0)),
}
METHODS = tuple(_STAGES)
# Fewer points than the first share one compiled program. More than the second have their own, which
# is faster, since it knows the number of steps.
_FEW_POINTS, _MANY_POINTS = 1024, 1 << 18

_Pair: TypeAlias = tuple[Array, Array]


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
    """Where the flow takes points of the grid. Works under `jit`, `vmap` and `grad`.

    **Arguments:**

    - `flow`: the flow.
    - `x`, `y`: the points, in cells.
    - `duration`: for how long, in seconds; backwards if negative.
    - `start`: when, in seconds as in `Flow.time`.
    - `method`: `"euler"`, Eq. 5.3 of Alam 2018, or `"rk4"`, the Runge-Kutta method of order 4.
    - `steps`: number of steps of the method.

    **Returns:** where the points are then, `x` and `y` in cells.

    **Raises:** `ValueError` for an unknown method, or fewer steps than 1.

    A flow of a tenth of a cell a second to the East, everywhere and always:

        >>> import numpy as np
        >>> from jaxcell import drift
        >>> rate = np.stack([np.full((3, 5), 0.1), np.zeros((3, 5))])[None]
        >>> flow = drift.Flow(rate, np.zeros(1))
        >>> x, y = drift.advect(flow, np.array([1.0]), np.array([2.0]), 20.0)
        >>> x.round(6).tolist(), y.tolist()
        ([3.0], [2.0])
    """
    _check_method(method, steps)
    return _advected(flow, x, y, duration, start, method, steps)


def carried(
    flow: Flow,
    x: Float[np.ndarray, "*points"],
    y: Float[np.ndarray, "*points"],
    duration: float | int,
    start: float | int,
    method: str,
    steps: int,
) -> tuple[Float[np.ndarray, "*points"], Float[np.ndarray, "*points"]]:
    """[`advect`][] by one program for any number of steps, and for about as many points."""
    seconds = float(duration), float(start)
    if x.size >= _MANY_POINTS:
        found = advect(flow, x, y, seconds[0], start=seconds[1], method=method, steps=steps)
        return np.asarray(found[0]), np.asarray(found[1])
    size = max(_FEW_POINTS, bucket(x.size))
    # What spreads drifters is not part of the program either.
    still = dataclasses.replace(flow, diffusivity=0.0)
    found = _carried(still, np.resize(x, size), np.resize(y, size), *seconds, method, steps)
    ends_x, ends_y = (np.asarray(one)[: x.size].reshape(x.shape) for one in found)
    return ends_x, ends_y


def _advected(flow, x, y, duration, start, method, steps):  # type: ignore[no-untyped-def]
    length = duration / steps
    ahead, weight = (jnp.asarray(row, jnp.float64) for row in zip(*_STAGES[method], strict=True))
    share = length * weight / jnp.sum(weight)

    # A stage at a time, which adds what the one before has found: of more at once XLA would compute
    # early stages anew in the later ones. For the same reason the flow in the squares comes from
    # the stage before: else it would be computed for each point.
    def stage(number, state):  # type: ignore[no-untyped-def]
        begun, reached, rates, rate = state
        step, stage = (number + 1) // ahead.size, (number + 1) % ahead.size
        rates = between(flow, rate, *_moved(begun, rates, length * ahead[stage - 1]))
        reached = _moved(reached, rates, share[stage - 1])
        begun = jax.tree.map(lambda new, old: jnp.where(stage, old, new), reached, begun)
        now = start + step.astype(jnp.float64) * length + length * ahead[stage]
        return begun, reached, rates, in_squares(flow, now)

    begun = jnp.asarray(x, jnp.float64), jnp.asarray(y, jnp.float64)
    still = jnp.zeros_like(begun[0]), jnp.zeros_like(begun[1])
    first = in_squares(flow, jnp.asarray(start, jnp.float64))
    state = jax.lax.fori_loop(0, ahead.size * steps, stage, (begun, begun, still, first))
    return state[1]


_carried = jax.jit(_advected, static_argnames="method")


def _moved(places: _Pair, rates: _Pair, time: Any) -> _Pair:
    return places[0] + time * rates[0], places[1] + time * rates[1]


def flow_map(
    water: Water,
    flow: Flow,
    duration: float | int | None = None,
    *,
    start: float | int = 0.0,
    method: str = "euler",
    steps: int = 1,
) -> Float[Array, "axes cells"]:
    """How far the centre of every cell drifts (Alam 2018, section 5.4.2).

    **Arguments:**

    - `water`: the cells.
    - `flow`: the flow of the same layer.
    - `duration`: for how long, in seconds; backwards if negative. By default
        [`crossing_time`][].
    - `start`, `method`, `steps`: as for [`advect`][].

    **Returns:** the displacements along the axes x and y of the grid, in cells.

    **Raises:** `ValueError` for a duration that is 0 or not finite, an unknown method, or fewer
    steps than 1.

    In the time to cross a cell, cells drift by one on average:

        >>> from jaxcell import drift, examples
        >>> water, flow = examples.gyres()
        >>> shift = drift.flow_map(water, flow)
        >>> shift.shape, round(float(((shift**2).sum(axis=0) ** 0.5).mean()), 6)
        ((2, 538), 1.0)
    """
    duration = checked_duration(flow, water, duration, method, steps)
    x, y = np.stack([water.column, water.row]).astype(np.float64)
    ends = carried(flow, x, y, duration, start, method, steps)
    return jax.device_put(np.stack([ends[0] - x, ends[1] - y]))


def checked_duration(
    flow: Flow, water: Water, duration: float | int | None, method: str, steps: int
) -> float:
    """A duration in seconds, by default the time to cross a cell.

    **Raises:** as [`flow_map`][].
    """
    _check_method(method, steps)
    if flow.rate.shape[2:] != water.number.shape:
        raise ValueError(
            f"flow: expected one over the {list(water.number.shape)} squares of this water, got "
            f"one over {list(flow.rate.shape[2:])}"
        )
    if flow.wraps != water.wraps:
        raise ValueError(
            f"flow: wraps: expected {water.wraps} as for this water, got {flow.wraps}; only one of "
            "them goes round the Earth"
        )
    if duration is None:
        return crossing_time(water, flow)
    if not (np.isfinite(duration) and duration != 0):
        raise ValueError(f"duration: expected a number of seconds other than 0, got {duration}")
    return float(duration)


def _check_method(method: str, steps: int) -> None:
    if method not in METHODS:
        raise ValueError(f"method: expected 'euler' or 'rk4', got {method!r}")
    if steps < 1:
        raise ValueError(f"steps: expected 1 or more, got {steps}")
