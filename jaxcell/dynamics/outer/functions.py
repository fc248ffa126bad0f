"""Exponentials, logarithms and sines of intervals, computed from sums and products only.

Processors and libraries compute these functions differently, without guaranteed error bounds. The
ones here are short series of sums, products and quotients, whose number of roundings bounds the
error, whether or not a compiler fuses products and sums. The ends of an interval move outward by at
least this bound, in ulp (distances to the next 64-bit number) or, for the sine, as a number:

    exp    8 ulp: errors of 2 from the reduction by log 2, and of 4 from the series of degree 14
    log    8 ulp: errors of 2 from the quotient, 4 from the series of degree 25, 2 from the exponent
    sin    2^-49: errors of 3 x 2^-53 from the reduction by pi, 2^-52 from the series of degree 21
"""

import math

import jax.numpy as jnp
from jax import lax

from ..sines import polynomial
from .interval import (
    ONE,
    TINY,
    Interval,
    absolute,
    add,
    div,
    down,
    monotone,
    mul,
    neg,
    outward,
    sub,
    unless,
    up,
    within,
)


# log 2 as a sum; the first part has 32 bits, so that its multiples up to 2^20 are exact.
_LOG2 = 0.693147180369123816490, 1.90821492927058770002e-10
_SINE_ERROR = 2.0**-49
# Beyond this angle, the remainder by pi is not known.
_FARTHEST = 2.0**20
_TWO = Interval(*[2.0] * 2)


def exp(a: Interval) -> Interval:
    def at(x):  # type: ignore[no-untyped-def]
        # Beyond these ends the result is 0 or infinite in 64 bits.
        x = jnp.clip(x, -760.0, 720.0)
        twos = jnp.round(x / _LOG2[0])
        rest = (x - twos * _LOG2[0]) - twos * _LOG2[1]
        series = jnp.ones_like(x)
        for k in range(14, 0, -1):
            series = 1 + series * (rest / k)
        half = jnp.floor(twos / 2)
        value = series * _two_to(half) * _two_to(twos - half)
        return outward(value, value, 8)

    return within(monotone(at, a), 0.0, jnp.inf)


def log(a: Interval) -> Interval:
    """Enclose the logarithms of the positive numbers in an interval."""

    def at(x):  # type: ignore[no-untyped-def]
        bits = lax.bitcast_convert_type(jnp.clip(x, TINY, jnp.finfo(x.dtype).max), jnp.int64)
        # The significand is between the roots of 1/2 and of 2.
        exponent = (bits - 0x3FE6A09E667F3BCD) >> 52
        rest = lax.bitcast_convert_type(bits - (exponent << 52), jnp.float64)
        twos = exponent.astype(x.dtype)
        ratio = (rest - 1) / (rest + 1)
        series = jnp.zeros_like(x)
        for k in range(25, 0, -2):
            series = series * (ratio * ratio) + 2 / k
        value = twos * _LOG2[0] + (twos * _LOG2[1] + ratio * series)
        lower = jnp.where(x < TINY, -jnp.inf, down(value, 8))
        return Interval(lower, jnp.where(x < jnp.inf, up(value, 8), jnp.inf))

    return unless(a.upper < 0, monotone(at, a))


def sin(a: Interval) -> Interval:
    return _wave(a, 0.0)


def cos(a: Interval) -> Interval:
    return _wave(a, 0.5)


def tanh(a: Interval) -> Interval:
    def at(x):  # type: ignore[no-untyped-def]
        return sub(ONE, div(_TWO, add(exp(_point(2 * x)), ONE)))

    return within(monotone(at, a), -1.0, 1.0)


def sinh(a: Interval) -> Interval:
    return div(sub(exp(a), exp(neg(a))), _TWO)


def cosh(a: Interval) -> Interval:
    low, high = (div(add(exp(x), exp(neg(x))), _TWO) for x in map(_point, absolute(a)))
    return within(Interval(low.lower, high.upper), 1.0, jnp.inf)


def logistic(a: Interval) -> Interval:
    return within(div(ONE, add(ONE, exp(neg(a)))), 0.0, 1.0)


def power(a: Interval, exponent: Interval) -> Interval:
    """Enclose real powers. A base that may be negative gives the whole line."""
    return unless(a.lower < 0, exp(mul(exponent, log(a))))


def _wave(a: Interval, first: float) -> Interval:
    """Enclose `sin(x + first * pi)` for all `x` in an interval."""
    lower, upper = (polynomial(jnp.clip(x, -_FARTHEST, _FARTHEST), first) for x in a)
    low = jnp.minimum(lower, upper) - _SINE_ERROR
    high = jnp.maximum(lower, upper) + _SINE_ERROR
    # A crest or a trough counts as inside to 1e-9 of a turn, where the sine is 1 to 1e-16.
    turns = [x / (2 * math.pi) + first / 2 for x in a]
    crest, trough = (
        jnp.floor(turns[1] - shift + 1e-9) > jnp.floor(turns[0] - shift - 1e-9)
        for shift in (0.25, 0.75)
    )
    far = absolute(a).upper > _FARTHEST
    low = jnp.where(trough | far, -1.0, low)
    return within(Interval(low, jnp.where(crest | far, 1.0, high)), -1.0, 1.0)


def _point(x):  # type: ignore[no-untyped-def]
    return Interval(x, x)


def _two_to(exponent):  # type: ignore[no-untyped-def]
    bits = (exponent.astype(jnp.int64) + 1023) << 52
    return lax.bitcast_convert_type(bits, jnp.float64)
