"""Cycles of points, refined by Newton's method, and tests whether orbits have settled."""

import functools
import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from ..space.box import Box
from .batches import padded
from .maps import Flow, Map
from .returns import return_times, shortest


# Iterations of Newton's method.
_NEWTON = 12
# Largest distance in cells after a period of an orbit that counts as periodic.
_PERIODIC = 1e-3
# Largest number of orbits that are followed, for how many mappings, or steps of flows.
_MOST = 128
_MAPPINGS, _STEPS = 1 << 11, 1 << 14
# Number of points in a window of an orbit.
_WINDOW = 1 << 8
# Least number of turning points of an orbit that is followed.
_TURNS = 32
# Logarithms of factors by which distances change within the age of an orbit: the least of a
# direction that contracts or expands exponentially, and the largest of a neutral direction. An
# algebraic approach, in which distances are powers of the age, has 1 to 2, at any age.
_EXPONENTIAL, _NEUTRAL = 6.0, 0.25
# Shares of the box by which coordinates that differ only by rounding are the same.
_SAME = 1e-9
# Largest number of periods that are tried for an orbit that is not periodic yet.
_TRIED = 8


def period(orbit: Float[np.ndarray, "window axes"], box: Box) -> int:
    """Count the points in one period of an orbit; 0 if it does not repeat to within 1e-3 cells."""
    near = box.apart((orbit[::-1] - orbit[-1]) / box.width).max(axis=1) < _PERIODIC
    half = near.size // 2
    back = np.flatnonzero(near[1:half])
    if not back.size:
        return 0
    steps = int(back[0]) + 1
    return steps if near[:half:steps].all() else 0


def settled_cycles(
    map: Map,
    box: Box,
    params: Any,
    orbit: Float[np.ndarray, "starts window axes"],
    end: Int[np.ndarray, "starts"],
    age: int,
    oldest: int,
) -> tuple[dict[int, Float[np.ndarray, "_ axes"]] | None, bool]:
    """Decide whether orbits have settled on their attractors.

    `end` is the attractor of each orbit, or -1, and `age` the number of mappings before the window,
    or of steps for a flow. For each attractor, the orbits that move most and least are tested. An
    orbit has settled if it is within a cell of a cycle of points, and the multipliers of the cycle
    contract distances by `exp(-6)` within the age. Any other orbit that is back again and again,
    such as a cycle of a flow, has settled if distances across it contract as much. An orbit that
    never is back, such as chaos or a torus, has settled if they contract or expand as much in each
    direction, or stay the same. This excludes algebraic approaches, as at bifurcations, and slow
    passages of places where an attractor is about to appear. An orbit that turns back too rarely
    for this test has not settled.

    Returns the cycles of points, by number of attractor, or `None` if an orbit has not settled; and
    whether distances from an orbit that is back stay the same in a direction, also within the age
    `oldest`, so that more mappings would decide nothing.
    """
    stays = end >= 0
    orbit, end = orbit[stays], end[stays]
    extent = np.ptp(_from_last(box, orbit), axis=1).max(axis=1)
    order = np.lexsort((-extent, end))
    number, first = np.unique(end[order], return_index=True)
    last = np.append(first[1:], end.size)[: number.size] - 1
    tested = orbit[order[np.concatenate([first, last])]]
    found = _attracting_cycles(map, box, params, tested, age)
    others = [k for k, cycle in enumerate(found) if cycle is None][:_MOST]
    rests = np.array([_repeats(box, tested[k]) for k in others], bool)
    resting, moving = np.array(others, int)[rests], np.array(others, int)[~rests]
    settled, neutral = True, False
    if resting.size:
        settled, neutral = _stay(map, box, params, tested[resting, -1], age, oldest)
    if settled and any(period(x, box) for x in tested[moving]):
        settled = False
    if settled and moving.size:
        attractor = np.tile(number, 2)[moving]
        last = tested[moving, -1]
        settled, neutral = _recur(map, box, params, last, attractor, age, oldest)
    widest = zip(number.tolist(), found, strict=False)
    cycles = {k: cycle for k, cycle in widest if cycle is not None}
    return cycles if settled else None, neutral


def newton(map: Map, box: Box, params: Any, start: Any, period: Any) -> tuple[np.ndarray, ...]:
    """Refine periodic points by Newton's method; return points, last corrections and derivatives.

    The arguments are arrays `[points, axes]` and `[points]`. A point on a periodic axis may go
    round it within a period.
    """
    return _differentiated(
        lambda derive: padded(
            lambda *rows: _newton(map, box, derive, params, *rows), (start, period)
        )
    )


def _differentiated(compute: Callable[[Any], Any]) -> Any:
    """Call `compute` with a function that derives maps; maps may have one kind of derivative."""
    try:
        return compute(jax.jacfwd)
    except TypeError:
        return compute(jax.jacrev)


@functools.partial(jax.jit, static_argnames=("map", "box", "derive"))
def _newton(map: Map, box: Box, derive: Any, params: Any, start: Any, period: Any) -> Any:
    width = jnp.asarray(box.width, start.dtype)

    def solve(x, period):  # type: ignore[no-untyped-def]
        def after(x):  # type: ignore[no-untyped-def]
            return jax.lax.fori_loop(0, period, lambda _, y: map(y, params), x)

        def correction(x):  # type: ignore[no-untyped-def]
            slope = derive(after)(x)
            moved = (shortest(box, (after(x) - x) / width) * width).astype(x.dtype)
            return jnp.linalg.solve(slope - jnp.eye(x.size, dtype=x.dtype), moved), slope

        x = jax.lax.fori_loop(0, _NEWTON, lambda _, x: x - correction(x)[0], x)
        last, slope = correction(x)
        return x, jnp.max(jnp.abs(last)), slope

    return jax.vmap(solve)(start, period)


def _attracting_cycles(
    map: Map, box: Box, params: Any, orbit: Float[np.ndarray, "orbits window axes"], age: int
) -> list[Float[np.ndarray, "_ axes"] | None]:
    """Find the attracting cycle of points that is within a cell of each orbit, or `None`."""
    found: list[Float[np.ndarray, "_ axes"] | None] = [None] * len(orbit)
    tried = [_periods(map, box, each) for each in orbit]
    accuracy = np.finfo(orbit.dtype).eps ** 0.5 * (box.width * box.cells).min()
    mappings = age / map.usual if isinstance(map, Flow) else age
    for k in range(max((len(own) for own in tried), default=0)):
        rows = [n for n, own in enumerate(tried) if found[n] is None and len(own) > k]
        own = np.array([tried[n][k] for n in rows], np.int32)
        try:
            point, error, slope = newton(map, box, params, orbit[rows, -1], own)
        except (TypeError, ValueError):
            # A solver with adaptive steps may have no derivative.
            break
        finite = np.isfinite(slope).all(axis=(1, 2))
        growth = np.abs(np.linalg.eigvals(np.nan_to_num(slope, posinf=0.0, neginf=0.0))).max(axis=1)
        attracts = growth <= np.exp(-_EXPONENTIAL * own / mappings)
        good = finite & attracts & (error < accuracy)
        if isinstance(map, Flow):
            cycle = np.repeat(point[:, None], orbit.shape[1], axis=1)
        else:
            cycle = np.concatenate([point[:, None], window(map, box, params, point)], axis=1)
        for n, steps, each in zip(rows, own, cycle, strict=True):
            back = -np.arange(orbit.shape[1]) % steps
            if good[rows.index(n)] and _apart(box, orbit[n, ::-1], each[back]) < 1:
                found[n] = _from_lowest(box, box.wrapped(each[:steps]))
    return found


def _from_lowest(box: Box, cycle: Float[np.ndarray, "_ axes"]) -> Float[np.ndarray, "_ axes"]:
    """Begin a cycle with its lowest point, which does not depend on how an orbit came to it."""
    whole = np.round(cycle / (box.width * box.cells) / _SAME)
    return np.roll(cycle, -np.lexsort(whole.T[::-1])[0], axis=0)


def _periods(map: Map, box: Box, orbit: Float[np.ndarray, "window axes"]) -> list[int]:
    """List periods in mappings that an orbit may have, in ascending order."""
    if isinstance(map, Flow):
        return [1] if np.ptp(_from_last(box, orbit), axis=0).max() < 1 else []
    whole = period(orbit, box)
    if whole:
        return [k for k in range(1, whole + 1) if whole % k == 0]
    near = box.apart((orbit[-2::-1] - orbit[-1]) / box.width).max(axis=1) < 1
    return (1 + np.flatnonzero(near[: len(orbit) // 2])[:_TRIED]).tolist()


def _repeats(box: Box, orbit: Float[np.ndarray, "window axes"]) -> bool:
    """Check whether an orbit repeats up to rounding."""
    steps = period(orbit, box)
    if not steps:
        return False
    largest = np.maximum(np.abs(box.lower), np.abs(box.upper)) / box.width
    accuracy = 64 * np.finfo(orbit.dtype).eps * largest.max()
    return bool(_apart(box, orbit[steps:], orbit[:-steps]) <= accuracy)


def _stay(
    map: Map, box: Box, params: Any, start: Float[np.ndarray, "orbits axes"], age: int, oldest: int
) -> tuple[bool, bool]:
    """Check that distances from repeating orbits shrink exponentially, and whether some stay.

    Points at which the map has no derivative count as settled because they repeat.
    """
    count = _STEPS if isinstance(map, Flow) else _MAPPINGS
    try:
        _, rate, _, _ = _follow(map, box, params, start, count, along=False)
    except (TypeError, ValueError):
        return True, False
    rate = np.where(np.isnan(rate), -np.inf, rate)
    return bool((rate * age <= -_EXPONENTIAL).all()), _is_neutral(rate, oldest)


def _recur(
    map: Map,
    box: Box,
    params: Any,
    start: Float[np.ndarray, "orbits axes"],
    attractor: Int[np.ndarray, "orbits"],
    age: int,
    oldest: int,
) -> tuple[bool, bool]:
    """Check that orbits turn back often, and that nearby orbits approach, stay or separate.

    Nearby orbits may stay or separate only if the orbit never is back: the second result tells
    whether some stay at one that is. Orbits on one attractor must also have similar extents, unlike
    those of conservative systems.
    """
    flow = isinstance(map, Flow)
    back = np.full(len(start), np.inf)
    count = _MAPPINGS
    if isinstance(map, Flow):
        back = return_times(map, box, params, start) / map.dt
        longest = back[np.isfinite(back)].max(initial=0)
        # An orbit turns at least twice before it is back.
        count = max(_STEPS, math.ceil((_TURNS / 2 + 1) * longest))
    try:
        last, rate, extent, turns = _follow(map, box, params, start, count, along=flow)
    except (TypeError, ValueError):
        return False, False
    if flow:
        # Distances along a flow are the same as later points of the orbit.
        rate = rate[:, 1:]
    elif any(period(each, box) for each in window(map, box, params, last)):
        return False, False
    widest = extent.argmax(axis=1)
    rows = np.arange(len(start))
    extent = extent[rows, widest]
    alike = all(
        np.ptp(own) <= 1 + own.max() / 2
        for own in (extent[attractor == k] for k in np.unique(attractor))
    )
    cycle = np.isfinite(back)
    decided = _is_decided(rate[~cycle] * age, rate[~cycle] * (age + count / 2)).all()
    decided &= (rate[cycle] * age <= -_EXPONENTIAL).all()
    settled = bool(alike and decided and (turns[rows, widest] >= _TURNS).all())
    return settled, _is_neutral(rate[cycle], oldest)


def _is_neutral(rate: Float[np.ndarray, "orbits axes"], age: int) -> bool:
    """Check whether any distance stays the same within an age."""
    return bool((np.abs(rate * age) <= _NEUTRAL).any())


def _is_decided(
    before: Float[np.ndarray, "*shape"], now: Float[np.ndarray, "*shape"]
) -> Bool[np.ndarray, "*shape"]:
    """Check that changes of distances are exponential `before` they are measured, or neutral."""
    return (np.abs(before) >= _EXPONENTIAL) | (np.abs(now) <= _NEUTRAL)


def _apart(box: Box, first: np.ndarray, second: np.ndarray) -> float:
    return float(box.apart((first - second) / box.width).max())


def _from_last(box: Box, orbit: Any) -> Any:
    """Compute differences to the last point of orbits, in cells, the shorter way round."""
    return shortest(box, (orbit - orbit[..., -1:, :]) / box.width)


def window(
    map: Map, box: Box, params: Any, start: Float[np.ndarray, "orbits axes"]
) -> Float[np.ndarray, "orbits window axes"]:
    """Map each start repeatedly, and return the points."""
    return padded(lambda x: _window(map, box, params, x), (start,))


@functools.partial(jax.jit, static_argnames=("map", "box"))
def _window(map: Map, box: Box, params: Any, start: Any) -> Any:
    def step(x, _):  # type: ignore[no-untyped-def]
        x = box.wrapped(map(x, params))
        return x, x

    return jax.vmap(lambda x: jax.lax.scan(step, x, length=_WINDOW)[1])(start)


def _follow(
    map: Map,
    box: Box,
    params: Any,
    start: Float[np.ndarray, "orbits axes"],
    count: int,
    *,
    along: bool,
) -> tuple[np.ndarray, ...]:
    """Follow orbits; return last points, rates of distances, extents in cells and turning points.

    The `count` is of mappings, or of steps of a flow, and the rates are Lyapunov exponents for each
    of these. If `along` is true, the first rate is of the direction of a flow, and the others of
    directions across it. Smooth weights, which are zero at both ends, give averages over
    quasi-periodic orbits to many digits (Das, Saiki, Sander & Yorke 2017).
    """
    return _differentiated(
        lambda derive: padded(
            lambda start: _followed(map, box, derive, along, params, start, count), (start,)
        )
    )


@functools.partial(jax.jit, static_argnames=("map", "box", "derive", "along"))
def _followed(
    map: Map, box: Box, derive: Any, along: bool, params: Any, start: Any, count: Any
) -> Any:
    ahead = map.one if isinstance(map, Flow) else map
    width = jnp.asarray(box.width, start.dtype)
    least = jnp.finfo(start.dtype).tiny

    def orbit(origin):  # type: ignore[no-untyped-def]
        def step(k, state):  # type: ignore[no-untyped-def]
            x, frame, rate, total, place, rising, low, high, turns = state
            share = (jnp.asarray(k, x.dtype) + 0.5) / count
            weight = jnp.exp(-1 / (share * (1 - share)))
            rows = [*(frame @ derive(lambda y: ahead(y, params))(x).T)]
            x = box.wrapped(ahead(x, params))
            if along and isinstance(map, Flow):
                rows[0] = map.velocity(x, params)
            frame, size = [], []
            for row in rows:
                for other in frame:
                    row = row - (row @ other) * other
                size.append(jnp.maximum(jnp.sqrt(row @ row), least))
                frame.append(row / size[-1])
            new = shortest(box, (x - origin) / width).astype(x.dtype)
            up = new > place
            return (
                x,
                jnp.stack(frame),
                rate + weight * jnp.log(jnp.stack(size)),
                total + weight,
                new,
                up,
                jnp.minimum(low, new),
                jnp.maximum(high, new),
                turns + (up != rising).astype(turns.dtype),
            )

        zero = jnp.zeros_like(origin)
        frame = jnp.eye(origin.size, dtype=origin.dtype)
        turns = jnp.zeros(zero.shape, jnp.int32)
        begun = origin, frame, zero, zero[0], zero, zero > 0, zero, zero, turns
        x, _, rate, total, _, _, low, high, turns = jax.lax.fori_loop(0, count, step, begun)
        return x, rate / total, high - low, turns

    return jax.vmap(orbit)(start)
