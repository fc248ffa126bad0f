import dataclasses
import functools
import math
from typing import Any

import jax
import jax.numpy as jnp
import jax.typing
import numpy as np
from jaxtyping import Array, Bool, Float

from ...base.precision import require_x64


# exp(-FAR) is near the smallest normal number. Probabilities below it count as 0.
FAR = 690.0
# Log-odds of the table of the quantile function: 0.16 apart in the middle, 32 at the ends.
NODES = FAR * np.sinh(np.linspace(-6, 6, 257)) / math.sinh(6)
_MAX_STEPS = 100
# Steps in the log-odds end at this size, because the error is of the order of its square.
_STEP = 1e-12
ROUNDING = 4e-16
# Below this, expm1(t) / t is summed as a series: its derivative, as written, would cancel.
_SMALL = 0.25
_SERIES = [1 / math.factorial(k + 1) for k in range(12)]

_Parameter = float | int | Float[Array, ""]


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Gld:
    """A generalized lambda distribution in the parameters of Freimer, Mudholkar, Kollia and Lin.

    It is defined by its quantile function (Alam 2018, Eq. 4.10)

    `Q(u) = l1 + ((u**l3 - 1) / l3 - ((1 - u)**l4 - 1) / l4) / l2`.

    A shape of 0 stands for the limit, `log(u)` or `log(1 - u)`. With shapes 0 and 0 it is the
    logistic distribution, with 1 and 1 a uniform one. It is a pytree of four numbers; give it
    arrays of them under `jax.vmap`.

    Its other functions invert `Q` by Newton's method in a bracket, in the log-odds `log(u / (1 -
    u))`, so that neither tail loses digits. All have exact derivatives in the parameters and in
    `x`, by the implicit function theorem.

    The logistic distribution:

        >>> from jaxcell import patrol
        >>> law = patrol.Gld(0.0, 1.0, 0.0, 0.0)
        >>> float(law.quantile(0.5)), round(float(law.cdf(1.0)), 6)
        (0.0, 0.731059)
    """

    l1: _Parameter
    "Location."
    l2: _Parameter
    "Reciprocal of the scale, positive."
    l3: _Parameter
    "Shape of the lower tail: heavy if negative, bounded if positive."
    l4: _Parameter
    "Shape of the upper tail."

    def __post_init__(self) -> None:
        """**Raises:** `ValueError` for plain numbers that do not make a distribution."""
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if isinstance(value, int):
                object.__setattr__(self, field.name, float(value))
            elif isinstance(value, float) and not math.isfinite(value):
                raise ValueError(f"{field.name}: expected a finite number, got {value}")
        if isinstance(self.l2, float) and self.l2 <= 0:
            raise ValueError(f"l2: expected a positive number, got {self.l2}")

    @property
    def support(self) -> tuple[Float[Array, ""], Float[Array, ""]]:
        """The ends of the interval that holds all values; infinite for shapes up to 0."""
        return self.quantile(0.0), self.quantile(1.0)

    @jax.jit
    def quantile(self, u: jax.typing.ArrayLike) -> Float[Array, "*shape"]:
        """Return the value that is not exceeded with probability `u`; NaN outside of [0, 1]."""
        u = _numbers(u, "Gld.quantile")
        inside = (u > 0) & (u < 1)
        middle = jnp.where(inside, jnp.maximum(u, np.finfo(np.float64).tiny), 0.5)
        log_odds = jnp.log(middle) - jnp.log1p(-middle)
        x = self.l1 + _standard_quantile(log_odds, self.l3, self.l4) / self.l2
        x = jnp.where(u == 0, self.l1 - _end(self.l3) / self.l2, x)
        x = jnp.where(u == 1, self.l1 + _end(self.l4) / self.l2, x)
        return jnp.where((u >= 0) & (u <= 1), x, jnp.nan)

    @jax.jit
    def log_odds(self, x: jax.typing.ArrayLike) -> Float[Array, "*shape"]:
        """Compute the logarithm of `cdf(x) / (1 - cdf(x))`; infinite outside of the support."""
        x = _numbers(x, "Gld.log_odds")
        y, _ = self._invert(x)
        return jnp.where(y >= FAR, jnp.inf, jnp.where(y <= -FAR, -jnp.inf, y))

    @jax.jit
    def cdf(self, x: jax.typing.ArrayLike) -> Float[Array, "*shape"]:
        """Compute the probability that a value does not exceed `x`."""
        return jax.nn.sigmoid(self.log_odds(x))

    @jax.jit
    def pdf(self, x: jax.typing.ArrayLike) -> Float[Array, "*shape"]:
        """Compute the probability density at `x`; 0 outside of the support."""
        return jnp.exp(self.log_pdf(x))

    @jax.jit
    def log_pdf(self, x: jax.typing.ArrayLike) -> Float[Array, "*shape"]:
        """Compute the logarithm of the probability density at `x`."""
        x = _numbers(x, "Gld.log_pdf")
        y, inside = self._invert(x)
        y = jnp.where(inside, y, 0.0)
        log_u, log_v = _logs(y)
        density = jnp.log(self.l2) + log_u + log_v - _log_slope(log_u, log_v, self.l3, self.l4)
        return jnp.where(inside, density, jnp.where(jnp.isnan(x), jnp.nan, -jnp.inf))

    @jax.jit
    def log_probability(
        self, lower: jax.typing.ArrayLike, upper: jax.typing.ArrayLike
    ) -> Float[Array, "*shape"]:
        """Compute the logarithm of the probability of `lower < X <= upper`.

        With `u` and `v` the distribution function at the ends, it is computed from their log-odds
        as `v - u = v (1 - u) (1 - exp(odds(u) - odds(v)))`, which cancels in neither tail.
        """
        ends = jnp.broadcast_arrays(
            *(_numbers(end, "Gld.log_probability") for end in (lower, upper))
        )
        below, above = self._invert(jnp.stack(ends))[0]
        gap = above - below
        positive = gap > 0
        share = jnp.log(-jnp.expm1(-jnp.where(positive, gap, 1.0)))
        logarithm = _logs(above)[0] + _logs(below)[1] + share
        return jnp.where(positive, logarithm, jnp.where(jnp.isnan(gap), jnp.nan, -jnp.inf))

    def _invert(
        self, x: Float[Array, "*shape"]
    ) -> tuple[Float[Array, "*shape"], Bool[Array, "*shape"]]:
        """Return the log-odds, clipped to `FAR` in modulus, and a mask of the unclipped ones."""
        z = jnp.asarray((x - self.l1) * self.l2)
        y = _solve(z, jnp.asarray(self.l3, z.dtype), jnp.asarray(self.l4, z.dtype))
        return y, jnp.abs(y) < FAR


def _standard_quantile(
    log_odds: Float[Array, "*shape"], l3: _Parameter, l4: _Parameter
) -> Float[Array, "*shape"]:
    """Compute the quantile function of the law with location 0 and scale 1 at log-odds."""
    log_u, log_v = _logs(log_odds)
    return _power(log_u, l3) - _power(log_v, l4)


def _numbers(x: Any, what: str) -> Float[Array, "*shape"]:
    require_x64(what)
    return jnp.asarray(x, jnp.float64)


def _logs(y: Float[Array, "*shape"]) -> tuple[Float[Array, "*shape"], Float[Array, "*shape"]]:
    """Compute the logarithms of `u` and `1 - u` from log-odds."""
    # The derivatives of abs and minimum at 0 would not add up.
    above = y > 0
    small = jnp.log1p(jnp.exp(jnp.where(above, -y, y)))
    return jnp.where(above, 0.0, y) - small, jnp.where(above, -y, 0.0) - small


def _power(log_u: Float[Array, "*shape"], shape: _Parameter) -> Float[Array, "*shape"]:
    """Compute `(u**shape - 1) / shape`, smooth in the shape at 0."""
    t = shape * log_u
    small = jnp.abs(t) < _SMALL
    near = jnp.where(small, t, 0.0)
    series = functools.reduce(lambda total, c: total * near + c, reversed(_SERIES), near * 0)
    far = jnp.where(small, 1.0, t)
    return log_u * jnp.where(small, series, jnp.expm1(far) / far)


def _log_slope(
    log_u: Float[Array, "*shape"], log_v: Float[Array, "*shape"], l3: _Parameter, l4: _Parameter
) -> Float[Array, "*shape"]:
    """Compute the logarithm of the derivative of the quantile function in the log-odds."""
    return jnp.logaddexp(l3 * log_u + log_v, l4 * log_v + log_u)


def _end(shape: _Parameter) -> Float[Array, ""]:
    """Return the distance from the location to an end of the support, for scale 1."""
    bounded = jnp.asarray(shape) > 0
    return jnp.where(bounded, 1 / jnp.where(bounded, shape, 1.0), jnp.inf)


@jax.custom_jvp
def _solve(
    z: Float[Array, "*shape"], l3: Float[Array, ""], l4: Float[Array, ""]
) -> Float[Array, "*shape"]:
    """Find the log-odds at which the standard quantile function is `z`.

    A table of that function brackets each solution. A step of Newton's method that would leave the
    bracket is replaced by its middle. Beyond the table, its end is returned.
    """
    nodes = jnp.asarray(NODES)
    table = _standard_quantile(nodes, l3, l4)
    inside = (z > table[0]) & (z < table[-1])
    # Elements outside of the table aim at 0, which has a solution, or the loop would go on.
    aim = jnp.where(inside, z, 0.0)
    after = jnp.clip(jnp.searchsorted(table, aim), 1, nodes.size - 1)
    low, high = nodes[after - 1], nodes[after]

    def unfinished(state):  # type: ignore[no-untyped-def]
        step, _, _, _, moving = state
        return (step < _MAX_STEPS) & jnp.any(moving)

    def newton(state):  # type: ignore[no-untyped-def]
        step, y, low, high, _ = state
        log_u, log_v = _logs(y)
        from_low, from_high = _power(log_u, l3), _power(log_v, l4)
        excess = from_low - from_high - aim
        low, high = jnp.where(excess <= 0, y, low), jnp.where(excess >= 0, y, high)
        change = -excess * jnp.exp(-_log_slope(log_u, log_v, l3, l4))
        last = jnp.abs(change) <= _STEP * jnp.maximum(1.0, jnp.abs(y))
        # Where the function is flat, rounding makes steps that never become small.
        settled = jnp.abs(excess) <= ROUNDING * (jnp.abs(from_low) + jnp.abs(from_high))
        moved = y + change
        safe = jnp.where((moved >= low) & (moved <= high), moved, (low + high) / 2)
        y = jnp.where(last, moved, jnp.where(settled, y, safe))
        return step + 1, y, low, high, ~last & ~settled

    first = (jnp.int32(0), (low + high) / 2, low, high, jnp.ones(z.shape, bool))
    _, y, _, _, _ = jax.lax.while_loop(unfinished, newton, first)
    y = jnp.where(inside, y, jnp.where(z > 0, FAR, -FAR))
    return jnp.where(jnp.isnan(z), jnp.nan, y)


@_solve.defjvp
def _solve_jvp(primals, tangents):  # type: ignore[no-untyped-def]
    z, l3, l4 = primals
    y = _solve(z, l3, l4)
    inside = jnp.abs(y) < FAR
    # Beyond the table derivatives overflow, and 0 times infinity is not 0.
    middle = jnp.where(inside, y, 0.0)
    quantile = functools.partial(_standard_quantile, middle)
    _, by_shape = jax.jvp(quantile, (l3, l4), tangents[1:])
    per_z = jnp.where(inside, jnp.exp(-_log_slope(*_logs(middle), l3, l4)), 0.0)
    return y, (tangents[0] - by_shape) * per_z
