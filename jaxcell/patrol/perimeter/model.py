import dataclasses
import enum
import functools
import heapq
from typing import TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
import scipy.interpolate
from jaxtyping import Array, Bool, Float, Int

from ...base.certificate import Certificate
from ...base.shown import Shown
from ...base.wide import traced
from ...mapping import Chain
from ...markov import first_passage, hitting_times
from ...optimize.validation import check_count


# The accuracy of a probability of detection.
_TOLERANCE = 1e-12
# Narrower intervals of p are not halved, because the bounds of both halves would be equal.
_NARROWEST = 2.0**-44


_Polynomials: TypeAlias = Float[np.ndarray, "segments coefficients"]


class Movement(enum.Enum):
    """The rule for the moves of robots on a perimeter; one coin per step decides for all robots."""

    BMP = "bidirectional: one segment clockwise with probability p, else one counter-clockwise"
    DNCP = "directional: one segment ahead with probability p, else one back, which is now ahead"
    DCP = "directional: one segment ahead with probability p, else turn in place"


@dataclasses.dataclass(frozen=True)
class Perimeter:
    """Robots at equal distances on a closed perimeter, which move together (Agmon et al. 2008).

    An attack begins when the robots head clockwise, before a coin is tossed. Because robots remain
    equally far apart, segments are numbered from one robot to the next: segment `i` is `i` segments
    ahead of a robot and `distance - i` behind the next. Segment 0 contains a robot: an adversary
    who enters it as the robot leaves is detected when a robot enters it again. A robot that turns
    in place remains in its segment.
    """

    segments: int
    robots: int
    "Number of robots, a divisor of `segments`."
    movement: Movement

    def __post_init__(self) -> None:
        check_count("segments", self.segments)
        check_count("robots", self.robots)
        if self.segments % self.robots:
            raise ValueError(
                f"robots: expected a divisor of the {self.segments} segments, got {self.robots}"
            )

    @property
    def distance(self) -> int:
        """Number of segments from one robot to the next."""
        return self.segments // self.robots

    @property
    def images(self) -> Int[np.ndarray, "2 states"]:
        """The state after one step if the coin shows heads (row 0, probability p) or tails (row 1).

        In state `phase * distance + i`, a robot is `i` segments behind the attacked segment. In
        phase 0 the robot moves towards the segment and in phase 1 away from it.
        """
        i = np.arange(self.distance, dtype=np.int32)
        ahead, behind = (i - 1) % self.distance, (i + 1) % self.distance
        if self.movement is Movement.BMP:
            return np.stack([ahead, behind])
        turned = (i, i) if self.movement is Movement.DCP else (ahead, behind)
        heads = np.concatenate([ahead, self.distance + behind])
        return np.stack([heads, np.concatenate([self.distance + turned[1], turned[0]])])

    @property
    def occupied(self) -> Bool[np.ndarray, "states"]:
        """The mask of the states in which a robot is in the attacked segment."""
        return np.arange(self.images.shape[1]) % self.distance == 0

    def chain(self, p: float | Array) -> Chain:
        """Return the chain of the states for the probability `p` of heads, which may be traced."""
        if not traced(p) and not 0 <= p <= 1:
            raise ValueError(f"p: expected a probability, got {p}")
        xp = jnp if traced(p) else np
        return Chain(self.images, xp.stack([xp.full(self.images.shape[1], x) for x in (p, 1 - p)]))


def detection_polynomials(perimeter: Perimeter, time: int) -> _Polynomials:
    """Compute the probability of penetration detection, a polynomial of p for each segment.

    The coefficients belong to the Bernstein form, `sum_k c[k] comb(time, k) p**k (1 - p)**(time -
    k)`. Each coefficient `c[k]` is the probability of detection if `k` of `time` coins show heads.
    Unlike a sum of powers of p, this sum loses no digits by cancellation. `scipy.interpolate.BPoly(
    c.T[:, None], [0, 1])` evaluates and differentiates the polynomials.

    **Arguments:** the robots, and the number of steps that a penetration takes. **Returns:** the
    coefficients for the segments 0 to `perimeter.distance - 1`.

    Robots four segments apart; segments 1 and 3 mirror each other:

        >>> from jaxcell import patrol
        >>> perimeter = patrol.perimeter.Perimeter(8, 2, patrol.perimeter.Movement.BMP)
        >>> patrol.perimeter.detection_polynomials(perimeter, 3)[[1, 3]].round(3).tolist()
        [[1.0, 0.333, 1.0, 1.0], [1.0, 1.0, 0.333, 1.0]]
    """
    check_count("time", time)
    heads, tails = perimeter.images
    there = perimeter.occupied
    detected = there[:, None].astype(np.float64)
    for step in range(1, time + 1):
        # Of the sequences of `step` coins with k heads, a share k / step begins with heads.
        first = np.arange(step + 1) / step
        later = first * np.pad(detected[heads], ((0, 0), (1, 0)))
        later += (1 - first) * np.pad(detected[tails], ((0, 0), (0, 1)))
        detected = np.where(there[:, None], 1.0, later)
    return later[: perimeter.distance]


@dataclasses.dataclass(frozen=True)
class Maximin(Shown):
    """The probability p of heads that maximises detection in the weakest segment."""

    p: float
    value: float
    "The probability of detection in the weakest segment."
    segment: int
    "The row of the polynomials that belongs to the weakest segment."
    certificate: Certificate


def maximin(polynomials: _Polynomials) -> Maximin:
    """Find the p in [0, 1] that maximises the minimum of several polynomials.

    The method is branch and bound: a polynomial never exceeds its largest Bernstein coefficient,
    and its coefficients on a part of an interval approach its values as the part narrows.

    **Arguments:** polynomials in Bernstein form, such as [`detection_polynomials`][]. Omit the
    first row if the adversary cannot enter the segment of a robot.

    **Returns:** [`Maximin`][], with one of the best p; for the movement `BMP`, p and 1 - p are
    equally good. The residual of its certificate bounds the distance of the value from the maximum,
    and the number of iterations is the number of intervals that were halved.

    Two robots on eight segments, with penetrations of three steps:

        >>> from jaxcell import patrol
        >>> perimeter = patrol.perimeter.Perimeter(8, 2, patrol.perimeter.Movement.BMP)
        >>> best = patrol.perimeter.maximin(patrol.perimeter.detection_polynomials(perimeter, 3))
        >>> round(best.p, 3), round(best.value, 6)
        (0.5, 0.5)
    """
    if polynomials.size == 0 or not np.isfinite(polynomials).all():
        raise ValueError(f"polynomials: expected finite numbers, got {polynomials.tolist()}")
    best = max((float(polynomials[:, end].min()), p) for end, p in ((0, 0.0), (-1, 1.0)))
    # The intervals in order of falling bounds; p breaks ties, so that no arrays are compared.
    queue = [(-_bound(polynomials), 0.0, 1.0, polynomials)]
    iterations = 0
    while -queue[0][0] - best[0] > _TOLERANCE and queue[0][2] - queue[0][1] > _NARROWEST:
        _, low, high, whole = heapq.heappop(queue)
        middle = (low + high) / 2
        left, right = _halves(whole)
        best = max(best, (float(right[:, 0].min()), middle))
        heapq.heappush(queue, (-_bound(left), low, middle, left))
        heapq.heappush(queue, (-_bound(right), middle, high, right))
        iterations += 1
    value, p = best
    weakest = int(scipy.interpolate.BPoly(polynomials.T[:, None], [0, 1])(p).argmin())
    gap = max(0.0, -queue[0][0] - value)
    return Maximin(p, value, weakest, Certificate(iterations, gap, 2 * _TOLERANCE))


def hitting_law(
    perimeter: Perimeter, p: float | Array, steps: int
) -> Float[Array, "segments steps"]:
    """Compute the distribution of the first step after which a robot is in a segment.

    **Arguments:** the robots, the probability of heads, which may be traced by `jit`, `vmap` and
    `grad`, and the number of steps to compute. **Returns:** one row per segment, 0 to
    `perimeter.distance - 1`, one column per step from 1.

    Robots that toss a fair coin, two segments apart:

        >>> from jaxcell import patrol
        >>> perimeter = patrol.perimeter.Perimeter(4, 2, patrol.perimeter.Movement.BMP)
        >>> patrol.perimeter.hitting_law(perimeter, 0.5, 3).tolist()
        [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]
    """
    check_count("steps", steps)
    chain = perimeter.chain(p)
    # The law begins after one step, because the robots leave segment 0.
    law = functools.partial(first_passage, chain, target=perimeter.occupied, steps=steps - 1)
    begins = np.eye(perimeter.distance, len(perimeter.occupied))
    return jnp.stack([law(chain.push(begin)) for begin in begins])


def mean_hitting_times(perimeter: Perimeter, p: float | Array) -> Float[Array, "segments"]:
    """Compute the expected number of steps until a robot visits each segment.

    **Arguments:** the robots, and the probability of heads of their coin, which may be traced by
    `jit`, `vmap` and `grad`. **Returns:** the times for segments 0 to `perimeter.distance - 1`;
    `inf` if it is possible that no robot ever comes.

    Robots that toss a fair coin, four segments apart. A robot reaches segment `i > 0` in `i (4 -
    i)` steps on average, and returns to segment 0 in 4:

        >>> from jaxcell import patrol
        >>> perimeter = patrol.perimeter.Perimeter(8, 2, patrol.perimeter.Movement.BMP)
        >>> patrol.perimeter.mean_hitting_times(perimeter, 0.5).round(6).tolist()
        [4.0, 3.0, 4.0, 3.0]
    """
    chain = perimeter.chain(p)
    time = hitting_times(chain, perimeter.occupied).value
    # In segment 0, the time is that until a robot returns.
    return _next(chain, jnp.asarray(time))[: perimeter.distance]


@jax.jit
def _next(chain: Chain, time: Float[Array, "states"]) -> Float[Array, "states"]:
    """Add one step to the mean of `time` after it; steps without a probability do not count."""
    later = jnp.where(chain.probability > 0, chain.probability * time[chain.image], 0.0)
    return 1 + jnp.sum(later, axis=0)


def _bound(coefficients: _Polynomials) -> float:
    """Return an upper bound, over all p in [0, 1], on the minimum of the polynomials."""
    return float(coefficients.max(axis=1).min())


def _halves(whole: _Polynomials) -> tuple[_Polynomials, _Polynomials]:
    """Compute Bernstein coefficients on the two halves of an interval (de Casteljau)."""
    left, right = np.empty_like(whole), np.empty_like(whole)
    for k in range(whole.shape[1]):
        left[:, k], right[:, -1 - k] = whole[:, 0], whole[:, -1]
        whole = (whole[:, :-1] + whole[:, 1:]) / 2
    return left, right
