"""Times after which orbits of flows are back, measured where they cross a plane."""

import functools
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from ..space.box import Box
from .batches import padded
from .maps import Flow


# Number of steps that are followed, and the largest number of orbits.
_STEPS = 1 << 14
_MOST = 32
# Largest distance of an orbit that is back from its start, as a share of its extent.
_BACK = 1e-3


def return_times(
    map: Flow, box: Box, params: Any, start: Float[np.ndarray, "orbits axes"]
) -> Float[np.ndarray, "orbits"]:
    """Measure the time after which each orbit of a flow is back at its start.

    The time is infinite for an orbit that is not back again and again within 16,384 steps, as on a
    torus or in chaos, and for all orbits after the first 32.
    """
    times = np.full(len(start), np.inf)
    if not len(start):
        return times
    orbits, velocities = padded(lambda x: _path(map, box, params, x), (start[:_MOST],))
    for k, (orbit, velocity) in enumerate(zip(orbits, velocities, strict=True)):
        away = shortest(box, (orbit - orbit[0]) / box.width)
        times[k] = map.dt * _steps_back(away, velocity / box.width)
    return times


def shortest(box: Box, cells: Any) -> Any:
    """Shorten differences in cells by whole turns round periodic axes."""
    xp = cells.__array_namespace__()
    count = np.where(np.array(box.axes) == "periodic", box.cells, np.inf)
    turns = xp.where(np.isfinite(count), xp.round(cells / count), 0)
    return cells - turns * np.where(np.isfinite(count), count, 0)


def _steps_back(
    away: Float[np.ndarray, "steps axes"], velocity: Float[np.ndarray, "axes"]
) -> float:
    """Find after how many steps an orbit is back; `away` are differences from its start."""
    height = away @ velocity
    after = 1 + np.flatnonzero((height[1:-2] < 0) & (height[2:-1] >= 0))
    after = after[after >= 1]
    if not after.size:
        return np.inf
    # The cubic through four points, at the places -1, 0, 1 and 2.
    near = height[after[:, None] + np.arange(-1, 3)]
    place = near[:, 1] / (near[:, 1] - near[:, 2])
    for _ in range(3):
        value = (_cubic(place) * near).sum(axis=1)
        place = np.clip(place - value / (near[:, 2] - near[:, 1]), 0, 1)
    points = np.einsum("cn,cna->ca", _cubic(place), away[after[:, None] + np.arange(-1, 3)])
    back = np.abs(points).max(axis=1) < _BACK * np.ptp(away, axis=0).max()
    crossings = 1 + int(back.argmax())
    each = np.arange(crossings - 1, back.size, crossings)
    if not back.any() or not back[each].all() or (after[each[-1]] < away.shape[0] / 2):
        return np.inf
    return float((after + place)[each[-1]] / each.size)


def _cubic(place: Float[np.ndarray, "crossings"]) -> Float[np.ndarray, "crossings 4"]:
    """Compute the weights of values at -1, 0, 1 and 2 in their cubic at `place`."""
    s = place
    return np.stack(
        [
            -s * (s - 1) * (s - 2) / 6,
            (s + 1) * (s - 1) * (s - 2) / 2,
            -(s + 1) * s * (s - 2) / 2,
            (s + 1) * s * (s - 1) / 6,
        ],
        axis=1,
    )


@functools.partial(jax.jit, static_argnames=("map", "box"))
def _path(map: Flow, box: Box, params: Any, start: Any) -> Any:
    def step(x, _):  # type: ignore[no-untyped-def]
        return box.wrapped(map.one(x, params)), x

    def path(x):  # type: ignore[no-untyped-def]
        return jax.lax.scan(step, x, length=_STEPS)[1], map.velocity(x, params)

    return jax.vmap(path)(start)
