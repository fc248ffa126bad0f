import dataclasses
import itertools
import math
from typing import Annotated, Any, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int

from ...base.certificate import Certificate
from ...base.quantities import Result, from_part, quantity
from ...optimize.validation import finite
from .distribution import Gld
from .likelihood import Likelihood, law_through


_MIN_SAMPLES = 8
_MIN_VALUES = 5
# The accuracy of the log-likelihood of all samples.
_TOLERANCE = 1e-4
# The grid of the R package gld, which Alam 2018 uses, with two more shapes for narrow peaks.
_SHAPES = (-0.9, -0.5, -0.1, 0.0, 0.1, 0.2, 0.4, 0.8, 1.0, 1.5, 3.0, 10.0)
# The number of values with which laws are ranked, and the number of laws that are then improved.
_RANKED = 400
_POLISHED = 3
# Bounds between three kinds of shapes, which have a tail, an edge, or a peak at an edge.
_KINDS = (0.5, 2.0)
_MAX_SHAPE = 50.0
# The support ends so far from the least of n samples that the distribution function at the sample
# is at least exp(-_BEYOND) / n: a nearer end gains less than exp(-_BEYOND) in log-likelihood.
_BEYOND = 5.0
_MAX_HALVINGS = 20
# Relative change of the log-odds with which a narrower support begins, so that no difference
# quotient extends over the kink of the likelihood.
_INWARD = 0.01
# The largest change of a parameter in a step.
_MAX_CHANGE = 2.0
# Curvatures below this number are due to rounding.
_FLATTEST = 1e-9


_Numbers: TypeAlias = Float[np.ndarray, "4"]
_Point: TypeAlias = Float[np.ndarray, "2"]


@dataclasses.dataclass(frozen=True, eq=False)
class GldFit(Result):
    """The generalized lambda distribution that maximizes the likelihood of samples."""

    law: Gld
    log_likelihood: Annotated[float, quantity("", "log-likelihood of the samples")]
    "The sum over all samples of log-probabilities if censored, otherwise of log-densities."
    distance: Annotated[float, quantity("", "largest difference of distribution functions", "1")]
    """Kolmogorov-Smirnov statistic: the largest difference between the distribution functions of
    the law and of the samples. If censored, they are compared at whole numbers plus 1/2."""
    censored: bool
    "`True` if samples stand for intervals of length 1."
    certificate: Certificate

    def cdf(self, x: Float[np.ndarray, "values"]) -> Float[np.ndarray, "values"]:
        """Compute the distribution function of the law at `x`."""
        return self.law.cdf(x)

    l1 = from_part("law.l1", "", "l1, the place of the law")
    l2 = from_part("law.l2", "", "l2, the inverse of its scale")
    l3 = from_part("law.l3", "", "l3, the shape of its lower tail")
    l4 = from_part("law.l4", "", "l4, the shape of its upper tail")


def fit_gld(
    samples: Any, *, censored: bool | None = None, steps: int = 60, throw: bool = True
) -> GldFit:
    """Fit a generalized lambda distribution with maximum likelihood (Alam 2018, section 4.4.6).

    It runs on the host, because it counts equal samples, and compares local maxima.

    Times counted in steps are whole numbers, for which the likelihood of a density grows without
    bound as the law concentrates around one number. If `censored`, a sample `t` therefore stands
    for `t - 1/2 < X <= t + 1/2`, and its likelihood is the probability of this interval.

    Newton's method searches from the best few laws on a grid of shapes. The result is the best of
    several local maxima, with shapes from -50 to 50. A law with larger shapes and a peak at one
    sample may have a larger likelihood, but is useless.

    **Arguments:**

    - `samples`: array `[samples]`, in any order and unit.
    - `censored`: whether the samples are whole numbers that stand for intervals. The default is
        `True` if all samples are whole numbers and at least two are equal.
    - `steps`: largest number of Newton steps in each search.
    - `throw`: whether to raise `RuntimeError` if the residual exceeds its tolerance, 1e-4.

    **Returns:** [`GldFit`][]. The residual of its certificate is the gain in log-likelihood that is
    predicted for one more step.

    Four parameters need more than four samples:

        >>> from jaxcell import patrol
        >>> patrol.fit_gld([3, 4, 4, 7])
        Traceback (most recent call last):
            ...
        ValueError: samples: expected at least 8, with 5 different values, got 4 with 3
    """
    given = finite("samples", samples)
    if given.ndim != 1:
        raise ValueError(f"samples: expected a list of numbers, got an array {list(given.shape)}")
    value, count = np.unique(given, return_counts=True)
    whole = value == np.round(value)
    if censored is None:
        censored = value.size < given.size and bool(whole.all())
    elif censored and not whole.all():
        index = np.flatnonzero(given != np.round(given))[0]
        raise ValueError(
            f"samples[{index}] is {given[index]}; expected a whole number, as samples are censored"
        )
    if given.size < _MIN_SAMPLES or value.size < _MIN_VALUES:
        raise ValueError(
            f"samples: expected at least {_MIN_SAMPLES}, with {_MIN_VALUES} different "
            f"values, got {given.size} with {value.size}"
        )
    # Values are relative to the least value, so that samples far from 0 lose no digits.
    origin = value[0]
    problem = _Problem.of(value - origin, count, censored, steps)
    ranking = dataclasses.replace(problem, data=problem.few)
    near = [_maximum(ranking, *start) for start in _starts(problem)]
    # A part of the samples may rank local maxima otherwise than all samples do.
    maxima = [_maximum(problem, law.numbers, law.point) for law in near]
    best = min(maxima, key=lambda maximum: maximum.loss)
    taken = sum(maximum.steps for maximum in near + maxima)
    certificate = Certificate(taken, best.gain, _TOLERANCE)
    certificate.check("fit_gld", throw)
    l1, l2, l3, l4 = np.concatenate(dataclasses.astuple(law_through(best.numbers, best.point)))
    law = Gld(*map(float, (l1 + origin, l2, l3, l4)))
    distance = _distance(law, value, count, censored)
    return GldFit(law, -best.loss * given.size, distance, censored, certificate)


@dataclasses.dataclass(frozen=True, eq=False)
class _Problem:
    """The samples of a fit. A law is given by its two shapes and by its log-odds at two points."""

    data: Likelihood
    few: Likelihood
    "The likelihood of at most `_RANKED` of the values, for a quick choice among many laws."
    inner: _Point
    "Two points near the quartiles of the samples."
    log_odds: _Point
    "The log-odds of the empirical distribution function at the points `inner`."
    outer: _Point
    "The interval from the lower end of the smallest sample to the upper end of the largest."
    narrow: _Point
    "The interval from the upper end of the smallest sample to the lower end of the largest."
    size: int
    steps: int

    @staticmethod
    def of(
        value: Float[np.ndarray, "values"],
        count: Int[np.ndarray, "values"],
        censored: bool,
        steps: int,
    ) -> "_Problem":
        upto = np.cumsum(count)
        size = int(upto[-1])
        if censored:
            at, share = value[:-1] + 0.5, upto[:-1] / size
        else:
            at, share = value, (upto - count / 2) / size
        # The two points differ even if many samples are equal.
        first = min(int(np.abs(share - 0.25).argmin()), share.size - 2)
        second = max(int(np.abs(share - 0.75).argmin()), first + 1)
        share = share[[first, second]]
        beyond = np.array([-0.5, 0.5]) * censored
        ranked = np.unique(np.linspace(0, value.size - 1, _RANKED).astype(int))
        return _Problem(
            Likelihood.of(value, count, censored),
            Likelihood.of(value[ranked], count[ranked], censored),
            at[[first, second]],
            np.log(share) - np.log1p(-share),
            value[[0, -1]] + beyond,
            value[[0, -1]] - beyond,
            size,
            steps,
        )


def _starts(problem: _Problem) -> list[tuple[_Numbers, _Point]]:
    """Return the parameters and points of the best laws on a grid of shapes, to start the search.

    Only the best law of each kind (`_KINDS`) is returned. The laws have the quartiles of the
    samples, except that a bounded support is widened to contain all samples.
    """
    farthest = math.log(2 * problem.size)
    shapes = np.array(list(itertools.product(_SHAPES, repeat=2)))
    numbers = np.concatenate([np.tile(problem.log_odds, (len(shapes), 1)), shapes], axis=1)
    bounded = shapes > 0
    point = np.where(bounded, problem.outer, problem.inner)
    reaching = np.clip(
        law_through(numbers, problem.inner).log_odds(problem.outer), -farthest, farthest
    )
    numbers[:, :2] = np.where(bounded, reaching, problem.log_odds)
    loss = problem.few.loss(numbers, point)
    kind = np.searchsorted(_KINDS, shapes)
    chosen: dict[tuple[int, ...], int] = {}
    possible = np.flatnonzero(np.isfinite(loss))
    for index in possible[np.argsort(loss[possible])]:
        chosen.setdefault(tuple(kind[index]), index)
    return [(numbers[index], point[index]) for index in list(chosen.values())[:_POLISHED]]


@dataclasses.dataclass(frozen=True, eq=False)
class _Maximum:
    numbers: _Numbers
    point: _Point
    loss: float
    gain: float
    "The predicted gain in log-likelihood of one more step."
    edge: Bool[np.ndarray, "2"]
    "For the lower and for the upper point, whether the support ends there."
    steps: int


def _maximum(problem: _Problem, numbers: _Numbers, point: _Point) -> _Maximum:
    """Find a local maximum of the likelihood, starting from the law `law_through(numbers, point)`.

    A censored sample is an interval. The likelihood has a kink if the support of the law ends at
    the outer end of the lowest or highest interval, and the maximum is often there. So the search
    first requires supports that contain the intervals (`outer`). It then also tries supports that
    end within the lowest or highest interval (`narrow`), and keeps the better result.
    """
    wide = _maximise(problem, numbers, point)
    narrowed = wide.edge & (problem.narrow != problem.outer)
    if not narrowed.any():
        return wide
    point = np.where(narrowed, problem.narrow, wide.point)
    there = law_through(wide.numbers, wide.point).log_odds(point)
    there = np.where(narrowed, (1 + _INWARD) * there, wide.numbers[:2])
    numbers = np.concatenate([there, wide.numbers[2:]])
    outer = np.where(narrowed, problem.narrow, problem.outer)
    narrow = _maximise(dataclasses.replace(problem, outer=outer), numbers, point)
    best = narrow if narrow.loss < wide.loss and narrow.gain <= _TOLERANCE else wide
    return dataclasses.replace(best, steps=wide.steps + narrow.steps)


def _maximise(problem: _Problem, numbers: _Numbers, point: _Point) -> _Maximum:
    """Maximize the likelihood with bounded Newton steps from the law `law_through(numbers, point)`.

    The eigenvalues of the Hessian of the loss are replaced by their absolute values, so that each
    step lowers the loss. No method of `scipy.optimize` suits: `trust-exact` takes no bounds, and
    `trust-constr` and L-BFGS-B stop too early.

    Two parameters of a law are its log-odds at two points, one on each side. If the support is
    bounded there, the point is that of `outer`, so that no change of the other parameters excludes
    a sample. Otherwise it is that of `inner`, where the log-odds hardly depend on the shape.
    """
    farthest = math.log(problem.size) + _BEYOND
    bound = np.array([farthest, farthest, _MAX_SHAPE, _MAX_SHAPE])
    loss, slope, hessian = problem.data.expansion(numbers, point)
    steps = 0
    while True:
        free = np.flatnonzero((np.abs(numbers) < bound) | (slope * numbers > 0))
        curvature, axes = np.linalg.eigh(hessian[np.ix_(free, free)])
        along = axes.T @ slope[free]
        curvature = np.maximum(np.abs(curvature), _FLATTEST)
        gain = float(problem.size * along @ (along / curvature) / 2)
        if gain <= _TOLERANCE or steps == problem.steps:
            break
        change = np.zeros(4)
        change[free] = -axes @ (along / curvature)
        change *= min(1.0, _MAX_CHANGE / np.abs(change).max())
        for _ in range(_MAX_HALVINGS):
            moved = np.clip(numbers + change, -bound, bound)
            trial = problem.data.expansion(moved, point, loss)
            if trial[0] < loss and np.isfinite(trial[1]).all() and np.isfinite(trial[2]).all():
                break
            change /= 2
        else:
            break
        numbers, (loss, slope, hessian) = moved, trial
        steps += 1
        suited = np.where(numbers[2:] > 0, problem.outer, problem.inner)
        if (suited != point).any():
            there = np.clip(law_through(numbers, point).log_odds(suited), -farthest, farthest)
            numbers, point = np.concatenate([there, numbers[2:]]), suited
            loss, slope, hessian = problem.data.expansion(numbers, point)
    edge = np.abs(numbers[:2]) == farthest
    return _Maximum(numbers, point, loss, gain, edge, steps)


def _distance(
    law: Gld, value: Float[np.ndarray, "values"], count: Int[np.ndarray, "values"], censored: bool
) -> float:
    """Compute the Kolmogorov-Smirnov statistic, which is attained next to a sample."""
    half = 0.5 if censored else 0.0
    upto = np.cumsum(count)
    below = law.cdf(value - half) - (upto - count) / upto[-1]
    above = law.cdf(value + half) - upto / upto[-1]
    return float(np.abs([below, above]).max())
