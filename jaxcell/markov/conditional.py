import jax
import numpy as np
import numpy.typing as npt
import scipy.sparse
from jaxtyping import Bool, Float

from ..base.certificate import Certificate, Solution
from ..base.precision import require_x64
from ..mapping.generalized import Chain
from .hitting import PROBABILITY_TOLERANCE, cell_mask, prospects, times_until_left, with_moved
from .transient import Transient


# The largest number below 1.
ALMOST_SURE = float(np.nextafter(1, 0))


def arrival_probabilities(
    chain: Chain, target: npt.ArrayLike | int, *, throw: bool = True
) -> Solution:
    """Compute the probability that a chain ever arrives in a set of cells.

    **Arguments:** a chain, and a cell, a list of cells, or a mask over the cells.

    **Returns:** the probability for each start, exactly 1 if the chain is certain to arrive, and 0
    if it cannot arrive. The residual of the certificate is the largest difference between the
    probability from a cell and its mean after one step. If the chain was estimated from samples,
    the field `moved` of the solution estimates the sampling error.

    A random walk on a line of four cells, which stops at both ends:

        >>> from jaxcell import examples, markov
        >>> (3 * markov.arrival_probabilities(examples.ruin(), target=3).value).round(6).tolist()
        [0.0, 1.0, 2.0, 3.0]
    """
    require_x64("arrival_probabilities")
    there = cell_mask(chain.cells, target)
    value, certificate = probabilities(chain.to_scipy(), there)
    certificate.check("arrival_probabilities", throw)
    solution = Solution(jax.device_put(value), certificate)
    return with_moved(solution, chain, arrival_probabilities, there)


def conditional_hitting_times(
    chain: Chain, target: npt.ArrayLike | int, *, throw: bool = True
) -> Solution:
    """Compute the expected number of steps until a chain reaches a set of cells, if it ever does.

    It is the mean over the paths that arrive. If all paths arrive, it equals
    [`jaxcell.markov.hitting_times`][], which is `inf` otherwise.

    **Arguments:** as for [`arrival_probabilities`][]. **Returns:** the time for each start, 0 in
    the target, and `inf` if the chain cannot arrive. The residual of the certificate bounds the
    relative error of every finite time.

    A random walk on a line of four cells, which stops at both ends:

        >>> from jaxcell import examples, markov
        >>> chain = examples.ruin()
        >>> (3 * markov.conditional_hitting_times(chain, target=3).value).round(6).tolist()
        [inf, 8.0, 5.0, 0.0]
    """
    require_x64("conditional_hitting_times")
    there = cell_mask(chain.cells, target)
    matrix = chain.to_scipy()
    arrives, certificate = probabilities(matrix, there)
    certificate.check("conditional_hitting_times", throw)
    time, inside = np.where(arrives > 0, 0.0, np.inf), (arrives > 0) & ~there
    under = conditioned(matrix, arrives)
    times = times_until_left(under, inside, time, "conditional_hitting_times", throw)
    return with_moved(times, chain, conditional_hitting_times, there)


def probabilities(
    matrix: scipy.sparse.csr_array, there: Bool[np.ndarray, "cells"]
) -> tuple[Float[np.ndarray, "cells"], Certificate]:
    """Compute [`arrival_probabilities`][] from a transition matrix and the mask of a target."""
    can, may_fail = prospects(matrix, there)
    value = np.where(can & ~may_fail, 1.0, 0.0)
    part = Transient.of(matrix, can & may_fail & ~there)
    value[there] = 1
    gain = (matrix[part.cells] @ value)[:, None]
    ends, products = part.expect(gain)
    residual = np.abs(gain + part.step @ ends - ends).max(initial=0.0)
    value[part.cells] = np.minimum(ends[:, 0], ALMOST_SURE)
    return value, Certificate(products, float(residual), PROBABILITY_TOLERANCE)


def conditioned(
    matrix: scipy.sparse.csr_array, arrives: Float[np.ndarray, "cells"]
) -> scipy.sparse.csr_array:
    """Return the chain under the condition that it arrives (Doob's transform).

    The probability `p(x, y)` of a step becomes `p(x, y) h(y) / h(x)`, where `h` is `arrives`, the
    probability of arriving. The matrix may have several rows per cell, one per action. A row from
    which no path leads to the target becomes empty.
    """
    weighed = matrix @ scipy.sparse.diags_array(arrives)
    # The sum of a row is `h` up to rounding; dividing by the sum removes the rounding.
    total = np.asarray(weighed.sum(axis=1)).ravel()
    share = np.divide(1, total, out=np.zeros_like(total), where=total > 0)
    result = (scipy.sparse.diags_array(share) @ weighed).tocsr()
    result.eliminate_zeros()
    return result
