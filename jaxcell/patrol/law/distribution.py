import dataclasses
import math
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.special import expit

from ...base.callbacks import call_back
from ...base.precision import require_x64
from ...base.wide import namespace, traced


# exp(-FAR) is near the smallest normal number; smaller probabilities count as 0.
FAR = 690.0
# Log-odds of the table of the quantile function: 0.16 apart in the middle, 32 at the ends.
_NODES = FAR * np.sinh(np.linspace(-6, 6, 257)) / math.sinh(6)
_MAX_STEPS = 100
# The last step in the log-odds has at most this size; the error is of the order of its square.
_STEP = 1e-8
_ROUNDING = 4e-16
# Below this, the series of expm1(x) / x is exact with these coefficients, also its derivatives.
_SMALL = 0.03
_SERIES = [1 / math.factorial(n) for n in range(9, 0, -1)]

_Parameter: TypeAlias = Float[Any, "*#laws"] | float | int


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Gld:
    """A generalized lambda distribution in the form of Freimer, Mudholkar, Kollia and Lin (1988).

    The distribution is defined by its quantile function (Alam 2018, Eq. 4.10)

    `Q(u) = l1 + ((u**l3 - 1) / l3 - ((1 - u)**l4 - 1) / l4) / l2`.

    A shape of 0 stands for the limit, `log(u)` or `log(1 - u)`. With shapes 0 and 0 it is the
    logistic distribution, with 1 and 1 a uniform distribution. If the four parameters are arrays
    `[laws, 1]`, they define several distributions, and methods return arrays `[laws, values]`.

    `log_odds`, `cdf` and `pdf` invert `Q` with Newton's method within a bracket. The unknown is the
    log-odds `log(u / (1 - u))`, so that neither tail loses digits. All methods work under `jit`,
    `vmap` and `grad`, also with traced parameters.

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
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if isinstance(value, int):
                object.__setattr__(self, field.name, float(value))
            elif isinstance(value, float) and not math.isfinite(value):
                raise ValueError(f"{field.name}: expected a finite number, got {value}")
        if isinstance(self.l2, float) and self.l2 <= 0:
            raise ValueError(f"l2: expected a positive number, got {self.l2}")

    @property
    def support(self) -> tuple[float, float]:
        """The ends of the interval of possible values, infinite where the shape is at most 0."""
        low, high = self.quantile([0.0, 1.0]).tolist()
        return low, high

    @np.errstate(all="ignore")
    def quantile(self, u: Any) -> Float[Any, "*values"]:
        """Return the quantile of probability `u`; NaN if `u` is outside of [0, 1]."""
        xp = namespace(self, u)
        u = xp.asarray(u, np.float64)
        z = _power(xp.log(u), self.l3) - _power(xp.log1p(-u), self.l4)
        return xp.asarray(self.l1 + z / self.l2)

    @np.errstate(all="ignore")
    def log_odds(
        self, x: Any, near: Float[np.ndarray, "*near"] | None = None
    ) -> Float[Any, "*values"]:
        """Compute the logarithm of `cdf(x) / (1 - cdf(x))`; infinite outside of the support.

        If approximate log-odds `near` are given, Newton's method starts from them.
        """
        xp = namespace(self, x)
        z = xp.asarray((xp.asarray(x, np.float64) - self.l1) * self.l2)
        if xp is jnp:
            return _inverse(*jnp.broadcast_arrays(z, self.l3, self.l4))
        log_odds = _invert(np.atleast_1d(z), self.l3, self.l4, near)
        return log_odds if z.ndim else log_odds[..., 0]

    def cdf(self, x: Any) -> Float[Any, "*values"]:
        """Compute the probability that a value does not exceed `x`."""
        log_odds = self.log_odds(x)
        return jax.nn.sigmoid(log_odds) if traced(log_odds) else np.asarray(expit(log_odds))

    def pdf(self, x: Any) -> Float[Any, "*values"]:
        """Compute the probability density at `x`; 0 outside of the support."""
        xp = namespace(self, x)
        return xp.asarray(xp.exp(self.log_density(self.log_odds(x))))

    @np.errstate(all="ignore")
    def log_density(self, log_odds: Any) -> Float[Any, "*values"]:
        """Compute the logarithm of the density from log-odds; -inf if they are infinite."""
        xp = namespace(self, log_odds)
        outside = xp.isinf(log_odds)
        # A derivative needs finite numbers outside of the support, too.
        log_u, log_v = _logs(xp.where(outside, 0.0, log_odds))
        log_slope = xp.logaddexp(self.l3 * log_u + log_v, self.l4 * log_v + log_u)
        density = xp.log(self.l2) + log_u + log_v - log_slope
        return xp.where(outside, -np.inf, density)


@np.errstate(all="ignore")
def log_probability(lower: Any, upper: Any) -> Float[np.ndarray, "*values"]:
    """Compute the logarithm of the probability of an interval from the log-odds at its ends.

    With `u` and `v` the distribution function at the lower and the upper end, `v - u = v (1 - u) (1
    - exp(lower - upper))`, which loses no digits in either tail.
    """
    logarithm = _logs(upper)[0] + _logs(lower)[1] + np.log(-np.expm1(np.subtract(lower, upper)))
    return np.where(np.greater_equal(lower, upper), -np.inf, logarithm)


@np.errstate(all="ignore")
def standard_quantile(log_odds: Any, l3: _Parameter, l4: _Parameter) -> Any:
    """Compute the quantile for given log-odds, with location 0 and scale 1."""
    log_u, log_v = _logs(log_odds)
    return _power(log_u, l3) - _power(log_v, l4)


def _logs(log_odds: Any) -> tuple[Any, Any]:
    """Compute the logarithms of `u` and `1 - u` from the log-odds of `u`."""
    if traced(log_odds):
        return jax.nn.log_sigmoid(log_odds), jax.nn.log_sigmoid(-log_odds)
    small = np.log1p(np.exp(-np.abs(log_odds)))
    return np.minimum(log_odds, 0) - small, -np.maximum(log_odds, 0) - small


def _power(log_u: Any, shape: _Parameter) -> Any:
    """Compute `(u**shape - 1) / shape`."""
    if not traced(log_u, shape):
        return np.where(shape == 0, log_u, np.expm1(shape * log_u) / shape)
    x = jnp.where(jnp.isfinite(log_u), log_u, 0.0) * shape
    few = jnp.abs(x) < _SMALL
    ratio = jnp.where(
        few, jnp.polyval(jnp.array(_SERIES), x), jnp.expm1(x) / jnp.where(few, 1.0, x)
    )
    # At u = 0, the power is 0 or infinite.
    end = jnp.where(shape > 0, -1 / jnp.where(shape > 0, shape, 1.0), -jnp.inf)
    return jnp.where(jnp.isneginf(log_u), end, log_u * ratio)


@jax.custom_jvp
def _inverse(z: Any, l3: Any, l4: Any) -> Float[Any, "*values"]:
    """Find log-odds for arrays of one shape, of which JAX traces at least one."""
    require_x64("Gld")
    shape = jax.ShapeDtypeStruct(z.shape, np.float64)
    return call_back(_inverse_on_host, shape, z, l3, l4)


@np.errstate(all="ignore")
def _inverse_on_host(*arrays: Any) -> Float[np.ndarray, "*values"]:
    z, l3, l4 = np.broadcast_arrays(*arrays)
    column, *shapes = (array.reshape(-1, 1) for array in (z, l3, l4))
    return _invert(column, shapes[0], shapes[1], None).reshape(z.shape)


@_inverse.defjvp
def _change_of_inverse(numbers: Any, changes: Any) -> tuple[Any, Any]:
    log_odds = _inverse(*numbers)
    inside = jnp.isfinite(log_odds)
    at = (jnp.where(inside, log_odds, 0.0), *numbers[1:])
    slope = jax.jvp(standard_quantile, at, (jnp.ones_like(log_odds), *map(jnp.zeros_like, at[1:])))
    rise = jax.jvp(standard_quantile, at, (jnp.zeros_like(log_odds), *changes[1:]))
    return log_odds, jnp.where(inside, (changes[0] - rise[1]) / slope[1], 0.0)


def _invert(
    z: Float[np.ndarray, "*values"],
    l3: _Parameter,
    l4: _Parameter,
    near: Float[np.ndarray, "*near"] | None,
) -> Float[np.ndarray, "*laws_and_values"]:
    """Find the log-odds at which the standard quantile function is `z`.

    A table of the function brackets each solution; if approximate solutions `near` are given, the
    bracket is the whole table. A Newton step that would leave the bracket goes to its middle
    instead. Beyond the table, the log-odds are infinite.
    """
    nodes = _NODES if near is None else _NODES[[0, -1]]
    table = standard_quantile(nodes, l3, l4)
    inside = (z > table[..., :1]) & (z < table[..., -1:])
    # Values outside of the table are replaced by 0, which has a solution, so that the steps end.
    aim = np.where(inside, z, 0.0)
    rows = zip(
        table.reshape(-1, nodes.size), aim.reshape(table.size // nodes.size, -1), strict=True
    )
    after = np.array([np.searchsorted(known, values) for known, values in rows]).reshape(aim.shape)
    low, high = nodes[after - 1], nodes[after]
    y = (low + high) / 2 if near is None else np.clip(near, low, high)
    for _ in range(_MAX_STEPS):
        log_u, log_v = _logs(y)
        lower, upper = _power(log_u, l3), _power(log_v, l4)
        excess = lower - upper - aim
        low, high = np.where(excess <= 0, y, low), np.where(excess >= 0, y, high)
        change = -excess / (np.exp(l3 * log_u + log_v) + np.exp(l4 * log_v + log_u))
        moved = y + change
        last = np.abs(change) <= _STEP * np.maximum(1.0, np.abs(y))
        # Where the function is flat, rounding causes steps that never become small.
        settled = np.abs(excess) <= -_ROUNDING * (lower + upper)
        safe = np.where((moved >= low) & (moved <= high), moved, (low + high) / 2)
        y = np.where(last, moved, np.where(settled, y, safe))
        if (last | settled).all():
            break
    return np.where(inside, y, np.where(np.isnan(z), z, np.copysign(np.inf, z)))
