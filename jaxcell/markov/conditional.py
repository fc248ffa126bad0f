import dataclasses
import functools
import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
import scipy.sparse
from jaxtyping import Float

from ..base.certificate import Certificate, Solution
from ..base.divided import put_on_device
from ..base.precision import require_x64
from ..base.wide import traced
from ..mapping.classes import reaching
from ..mapping.generalized import Chain, ChainLike
from ..mapping.traced import like, on_host
from .hitting import (
    TOLERANCE,
    Cells,
    cell_mask,
    check_target,
    leaving_times,
    prospects,
    with_moved,
)
from .solving.scaled import Scaled
from .traced import CERTIFIED, expected
from .transient import Transient


# The largest number below 1.
ALMOST_SURE = float(np.nextafter(1, 0))
_HALF_ULP = 2.0**-53


def arrival_probabilities(
    chain: ChainLike, target: npt.ArrayLike | int, *, throw: bool = True
) -> Solution:
    """Compute the probability that a chain ever arrives in a set of cells.

    **Arguments:** a chain, and a cell, a list of cells, or a mask over the cells.

    **Returns:** the probability for each start, exactly 1 if the chain is certain to arrive, and 0
    if it cannot arrive. The residual of the certificate bounds the error of every probability. If
    the chain has a coarser chain `half`, the field `moved` of the solution estimates the other
    errors.

    A random walk on a line of four cells, which stops at both ends:

        >>> from jaxcell import examples, markov
        >>> (3 * markov.arrival_probabilities(examples.ruin(), target=3).value).round(6).tolist()
        [0.0, 1.0, 2.0, 3.0]
    """
    require_x64("arrival_probabilities")
    there = cell_mask(chain.cells, target)
    solution, _ = arrivals(chain, there)
    solution.certificate.check("arrival_probabilities", throw)
    return with_moved(solution, chain, arrival_probabilities, there)


def arrivals(chain: Chain, there: Any, *, by_entries: bool = False) -> tuple[Solution, Any]:
    """Compute [`arrival_probabilities`][], and a bound on their relative errors."""
    form = like(float, chain.cells), like(bool, chain.cells), *CERTIFIED, like(float)
    compute = functools.partial(_arrivals, by_entries=by_entries)
    value, inside, products, error, relative = on_host(compute, form, chain, there)
    value = put_on_device(expected(value, chain, inside, 0.0))
    return Solution(value, Certificate(products, error, TOLERANCE)), relative


def _arrivals(matrix: scipy.sparse.csr_array, there: Cells, *, by_entries: bool) -> tuple[Any, ...]:
    check_target(there)
    arrivals = Arrivals.of(matrix, there, by_entries=by_entries)
    inside = np.zeros(there.size, bool)
    inside[arrivals.part.cells] = True
    certificate = arrivals.certificate
    about = certificate.iterations, certificate.residual, arrivals.relative
    return arrivals.value, inside, *about


def conditional_hitting_times(
    chain: ChainLike, target: npt.ArrayLike | int, *, throw: bool = True
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
    form = like(float, chain.cells), *CERTIFIED
    time, products, error = on_host(_conditional_times, form, chain, there)
    certificate = Certificate(products, error, TOLERANCE)
    certificate.check("conditional_hitting_times", throw)
    if traced(chain, there):
        arrives = arrival_probabilities(chain, there, throw=False).value
        inside = jnp.isfinite(time) & ~there
        product = jnp.where(inside, time * jax.lax.stop_gradient(arrives), 0.0)
        product = expected(product, chain, inside, arrives)
        time = jnp.where(inside, product / arrives, time)
    return with_moved(
        Solution(put_on_device(time), certificate), chain, conditional_hitting_times, there
    )


def _conditional_times(
    matrix: scipy.sparse.csr_array, there: Cells
) -> tuple[Float[np.ndarray, "cells"], int, float]:
    check_target(there)
    arrivals = Arrivals.of(matrix, there)
    time, certificate = _times(matrix, there, Scaled.of(arrivals.value), arrivals.relative)
    if not certificate.converged and (exact := arrivals.scaled()) is not None:
        time, certificate = _times(matrix, there, *exact)
    return time, certificate.iterations, certificate.residual


def _times(
    matrix: scipy.sparse.csr_array, there: Cells, arrives: Scaled, relative: float
) -> tuple[Float[np.ndarray, "cells"], Certificate]:
    """Compute conditional times from the probabilities of arriving, and their relative error."""
    can = reaching(matrix, there)
    toward, total = conditioned(matrix, arrives)
    time, inside = np.where(can, 0.0, np.inf), can & ~there
    time[inside], certificate = leaving_times(toward, inside)
    error = distortion(matrix, arrives, total, relative, time, inside)
    return time, dataclasses.replace(certificate, residual=certificate.residual + error)


def distortion(
    matrix: scipy.sparse.csr_array,
    arrives: Scaled,
    total: Scaled,
    relative: float,
    time: Float[np.ndarray, "cells"],
    inside: Cells,
) -> float:
    """Bound the relative error of conditional times that is due to errors of `arrives`.

    Two bounds hold. If `total`, the mean of `arrives` after a step, is `1 + r` times its value, a
    path of `n` steps counts `(1 + r)^n` times too often. And if the errors of `arrives` are at most
    `relative`, those of the probabilities under the condition are twice as large; a time is a
    quotient of sums of products with one probability per cell (the matrix-tree theorem).
    """
    with np.errstate(all="ignore"):
        ratio = np.abs((total[inside] / arrives[inside]).numbers - 1)
        rounding = (np.diff(matrix.indptr).max(initial=0) + 4) * _HALF_ULP
        longest = time[inside].max(initial=0.0)
        by_step = 2 * (ratio.max(initial=0.0) + rounding) * longest
    if not (arrives.part[inside] > 0).all():
        # The probability is too small for 64 bits.
        return math.inf
    return float(np.fmin(by_step, 4 * inside.sum() * relative))


@dataclasses.dataclass(frozen=True, eq=False)
class Arrivals:
    """The probabilities of ever arriving in a set of cells."""

    value: Float[np.ndarray, "cells"]
    part: Transient
    "The cells from which the chain may arrive or fail."
    gain: Float[np.ndarray, "part"]
    "The probability of arriving, or of becoming certain to arrive, by a step from each of them."
    relative: float
    "A bound on the relative error of every probability."
    certificate: Certificate
    "A certificate that bounds the absolute error of every probability."

    @classmethod
    def of(
        cls, matrix: scipy.sparse.csr_array, there: Cells, *, by_entries: bool = False
    ) -> "Arrivals":
        """Compute the probabilities from a transition matrix and the mask of a target."""
        can, may_fail = prospects(matrix, there)
        value = np.where(can & ~may_fail, 1.0, 0.0)
        part = Transient.of(matrix, can & may_fail & ~there)
        value[there] = 1
        gain = matrix[part.cells] @ value
        ends = part.expect(gain[:, None], by_entries=by_entries)
        value[part.cells] = np.clip(ends.value[:, 0], 0, ALMOST_SURE)
        error = float(ends.error[:, 0].max(initial=0.0))
        relative = float(ends.relative[:, 0].max(initial=0.0))
        return cls(value, part, gain, relative, Certificate(ends.products, error, TOLERANCE))

    def scaled(self) -> tuple[Scaled, float] | None:
        """Compute the probabilities however small they are, and a bound on their relative errors.

        Returns `None` if it would take too long.
        """
        found = self.part.expect_scaled(self.gain)
        if found is None:
            return None
        value = Scaled.of(self.value)
        value[self.part.cells] = found[0]
        return value, found[1]


def conditioned(
    matrix: scipy.sparse.csr_array, arrives: Scaled
) -> tuple[scipy.sparse.csr_array, Scaled]:
    """Return the chain under the condition that it arrives (Doob's transform).

    The probability `p(x, y)` of a step becomes `p(x, y) h(y) / h(x)`, where `h` is `arrives`, the
    probability of arriving. The matrix may have several rows per cell, one per action. A row from
    which no path leads to the target becomes empty. Returns the sums of `p(x, y) h(y)` too.
    """
    row = np.repeat(np.arange(matrix.shape[0]), np.diff(matrix.indptr))
    product = Scaled.of(matrix.data) * arrives[matrix.indices]
    largest = np.full(matrix.shape[0], product.power.min(initial=0))
    np.maximum.at(largest, row, product.power)
    weight = Scaled(product.part, product.power - largest[row]).numbers
    # The sum of a row is `h` up to rounding; dividing by the sum removes the rounding.
    total = np.bincount(row, weight, matrix.shape[0]).astype(float)
    share = np.divide(weight, total[row], out=np.zeros_like(weight), where=total[row] > 0)
    result = scipy.sparse.csr_array((share, matrix.indices, matrix.indptr), matrix.shape)
    result = result.copy()
    result.eliminate_zeros()
    return result, Scaled.of(total, largest)
