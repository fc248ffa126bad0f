"""Likelihood of samples under generalized lambda distributions, with derivatives.

Here, the parameters of a law are four `numbers`: the log-odds of its distribution function at two
points, the entries of `point`, and its two shapes.
"""

import dataclasses
import itertools
import math

import numpy as np
from jaxtyping import Float, Int

from .distribution import Gld, log_probability, standard_quantile


# The step of difference quotients. Their error is of the order of the square of the step, plus
# rounding divided by this square.
_STEP = 3e-4
# The steps to the laws of a difference quotient: in both directions of each axis and each diagonal.
_AXES = np.eye(4)
_PAIRS = list(itertools.combinations(range(4), 2))
_DIAGONALS = np.array([_AXES[i] + _AXES[j] for i, j in _PAIRS])
_STENCIL = _STEP * np.concatenate([_AXES, -_AXES, _DIAGONALS, -_DIAGONALS])
# With more values than this number, fewer laws are in memory at once.
_VALUES = 20_000


def law_through(numbers: Float[np.ndarray, "*laws 4"], point: Float[np.ndarray, "*#laws 2"]) -> Gld:
    """Return laws with log-odds `numbers[:2]` at the points `point`, and shapes `numbers[2:]`."""
    l3, l4 = numbers[..., 2:3], numbers[..., 3:]
    end = standard_quantile(numbers[..., :2], l3, l4)
    l2 = np.diff(end) / np.diff(point)
    return Gld(point[..., :1] - end[..., :1] / l2, l2, l3, l4)


@dataclasses.dataclass(frozen=True, eq=False)
class Likelihood:
    """The likelihood of samples as a function of the law."""

    x: Float[np.ndarray, "values"]
    "The values at which the distribution function is evaluated."
    weight: Float[np.ndarray, "samples"]
    "The share of the samples that have each distinct value."
    ends: Int[np.ndarray, "2 samples"] | None
    "The indices in `x` of the ends of each sample; `None` if samples are not intervals."

    @staticmethod
    def of(
        value: Float[np.ndarray, "samples"], count: Int[np.ndarray, "samples"], censored: bool
    ) -> "Likelihood":
        """Return the likelihood of values that occur `count` times each.

        If `censored`, a value stands for the interval of length 1 around it."""
        weight = count / count.sum()
        if not censored:
            return Likelihood(value, weight, None)
        # Most intervals touch the next.
        x, ends = np.unique([value - 0.5, value + 0.5], return_inverse=True)
        return Likelihood(x, weight, ends.reshape(2, -1))

    def loss(
        self, numbers: Float[np.ndarray, "*laws 4"], point: Float[np.ndarray, "*#laws 2"]
    ) -> Float[np.ndarray, "*laws"]:
        """Compute the negative mean log-likelihood of laws given as for [`law_through`][]."""
        law = law_through(numbers, point)
        return self._loss(law, law.log_odds(self.x))

    def expansion(
        self,
        numbers: Float[np.ndarray, "4"],
        point: Float[np.ndarray, "2"],
        below: float = math.inf,
    ) -> tuple[float, Float[np.ndarray, "4"], Float[np.ndarray, "4 4"]]:
        """Compute the loss, and its gradient and Hessian with respect to `numbers`.

        The derivatives are difference quotients between nearby laws. They are NaN, to save time, if
        the loss is not less than `below`.
        """
        law = law_through(numbers, point)
        log_odds = law.log_odds(self.x)
        loss = float(self._loss(law, log_odds))
        if not loss < below:
            return loss, np.full(4, np.nan), np.full((4, 4), np.nan)
        batches = min(len(_STENCIL), 1 + self.x.size // _VALUES)
        laws = (law_through(part, point) for part in np.array_split(numbers + _STENCIL, batches))
        losses = np.concatenate([self._loss(law, law.log_odds(self.x, log_odds)) for law in laws])
        up, down, pairs = losses[:4], losses[4:8], losses[8:14] + losses[14:]
        twice = up + down - 2 * loss
        hessian = np.diag(twice)
        for (i, j), both in zip(_PAIRS, pairs, strict=True):
            hessian[i, j] = hessian[j, i] = (both - 2 * loss - twice[i] - twice[j]) / 2
        return loss, (up - down) / (2 * _STEP), hessian / _STEP**2

    def _loss(
        self, law: Gld, log_odds: Float[np.ndarray, "*laws values"]
    ) -> Float[np.ndarray, "*laws"]:
        if self.ends is None:
            return np.asarray(-law.log_density(log_odds) @ self.weight)
        low, high = self.ends
        return np.asarray(-log_probability(log_odds[..., low], log_odds[..., high]) @ self.weight)
