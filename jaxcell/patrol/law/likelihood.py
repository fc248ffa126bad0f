"""Likelihood of samples under generalized lambda distributions, with derivatives.

A law is given here by four numbers: the log-odds `a` and `b` of its distribution function at two
points, and its shapes. Let `S` be the quantile function with location 0 and scale 1, in the
log-odds. The log-odds `y` of the law at a share `r` of the distance between the points solve

`S(y) = (1 - r) S(a) + r S(b)`,

and this equation, differentiated, gives their derivatives in the numbers.

NumPy is used because compiling the derivatives of [`jaxcell.patrol.Gld`][] takes longer than many
fits.
"""

import dataclasses
import math

import numpy as np
from jaxtyping import Float, Int
from scipy.special import expit

from .distribution import FAR, NODES, ROUNDING, Gld


_MAX_STEPS = 100
# Steps in the log-odds end at this size, because the error is of the order of its square.
_STEP = 1e-8
# Below this, the derivatives of expm1(t) / t are summed as series; their formula would cancel.
_SMALL = 0.5
_FIRST = [k / math.factorial(k + 1) for k in range(1, 16)]
_SECOND = [k * (k - 1) / math.factorial(k + 1) for k in range(2, 17)]


def law_through(numbers: Float[np.ndarray, "4"], point: Float[np.ndarray, "2"]) -> Gld:
    """Return the law with given log-odds at two points and given shapes."""
    low, high = _quantile(numbers[:2], _shapes(numbers))[0]
    l2 = (high - low) / (point[1] - point[0])
    return Gld(*(float(x) for x in (point[0] - low / l2, l2, *numbers[2:])))


def distribution_function(law: Gld, x: Float[np.ndarray, "values"]) -> Float[np.ndarray, "values"]:
    """Compute the distribution function of a law in NumPy, without compilation."""
    return expit(_solve((x - law.l1) * law.l2, np.array([[law.l3], [law.l4]])))


def log_odds(
    numbers: Float[np.ndarray, "*laws 4"],
    point: Float[np.ndarray, "*#laws 2"],
    x: Float[np.ndarray, "values"],
) -> Float[np.ndarray, "*laws values"]:
    """Compute the log-odds of laws at other points, clipped to `FAR` in modulus."""
    shapes = _shapes(numbers)
    low, high = np.split(_quantile(numbers[..., :2], shapes)[0], 2, axis=-1)
    along = (x - point[..., :1]) / (point[..., 1:] - point[..., :1])
    return _solve((1 - along) * low + along * high, shapes)


@dataclasses.dataclass(frozen=True, eq=False)
class Likelihood:
    """The likelihood of samples as a function of the law."""

    x: Float[np.ndarray, "values"]
    "The values at which the distribution function is needed."
    weight: Float[np.ndarray, "samples"]
    "The share of each distinct sample."
    ends: Int[np.ndarray, "2 samples"] | None
    "The indices in `x` of the ends of each sample; `None` if samples are not intervals."

    @staticmethod
    def of(
        value: Float[np.ndarray, "samples"], count: Int[np.ndarray, "samples"], censored: bool
    ) -> "Likelihood":
        """Return the likelihood of distinct samples, of intervals of length 1 if censored."""
        weight = count / count.sum()
        if not censored:
            return Likelihood(value, weight, None)
        # Most intervals touch the next.
        x, ends = np.unique([value - 0.5, value + 0.5], return_inverse=True)
        return Likelihood(x, weight, ends.reshape(2, -1))

    def loss(
        self, numbers: Float[np.ndarray, "*laws 4"], point: Float[np.ndarray, "*laws 2"]
    ) -> Float[np.ndarray, "*laws"]:
        """Compute the negative mean log-likelihood by law, infinite if a sample has no chance."""
        with np.errstate(all="ignore"):
            return self._loss(numbers, point, log_odds(numbers, point, self.x))

    def expansion(
        self,
        numbers: Float[np.ndarray, "4"],
        point: Float[np.ndarray, "2"],
        below: float = math.inf,
    ) -> tuple[float, Float[np.ndarray, "4"], Float[np.ndarray, "4 4"]]:
        """Compute the loss and its two derivatives, NaN unless the loss is below `below`."""
        with np.errstate(all="ignore"):
            y = log_odds(numbers, point, self.x)
            loss = float(self._loss(numbers, point, y))
            if not loss < below:
                return loss, np.full(4, np.nan), np.full((4, 4), np.nan)
            at = _Local.of(y, _shapes(numbers))
            inverse = _Inverse.of(at, numbers, point, self.x)
            if self.ends is None:
                slope, hessian = self._density(at, inverse, numbers[2:])
            else:
                slope, hessian = self._probability(at, inverse, *self.ends)
        return loss, -slope, -hessian

    def _loss(
        self,
        numbers: Float[np.ndarray, "*laws 4"],
        point: Float[np.ndarray, "*laws 2"],
        y: Float[np.ndarray, "*laws values"],
    ) -> Float[np.ndarray, "*laws"]:
        shapes = _shapes(numbers)
        _, (log_u, log_v), _ = _quantile(y, shapes)
        if self.ends is not None:
            # With u and v the distribution function at the ends, v - u is
            # v (1 - u) (1 - exp(odds(u) - odds(v))), which does not cancel in either tail.
            low, high = self.ends
            share = np.log(-np.expm1(y[..., low] - y[..., high]))
            return np.asarray(-(log_u[..., high] + log_v[..., low] + share) @ self.weight)
        wide = np.diff(_quantile(numbers[..., :2], shapes)[0])
        scale = np.log(wide / np.diff(point))[..., 0]
        log_slope, _ = _log_slope(np.stack([log_u, log_v]), shapes)
        loss = -scale - (log_u + log_v - log_slope) @ self.weight
        return np.where(np.abs(y).max(axis=-1) < FAR, loss, math.inf)

    def _density(
        self, at: "_Local", inverse: "_Inverse", shapes: Float[np.ndarray, "2"]
    ) -> tuple[Float[np.ndarray, "4"], Float[np.ndarray, "4 4"]]:
        """Compute derivatives of the mean of `log(u v / S'(y))` plus `log(S(b) - S(a))`."""
        u, v = at.chance
        both = self.weight * at.share
        by_y = self.weight * (v - u - at.change[0])
        slope = inverse.slope @ by_y
        slope[2:] -= at.change[1:] @ self.weight
        # S' is a sum of two exponential functions.
        apart = inverse.slope * (at.rise[0] - at.rise[1])
        apart[2] += at.logs[0]
        apart[3] -= at.logs[1]
        bent = u * v * ((shapes + 1) @ both - 2 * self.weight)
        hessian = inverse.second(by_y) + (inverse.slope * bent) @ inverse.slope.T
        hessian -= (apart * (both[0] * at.share[1])) @ apart.T
        mixed = inverse.slope @ np.stack([both[0] * v, -both[1] * u], axis=1)
        hessian[:, 2:] -= mixed
        hessian[2:] -= mixed.T
        width = inverse.end.value[1] - inverse.end.value[0]
        change = (inverse.end_slope[1] - inverse.end_slope[0]) / width
        hessian += (inverse.end_second[1] - inverse.end_second[0]) / width
        return slope + change, hessian - np.outer(change, change)

    def _probability(
        self,
        at: "_Local",
        inverse: "_Inverse",
        low: Int[np.ndarray, "samples"],
        high: Int[np.ndarray, "samples"],
    ) -> tuple[Float[np.ndarray, "4"], Float[np.ndarray, "4 4"]]:
        """Compute derivatives of the mean logarithm of the probability between the ends."""
        (u, v), weight = at.chance, self.weight
        odds = 1 / np.expm1(at.y[high] - at.y[low])
        near, cross = weight * odds, weight * odds * (1 + odds)

        def at_ends(
            lower: Float[np.ndarray, "samples"], upper: Float[np.ndarray, "samples"]
        ) -> Float[np.ndarray, "values"]:
            return np.bincount(low, lower, u.size) + np.bincount(high, upper, u.size)

        by_y = at_ends(-weight * u[low] - near, weight * v[high] + near)
        twice = at_ends(-weight * (u * v)[low] - cross, -weight * (u * v)[high] - cross)
        mixed = (inverse.slope[:, low] * cross) @ inverse.slope[:, high].T
        hessian = inverse.second(by_y) + (inverse.slope * twice) @ inverse.slope.T
        return inverse.slope @ by_y, hessian + mixed + mixed.T


@dataclasses.dataclass(frozen=True, eq=False)
class _Local:
    """The standard quantile function near log-odds `y`, with derivatives in `y` and the shapes.

    With `u` the distribution function and `v = 1 - u`, its derivative in `y` is `exp(l3 log(u) +
    log(v)) + exp(l4 log(v) + log(u))`.
    """

    y: Float[np.ndarray, "values"]
    value: Float[np.ndarray, "values"]
    logs: Float[np.ndarray, "2 values"]
    "The logarithms of `u` and `v`."
    chance: Float[np.ndarray, "2 values"]
    "The probabilities `u` and `v`."
    slope: Float[np.ndarray, "values"]
    "The derivative in `y`."
    share: Float[np.ndarray, "2 values"]
    "The share of either term in the derivative."
    rise: Float[np.ndarray, "2 values"]
    "The derivatives in `y` of the logarithms of the terms."
    change: Float[np.ndarray, "3 values"]
    "The derivatives of the logarithm of the sum, in `y` and the shapes."
    by_shape: Float[np.ndarray, "2 values"]
    "The derivatives of the quantile function in the shapes."
    by_shape_twice: Float[np.ndarray, "2 values"]
    "Its second derivatives in the shapes; the mixed one is 0."

    @staticmethod
    def of(y: Float[np.ndarray, "values"], shapes: Float[np.ndarray, "2 1"]) -> "_Local":
        value, logs, terms = _quantile(y, shapes)
        u, v = chance = np.exp(logs)
        log_slope, share = _log_slope(logs, shapes)
        rise = np.stack([shapes[0] * v - u, v - shapes[1] * u])
        first, second = _quotient_slopes(shapes * logs, terms / logs)
        signed = logs**2 * [[1.0], [-1.0]]
        return _Local(
            y=y,
            value=value,
            logs=logs,
            chance=chance,
            slope=np.exp(log_slope),
            share=share,
            rise=rise,
            change=np.concatenate([(share * rise).sum(axis=0)[None], share * logs]),
            by_shape=signed * first,
            by_shape_twice=signed * logs * second,
        )


@dataclasses.dataclass(frozen=True, eq=False)
class _Inverse:
    """The derivatives of the log-odds at given values in the four numbers of the law."""

    at: _Local
    along: Float[np.ndarray, "values"]
    "The position of each value between the points, 0 at the first and 1 at the second."
    slope: Float[np.ndarray, "4 values"]
    "The first derivatives; 0 where the log-odds are clipped."
    end: _Local
    "`S` at `a` and at `b`; its derivatives follow."
    end_slope: Float[np.ndarray, "2 4"]
    end_second: Float[np.ndarray, "2 4 4"]

    @staticmethod
    def of(
        at: _Local,
        numbers: Float[np.ndarray, "4"],
        point: Float[np.ndarray, "2"],
        x: Float[np.ndarray, "values"],
    ) -> "_Inverse":
        end = _Local.of(numbers[:2], _shapes(numbers))
        end_slope, end_second = np.zeros((2, 4)), np.zeros((2, 4, 4))
        for k in (0, 1):
            end_slope[k, k], end_slope[k, 2:] = end.slope[k], end.by_shape[:, k]
            own = [k, 2, 3]
            end_second[k, k, own] = end_second[k, own, k] = end.slope[k] * end.change[:, k]
            end_second[k, [2, 3], [2, 3]] = end.by_shape_twice[:, k]
        along = (x - point[0]) / (point[1] - point[0])
        slope = np.outer(end_slope[0], 1 - along) + np.outer(end_slope[1], along)
        slope[2:] -= at.by_shape
        slope = np.where(np.abs(at.y) < FAR, slope / at.slope, 0.0)
        return _Inverse(at, along, slope, end, end_slope, end_second)

    def second(self, weight: Float[np.ndarray, "values"]) -> Float[np.ndarray, "4 4"]:
        """Compute a weighted sum over the values of the second derivatives."""
        scaled = np.where(np.abs(self.at.y) < FAR, weight / self.at.slope, 0.0)
        hessian = (scaled @ (1 - self.along)) * self.end_second[0]
        hessian += (scaled @ self.along) * self.end_second[1]
        hessian[[2, 3], [2, 3]] -= self.at.by_shape_twice @ scaled
        hessian -= (self.slope * (weight * self.at.change[0])) @ self.slope.T
        mixed = (self.slope * weight) @ self.at.change[1:].T
        hessian[:, 2:] -= mixed
        hessian[2:] -= mixed.T
        return hessian


def _shapes(numbers: Float[np.ndarray, "*laws 4"]) -> Float[np.ndarray, "2 *laws 1"]:
    """Return the shapes of laws, lower ones first, with an axis for the values of each law."""
    return np.moveaxis(numbers[..., 2:], -1, 0)[..., None]


def _quantile(
    y: Float[np.ndarray, "*values"], shapes: Float[np.ndarray, "2 *#values"]
) -> tuple[
    Float[np.ndarray, "*values"], Float[np.ndarray, "2 *values"], Float[np.ndarray, "2 *values"]
]:
    """Compute the quantile function with location 0 and scale 1.

    **Returns:** the values; the logarithms of `u` and `v`; and the two terms whose difference the
    values are, `expm1(l3 log(u)) / l3` and `expm1(l4 log(v)) / l4`.
    """
    small = np.log1p(np.exp(-np.abs(y)))
    logs = np.stack([np.minimum(y, 0), -np.maximum(y, 0)]) - small
    t = shapes * logs
    terms = logs * np.divide(np.expm1(t), t, out=np.ones_like(t), where=t != 0)
    return terms[0] - terms[1], logs, terms


def _log_slope(
    logs: Float[np.ndarray, "2 *values"], shapes: Float[np.ndarray, "2 *#values"]
) -> tuple[Float[np.ndarray, "*values"], Float[np.ndarray, "2 *values"]]:
    """Compute the logarithm of the slope of the quantile function, and the shares of its terms."""
    terms = shapes * logs + logs[::-1]
    log_slope = terms.max(axis=0)
    log_slope += np.log1p(np.exp(terms.min(axis=0) - log_slope))
    return log_slope, np.exp(terms - log_slope)


def _quotient_slopes(
    t: Float[np.ndarray, "2 values"], quotient: Float[np.ndarray, "2 values"]
) -> tuple[Float[np.ndarray, "2 values"], Float[np.ndarray, "2 values"]]:
    """Compute the first and second derivatives of the quotient `expm1(t) / t`."""
    grown = np.exp(t)
    first = (grown - quotient) / t
    second = (grown - 2 * first) / t
    small = np.abs(t) < _SMALL
    first[small], second[small] = (
        np.polynomial.polynomial.polyval(t[small], series) for series in (_FIRST, _SECOND)
    )
    return first, second


def _solve(
    z: Float[np.ndarray, "*laws values"], shapes: Float[np.ndarray, "2 *laws 1"]
) -> Float[np.ndarray, "*laws values"]:
    """Find the log-odds at which the standard quantile function is `z`.

    A table of that function brackets each solution. A step of Newton's method that would leave the
    bracket is replaced by its middle. Beyond the table, its end is returned.
    """
    with np.errstate(all="ignore"):
        table = _quantile(np.broadcast_to(NODES, (*z.shape[:-1], NODES.size)), shapes)[0]
        solution = np.where(z > 0, FAR, -FAR).ravel()
        left = np.flatnonzero((z > table[..., :1]) & (z < table[..., -1:]))
        rows = list(zip(z.reshape(-1, z.shape[-1]), table.reshape(-1, NODES.size), strict=True))
        after = np.concatenate([np.searchsorted(known, aim) for aim, known in rows])[left]
        low, high = NODES[after - 1], NODES[after]
        y = np.concatenate([np.interp(aim, known, NODES) for aim, known in rows])[left]
        y = np.clip(y, low, high)
        aim = z.ravel()[left]
        shapes = np.broadcast_to(shapes, (2, *z.shape)).reshape(2, -1)[:, left]
        for _ in range(_MAX_STEPS):
            if not left.size:
                break
            value, logs, terms = _quantile(y, shapes)
            excess = value - aim
            low, high = np.where(excess <= 0, y, low), np.where(excess >= 0, y, high)
            change = -excess * np.exp(-_log_slope(logs, shapes)[0])
            moved = y + change
            last = np.abs(change) <= _STEP * np.maximum(1.0, np.abs(y))
            # Where the function is flat, rounding makes steps that never become small.
            settled = np.abs(excess) <= -ROUNDING * terms.sum(axis=0)
            safe = np.where((moved >= low) & (moved <= high), moved, (low + high) / 2)
            y = np.where(last, moved, np.where(settled, y, safe))
            solution[left] = y
            going = ~last & ~settled
            left, aim, y, low, high = (part[going] for part in (left, aim, y, low, high))
            shapes = shapes[:, going]
        return solution.reshape(z.shape)
