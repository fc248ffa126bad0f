import functools
import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg
import scipy.sparse
from jaxtyping import Array, Float, Int

from ..base.certificate import Certificate, Real, Solution
from ..base.divided import put_on_device
from ..base.limits import MAX_VERTICES
from ..base.precision import require_x64
from ..base.wide import traced
from ..mapping.classes import closed_classes, periods, persistent_groups
from ..mapping.generalized import Chain, ChainLike
from ..mapping.traced import first_derivative_only, implicit, like, on_host
from . import dense
from .hitting import TOLERANCE
from .limiting import limiting_distribution
from .solving.all_pairs import times_between_all
from .solving.stationary import Rooted, solve_stationary
from .traced import CERTIFIED


# Largest number of cells of a dense matrix, which then takes 800 MB; a solve holds a few of them.
_LARGEST_MATRIX = 10_000
# Added to a limit, so that rounding does not exclude a distance that equals it.
_TIE = 1e-12
# Largest number of squarings of a matrix; after more, rounding hides the spectral gap.
_SQUARINGS = 50


def hitting_matrix(chain: ChainLike, *, throw: bool = True) -> Solution:
    """Compute the expected number of steps between all pairs of cells.

    **Arguments:** an irreducible chain of at most 10,000 cells; for other chains, use
    [`jaxcell.markov.hitting_times`][] of one target. **Returns:** the times, a row per start. The
    residual of the certificate bounds the relative error of every time.

    A random walk on a line of three cells:

        >>> from jaxcell import examples, markov
        >>> markov.hitting_matrix(examples.walk()).value.round(6).tolist()
        [[0.0, 1.0, 4.0], [3.0, 0.0, 3.0], [4.0, 1.0, 0.0]]
    """
    return _hitting(chain, "hitting_matrix", throw)


def commute_times(chain: ChainLike, *, throw: bool = True) -> Solution:
    """Compute the expected number of steps from each cell to each other cell and back.

    **Arguments:** as for [`hitting_matrix`][]. **Returns:** the times of Alam 2018, Eq. 4.3.

    A random walk on a line of three cells:

        >>> from jaxcell import examples, markov
        >>> markov.commute_times(examples.walk()).value.round(6).tolist()
        [[0.0, 4.0, 8.0], [4.0, 0.0, 4.0], [8.0, 4.0, 0.0]]
    """
    there = _hitting(chain, "commute_times", throw)
    return Solution(there.value + there.value.T, there.certificate)


def kemeny_constant(chain: ChainLike) -> Real:
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
    constant = _of_irreducible(_kemeny, like(float), chain, "kemeny_constant")
    return _derived(dense.kemeny, constant, chain) if traced(chain) else float(constant)


def _kemeny(matrix: scipy.sparse.csr_array, group: Int[np.ndarray, "cells"]) -> float:
    likely, *_ = solve_stationary(matrix, group)
    rooted = Rooted.of(matrix, group, likely)
    with np.errstate(all="ignore"):
        visits = rooted.visits()
        share = np.append(rooted.entering.T @ visits, 1)
        share /= share.sum()
        # pi_j (h_j0 + h_0j) is the number of visits to j from j before the chain is at cell 0.
        constant = float(np.trace(visits) - share[:-1] @ visits.sum(axis=1))
    if not math.isfinite(constant):
        raise RuntimeError("kemeny_constant: the chain takes more than 1e308 steps")
    return constant


def entropy_rate(chain: ChainLike) -> Real:
    """Compute the entropy of a step in the long run, `-sum_ij pi_i p_ij log p_ij`, in nats.

    **Arguments:** a chain of any size with one persistent group, in which it ends for sure; it may
    have transient cells. **Returns:** the entropy.

    A random walk on a line of three cells, which has a choice in every second step:

        >>> from jaxcell import examples, markov
        >>> round(markov.entropy_rate(examples.walk()), 4)
        0.3466
    """
    require_x64("entropy_rate")
    groups = persistent_groups(chain)
    ends = groups.count == 1
    if not traced(chain) and (not ends or chain.can_leave.any()):
        raise ValueError(
            f"entropy_rate: expected a chain that ends in one persistent group, got {groups.count}"
            f"{', and cells that leave the space' * bool(chain.can_leave.any())}"
        )
    share = limiting_distribution(chain, groups).value
    rate = on_host(_entropy, like(float), chain, share)
    if not traced(chain):
        return float(rate)
    surprise = on_host(_surprise, like(float, *chain.image.shape), chain, chain.image)
    rate = implicit(_entropy_change, rate, (chain, share, surprise))
    found: Any = jnp.where(ends & ~jnp.any(chain.leaving > 0), rate, jnp.nan)
    return found


def _entropy(matrix: scipy.sparse.csr_array, share: Float[np.ndarray, "cells"]) -> float:
    # This matrix has one entry for all branches with the same image.
    cell = np.repeat(np.arange(share.size), np.diff(matrix.indptr))
    return float(np.sum(np.asarray(share)[cell] * matrix.data * np.log(1 / matrix.data)))


def _surprise(
    matrix: scipy.sparse.csr_array, image: Int[np.ndarray, "branches cells"]
) -> Float[np.ndarray, "branches cells"]:
    """Return `-log p - 1` of the step of each branch; 0 for branches that are not used."""
    cell = np.broadcast_to(np.arange(image.shape[1]), image.shape)
    p = np.reshape(matrix[cell.ravel(), image.ravel()], image.shape)
    return np.where(p > 0, -np.log(np.where(p > 0, p, 1.0)) - 1, 0.0)


@first_derivative_only("entropy_rate")
def _entropy_change(_: Any, inputs: Any) -> Float[Array, ""]:
    chain, share, surprise = inputs
    # The entropy of a cell is the sum over its branches plus 1, the sum of its probabilities.
    of_cell = jnp.sum(chain.probability * surprise, axis=0)
    fixed = of_cell + jax.lax.stop_gradient(jnp.sum(chain.probability, axis=0))
    return share @ fixed


def slem(chain: ChainLike) -> Real:
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
    modulus = _of_irreducible(_slem, like(float), chain, "slem")
    if not traced(chain):
        return float(modulus)
    slope = on_host(_slem_slope, like(float, *chain.image.shape), chain, chain.image)
    return implicit(_slem_change, modulus, (chain.probability, slope))


def _slem(matrix: scipy.sparse.csr_array, group: Int[np.ndarray, "cells"]) -> float:
    if periods(matrix, group, 1)[0] > 1:
        return 1.0
    modulus = np.sort(np.abs(np.linalg.eigvals(matrix.toarray())))
    return float(modulus[-2]) if modulus.size > 1 else 0.0


def _slem_slope(
    matrix: scipy.sparse.csr_array, image: Int[np.ndarray, "branches cells"]
) -> Float[np.ndarray, "branches cells"]:
    """Compute the derivative of a simple eigenvalue's modulus by the probability of each branch."""
    if matrix.shape[0] == 1:
        return np.zeros(image.shape)
    values, left, right = scipy.linalg.eig(matrix.toarray(), left=True)
    second = np.argsort(np.abs(values), kind="stable")[-2]
    value, u, v = values[second], left[:, second].conj(), right[:, second]
    return ((value.conj() / abs(value)) * u * v[image] / (u @ v)).real


@first_derivative_only("slem")
def _slem_change(_: Any, inputs: Any) -> Float[Array, ""]:
    probability, slope = inputs
    return jnp.sum(probability * slope)


def mixing_time(chain: ChainLike, distance: float = 0.25) -> Real:
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
    compute = functools.partial(_mixing_time, distance=float(distance))
    time = _of_irreducible(compute, like(float), chain, "mixing_time", MAX_VERTICES)
    return time if traced(chain) else float(time)


def _mixing_time(
    matrix: scipy.sparse.csr_array, group: Int[np.ndarray, "cells"], distance: float
) -> float:
    if periods(matrix, group, 1)[0] > 1:
        return math.inf
    share, *_ = solve_stationary(matrix, group)

    def mixed(power: Float[np.ndarray, "cells cells"]) -> bool:
        return bool(np.abs(power - share).sum(axis=1).max() <= 2 * distance + _TIE)

    if mixed(np.eye(share.size)):
        return 0.0
    powers = [matrix.toarray()]
    while not mixed(powers[-1]):
        if len(powers) > _SQUARINGS:
            raise RuntimeError(f"mixing_time: not mixed after 2**{_SQUARINGS} steps")
        powers.append(_product(powers[-1], powers[-1]))
    # Find the largest number of steps that is too few, one binary digit after the other.
    time, power = 0, np.eye(share.size)
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
    form = like(float, chain.cells, chain.cells), *CERTIFIED
    value, products, error = _of_irreducible(_between_all, form, chain, caller)
    certificate = Certificate(products, error, TOLERANCE)
    certificate.check(caller, throw)
    if traced(chain):
        value = _derived(dense.hitting, value, chain)
    return Solution(put_on_device(value), certificate)


def _between_all(
    matrix: scipy.sparse.csr_array, _: Any
) -> tuple[Float[np.ndarray, "cells cells"], int, float]:
    value, error = times_between_all(matrix.toarray())
    return value, 1, error


def _derived(quantity: Callable[[Any], Any], value: Any, chain: Chain) -> Any:
    """Return `value` with the derivatives of a quantity of the dense transition matrix."""
    return implicit(lambda _, P: quantity(P), value, dense.matrix(chain))


def _of_irreducible(
    compute: Callable[..., Any], form: Any, chain: Chain, caller: str, most: int = _LARGEST_MATRIX
) -> Any:
    """Compute a quantity of an irreducible chain of at most `most` cells."""
    require_x64(caller)
    if chain.cells > most:
        raise ValueError(
            f"{caller}: the chain has {chain.cells} cells, and the matrices of a chain of more "
            f"than {most} take gigabytes; hitting_times and limiting_distribution are sparse"
        )

    return on_host(functools.partial(_checked, compute, caller), form, chain)


def _checked(compute: Callable[..., Any], caller: str, matrix: scipy.sparse.csr_array) -> Any:
    group = closed_classes(matrix)[0]
    lost = np.flatnonzero(group != 0)
    if lost.size:
        cell = lost[0]
        where = "transient" if group[cell] < 0 else "in another persistent group than cell 0"
        raise ValueError(
            f"{caller}: expected an irreducible chain, but cell {cell} is {where}; "
            "hitting_times serves any chain"
        )
    return compute(matrix, group)
