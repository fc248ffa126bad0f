"""Exact confidence intervals of shares, such as shares of drifters or of robots."""

import numpy as np
import scipy.special
from jaxtyping import Float, Int


# The probability beyond each end of a confidence interval.
_TAIL = 0.025


def clopper_pearson(
    seen: Int[np.ndarray, "*shape"], released: int
) -> tuple[Float[np.ndarray, "*shape"], Float[np.ndarray, "*shape"]]:
    """Compute the 95 % intervals of probabilities by Clopper and Pearson (1934).

    `seen` are numbers of successes, of `released` trials. **Returns:** the lower and upper limits.
    """
    limits = []
    for upper in (0, 1):
        others = np.maximum(released - seen + 1 - upper, 1)
        level = abs(upper - _TAIL)
        limit = scipy.special.betaincinv(np.maximum(seen + upper, 1), others, level)
        limits.append(np.where(seen == (released if upper else 0), float(upper), limit))
    return limits[0], limits[1]


def drifters_for(half_width: float) -> int:
    """Return the number of drifters whose interval of any probability is within `half_width`.

    The interval is widest at a probability of one half.
    """
    count = int(0.96 / half_width**2)
    while np.ptp(clopper_pearson(np.array([count // 2]), count)) > 2 * half_width:
        count += max(1, count // 10_000)
    return count
