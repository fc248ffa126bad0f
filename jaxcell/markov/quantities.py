import math

import jax
import numpy as np
from jaxtyping import Float

from ..base.certificate import Certificate, Solution
from ..base.limits import MAX_VERTICES
from ..base.precision import require_x64
from ..mapping.classes import PersistentGroups, persistent_groups
from ..mapping.generalized import Chain
from . import dense
from .hitting import TIME_TOLERANCE
from .limiting import limiting_distribution
from .solving.stationary import Rooted


# Largest number of cells of a dense matrix, which then takes 800 MB; a solve holds a few of them.
_LARGEST_MATRIX = 10_000
# Added to a limit, so that rounding does not exclude a distance that equals it.
_TIE = 1e-12
# Largest number of squarings of a matrix; after more, rounding hides the spectral gap.
_SQUARINGS = 50


def hitting_matrix(chain: Chain, *, throw: bool = True) -> Solution:
    """Compute the expected number of steps between all pairs of cells from one matrix inverse.

    **Arguments:** an irreducible chain of at most 10,000 cells; for other chains, use
    [`jaxcell.markov.hitting_times`][] of one target. **Returns:** the times, a row per start. The
    residual of the certificate bounds the relative error of every time.

    A random walk on a line of three cells:

        >>> from jaxcell import examples, markov
        >>> markov.hitting_matrix(examples.walk()).value.round(6).tolist()
        [[0.0, 1.0, 4.0], [3.0, 0.0, 3.0], [4.0, 1.0, 0.0]]
    """
    return _hitting(chain, "hitting_matrix", throw)


def commute_times(chain: Chain, *, throw: bool = True) -> Solution:
    """Compute the expected number of steps from each cell to each other cell and back.

    **Arguments:** as for [`hitting_matrix`][]. **Returns:** the times of Alam 2018, Eq. 4.3.

    A random walk on a line of three cells:

        >>> from jaxcell import examples, markov
        >>> markov.commute_times(examples.walk()).value.round(6).tolist()
        [[0.0, 4.0, 8.0], [4.0, 0.0, 4.0], [8.0, 4.0, 0.0]]
    """
    there = _hitting(chain, "commute_times", throw)
    return Solution(there.value + there.value.T, there.certificate)


def kemeny_constant(chain: Chain) -> float:
    """Compute the expected number of steps to a cell drawn from the stationary distribution `pi`.

    It is `sum_j pi_j h_ij`, the same from every cell `i`. If the drawn cell is the start, the
    number of steps is 0; authors who count the steps until the return to this cell obtain 1 more.
    The relative error is close to machine precision.

    **Arguments:** as for [`hitting_matrix`][]. **Returns:** the constant.

    A random walk on a line of three cells:

        >>> from jaxcell import examples, markov
        >>> round(markov.kemeny_constant(examples.walk()), 6)
        1.5
    """
    groups = _only_group(chain, "kemeny_constant")
    likely = np.asarray(limiting_distribution(chain, groups, throw=False).value)
    rooted = Rooted.of(chain.to_scipy(), np.zeros(chain.cells, int), likely)
    with np.errstate(all="ignore"):
        visits = rooted.visits()
        share = np.append(rooted.entering.T @ visits, 1)
        share /= share.sum()
        # pi_j (h_j0 + h_0j) is the number of visits to j from j before the chain is at cell 0.
        constant = float(np.trace(visits) - share[:-1] @ visits.sum(axis=1))
    if not math.isfinite(constant):
        raise RuntimeError("kemeny_constant: the chain takes more than 1e308 steps")
    return constant


def entropy_rate(chain: Chain) -> float:
    """Compute the entropy of a step in the long run, `-sum_ij pi_i p_ij log p_ij`, in nats.

    **Arguments:** an irreducible chain of any size. **Returns:** the entropy.

    A random walk on a line of three cells, which has a choice in every second step:

        >>> from jaxcell import examples, markov
        >>> round(markov.entropy_rate(examples.walk()), 4)
        0.3466
    """
    groups = _only_group(chain, "entropy_rate", None)
    share = np.asarray(limiting_distribution(chain, groups).value)
    # This matrix has one entry for all branches with the same image.
    steps = chain.to_scipy()
    cell = np.repeat(np.arange(chain.cells), np.diff(steps.indptr))
    return float(np.sum(share[cell] * steps.data * np.log(1 / steps.data)))


def slem(chain: Chain) -> float:
    """Compute the second largest eigenvalue modulus of the transition matrix.

    In each step, the distance from the stationary distribution shrinks by about this factor. All
    eigenvalues are computed, which takes about 0.4 s for 750 cells; the time grows with the cube of
    the number of cells.

    **Arguments:** as for [`hitting_matrix`][]. **Returns:** the modulus. It is 1 for a periodic
    chain, which does not converge, and 0 for a chain of one cell.

    A chain of two cells that moves to the other cell with probability 1/4 in each step:

        >>> import numpy as np
        >>> from jaxcell import mapping, markov
        >>> chain = mapping.Chain.from_scipy(np.array([[0.75, 0.25], [0.25, 0.75]]))
        >>> round(markov.slem(chain), 6)
        0.5
    """
    groups = _only_group(chain, "slem")
    if groups.period[0] > 1:
        return 1.0
    modulus = np.sort(np.abs(np.linalg.eigvals(chain.to_scipy().toarray())))
    return float(modulus[-2]) if modulus.size > 1 else 0.0


def mixing_time(chain: Chain, distance: float = 0.25) -> float:
    """Compute the number of steps after which a chain has forgotten its start.

    It is the least `t` such that, for every start, the total variation (half the 1-norm of the
    difference) between the distribution after `t` steps and the stationary distribution is at most
    `distance`. The matrix is squared until a power is that close. Then `t` is found between the
    last two powers by bisection, because the distance never increases.

    **Arguments:** an irreducible chain of at most 2,000 cells, and a distance between 0 and 1/2.
    **Returns:** the number of steps; `inf` for a periodic chain, which does not converge.

    A chain of two cells that moves to the other cell with probability 1/4 in each step:

        >>> import numpy as np
        >>> from jaxcell import mapping, markov
        >>> chain = mapping.Chain.from_scipy(np.array([[0.75, 0.25], [0.25, 0.75]]))
        >>> markov.mixing_time(chain), markov.mixing_time(chain, distance=0.1)
        (1.0, 3.0)
    """
    if not 0 < distance < 0.5:
        raise ValueError(f"distance: expected more than 0 and less than 1/2, got {distance}")
    groups = _only_group(chain, "mixing_time", MAX_VERTICES)
    if groups.period[0] > 1:
        return math.inf
    share = np.asarray(limiting_distribution(chain, groups).value)

    def mixed(power: Float[np.ndarray, "cells cells"]) -> bool:
        return bool(np.abs(power - share).sum(axis=1).max() <= 2 * distance + _TIE)

    if mixed(np.eye(chain.cells)):
        return 0.0
    powers = [chain.to_scipy().toarray()]
    while not mixed(powers[-1]):
        if len(powers) > _SQUARINGS:
            raise RuntimeError(f"mixing_time: not mixed after 2**{_SQUARINGS} steps")
        powers.append(_product(powers[-1], powers[-1]))
    # Find the largest number of steps that is too few, one binary digit after the other.
    time, power = 0, np.eye(chain.cells)
    for digit in reversed(range(len(powers) - 1)):
        longer = _product(power, powers[digit])
        if not mixed(longer):
            time, power = time + 2**digit, longer
    return float(time + 1)


def _product(
    first: Float[np.ndarray, "cells cells"], second: Float[np.ndarray, "cells cells"]
) -> Float[np.ndarray, "cells cells"]:
    """Multiply two powers of a transition matrix, and normalize rows to remove rounding errors."""
    product = first @ second
    return product / product.sum(axis=1, keepdims=True)


def _hitting(chain: Chain, caller: str, throw: bool) -> Solution:
    _only_group(chain, caller)
    matrix = chain.to_scipy()
    value = np.array(dense.hitting(matrix.toarray()))
    np.fill_diagonal(value, 0)
    # With h = 1 + P h + r off the diagonal, the error is at most max |r| times the true time.
    gap = 1 + matrix @ value - value
    np.fill_diagonal(gap, 0)
    certificate = Certificate(1, float(np.abs(gap).max()), TIME_TOLERANCE)
    certificate.check(caller, throw)
    return Solution(jax.device_put(value), certificate)


def _only_group(chain: Chain, caller: str, most: int | None = _LARGEST_MATRIX) -> PersistentGroups:
    """Check that a chain is irreducible, with at most `most` cells, and return its only group."""
    require_x64(caller)
    if most is not None and chain.cells > most:
        raise ValueError(
            f"{caller}: the chain has {chain.cells} cells, and the matrices of a chain of more "
            f"than {most} take gigabytes; hitting_times and limiting_distribution are sparse"
        )
    groups = persistent_groups(chain)
    group = np.asarray(groups.group)
    lost = np.flatnonzero(group != 0)
    if lost.size:
        cell = lost[0]
        why = "is transient" if group[cell] < 0 else "is in another persistent group than cell 0"
        raise ValueError(
            f"{caller}: expected an irreducible chain, but cell {cell} {why}; hitting_times "
            "serves any chain"
        )
    return groups
