"""Intervals whose ends are rounded outward, so that they enclose every exact value.

Processors round a sum, a difference, a product or a square root to the nearest 64-bit number. The
end of an interval then moves outward to the next number. The move is an operation on integers, so
that no compiler fuses a product with the sum after it, or reorders sums. Two cases need more. A
division by a constant may become a product with its reciprocal, so the ends of a quotient move
three times. Processors may replace numbers below 2^-1022 by 0, so an end that is nearer to 0 than
2^-1000 moves to 2^-1000.
"""

import functools
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax


TINY = 2.0**-1000
"""Magnitude below which results may have lost all digits."""
HUGE = 2.0**1000
"""Magnitude above which reciprocals may be replaced by 0."""
_INFINITY = 0x7FF0000000000000


class Interval(NamedTuple):
    """Intervals, as arrays of lower and upper ends. For Boolean values, `False` is below `True`."""

    lower: Any
    upper: Any


ONE = Interval(*[1.0] * 2)
LINE = Interval(-math.inf, math.inf)


def point(value: Any) -> Interval:
    """Convert finite numbers to intervals of one point each; NaN becomes the whole line."""
    if isinstance(value, jax.core.Tracer) or np.isfinite(value).all():
        value = jnp.asarray(value)
        return Interval(value, value)
    # An infinite constant is any number beyond the largest one.
    largest, none = np.finfo(np.float64).max, np.isnan(value)
    lower = np.where(none, -np.inf, np.minimum(value, largest))
    upper = np.where(none, np.inf, np.maximum(value, -largest))
    return Interval(jnp.asarray(lower), jnp.asarray(upper))


def up(x: Any, numbers: int = 1) -> Any:
    """Move a number up to the next 64-bit number, `numbers` times, but not beyond infinity."""
    bits = lax.bitcast_convert_type(x, jnp.int64)
    moved = jnp.where(bits < 0, bits - numbers, jnp.minimum(bits + numbers, _INFINITY))
    moved = lax.bitcast_convert_type(moved, jnp.float64)
    return jnp.where(jnp.abs(x) < TINY, TINY, moved)


def down(x: Any, numbers: int = 1) -> Any:
    """Move a number down to the next 64-bit number, `numbers` times."""
    return -up(-x, numbers)


def outward(lower: Any, upper: Any, numbers: int = 1) -> Interval:
    """Move the lower end down and the upper end up, each by `numbers` floating-point numbers."""
    return Interval(down(lower, numbers), up(upper, numbers))


def hull(parts: Sequence[Interval]) -> Interval:
    """Return the smallest interval that contains all the given intervals."""
    return Interval(_least([a.lower for a in parts]), _largest([a.upper for a in parts]))


def within(a: Interval, lower: float, upper: float) -> Interval:
    """Clip an interval to the range of a function, from `lower` to `upper`."""
    return Interval(jnp.clip(a.lower, lower, upper), jnp.clip(a.upper, lower, upper))


def where(mask: Any, a: Interval, b: Interval) -> Interval:
    """Choose `a` where `mask` is true, and `b` elsewhere; the mask is an array, not an interval."""
    return Interval(jnp.where(mask, a.lower, b.lower), jnp.where(mask, a.upper, b.upper))


def unless(undefined: Any, a: Interval) -> Interval:
    """Replace intervals by the whole line where the mask `undefined` is true."""
    return where(undefined, LINE, a)


def monotone(function: Callable[[Any], Interval], a: Interval) -> Interval:
    """Enclose an increasing function on an interval; `function(x)` encloses its value at `x`."""
    if a.lower is a.upper:
        return function(a.lower)
    return Interval(function(a.lower).lower, function(a.upper).upper)


def neg(a: Interval) -> Interval:
    return Interval(-a.upper, -a.lower)


def add(a: Interval, b: Interval) -> Interval:
    return outward(a.lower + b.lower, a.upper + b.upper)


def sub(a: Interval, b: Interval) -> Interval:
    return outward(a.lower - b.upper, a.upper - b.lower)


def mul(a: Interval, b: Interval) -> Interval:
    products = [_unlimited(x * y) for x in _ends(a) for y in _ends(b)]
    return outward(_least(products), _largest(products))


def div(a: Interval, b: Interval) -> Interval:
    near, far = _least([jnp.abs(x) for x in b]), _largest([jnp.abs(x) for x in b])
    unsafe = (b.lower <= 0) & (b.upper >= 0) | (near < TINY) | (near > HUGE)
    unsafe |= (far > HUGE) & (far < jnp.inf)
    quotients = [_unlimited(x / jnp.where(unsafe, 1.0, y)) for x in _ends(a) for y in _ends(b)]
    return unless(unsafe, outward(_least(quotients), _largest(quotients), 3))


def square(a: Interval) -> Interval:
    low, high = absolute(a)
    return within(outward(low * low, high * high), 0.0, jnp.inf)


def absolute(a: Interval) -> Interval:
    through = (a.lower < 0) & (a.upper > 0)
    ends = jnp.abs(a.lower), jnp.abs(a.upper)
    return Interval(jnp.where(through, 0.0, _least(ends)), _largest(ends))


def power(a: Interval, exponent: int) -> Interval:
    """Enclose `x**exponent` for an integer exponent and all `x` in an interval, using products."""
    if exponent < 0:
        return div(ONE, power(a, -exponent))
    odd = exponent % 2 == 1
    # A power grows with `a`, or with its absolute value; each end is multiplied as a point.
    whole = monotone(lambda x: _repeated(Interval(x, x), exponent), a if odd else absolute(a))
    return whole if odd else within(whole, 0.0, jnp.inf)


def sqrt(a: Interval) -> Interval:
    """Enclose the square roots of the nonnegative numbers in an interval."""
    low, high = jnp.sqrt(jnp.maximum(a.lower, 0.0)), jnp.sqrt(jnp.maximum(a.upper, 0.0))
    return unless(a.upper < 0, within(outward(low, high, 2), 0.0, jnp.inf))


def total(a: Interval, axis: int) -> Interval:
    """Sum intervals along an axis with pairwise summation."""
    while (count := a.lower.shape[axis]) > 1:
        half = count // 2
        first, second, rest = (
            Interval(*(lax.slice_in_dim(x, start, stop, axis=axis) for x in a))
            for start, stop in ((0, half), (half, 2 * half), (2 * half, count))
        )
        pairs = zip(add(first, second), rest, strict=True)
        a = Interval(*(jnp.concatenate(pair, axis) for pair in pairs))
    if not count:
        return point(jnp.zeros(a.lower.shape[:axis] + a.lower.shape[axis + 1 :]))
    return Interval(*(jnp.squeeze(x, axis) for x in a))


def _repeated(a: Interval, exponent: int) -> Interval:
    result = None
    while exponent:
        if exponent % 2:
            result = a if result is None else mul(result, a)
        exponent //= 2
        a = mul(a, a) if exponent else a
    return point(jnp.ones_like(a.lower)) if result is None else result


def _ends(a: Interval) -> tuple[Any, ...]:
    return (a.lower,) if a.lower is a.upper else tuple(a)


def _unlimited(x: Any) -> Any:
    """Replace NaN, which is the result of `0 * inf` or `inf / inf`, by 0."""
    return jnp.where(jnp.isnan(x), 0.0, x)


def _least(values: Sequence[Any]) -> Any:
    return functools.reduce(jnp.minimum, values)


def _largest(values: Sequence[Any]) -> Any:
    return functools.reduce(jnp.maximum, values)
