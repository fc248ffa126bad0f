import dataclasses
from typing import Literal

import jax
import numpy as np
import numpy.typing as npt
import scipy.sparse
from jaxtyping import Array, Float, Int

from ..base.certificate import Certificate
from ..mapping.classes import PersistentGroups
from ..mapping.generalized import Chain, leaving_rows
from .hitting import group_of
from .solving.stationary import solve_stationary
from .transient import Transient


_TOLERANCE = 1e-10


@dataclasses.dataclass(frozen=True, eq=False)
class LimitingDistribution:
    """The share of the time that a chain spends in each cell in the long run."""

    value: Float[Array, "cells"]
    "The share of the time spent in each cell; the shares and `leaving` sum to 1."
    weights: Float[Array, "groups"]
    "The weight of each persistent group: the probability of ending in it."
    leaving: float
    "The probability of leaving the space from a random start; 0 if weights were given."
    certificate: Certificate


def limiting_distribution(
    chain: Chain,
    groups: PersistentGroups,
    weights: Literal["basin", "size"] | npt.ArrayLike | None = None,
    *,
    throw: bool = True,
) -> LimitingDistribution:
    """Compute the time average of a chain: the limit of `(p + p P + ... + p P^(n-1)) / n`.

    It exists even if the chain is periodic. Only the weights of the persistent groups depend on
    `p`, the distribution of the start.

    **Arguments:** a chain, its persistent groups, and the weights of the groups: numbers that sum
    to 1; `"size"`, for weights proportional to the sizes of the groups; or `"basin"`, the default,
    for the probabilities of ending in each group from a random start.

    **Returns:** the shares of the cells. The residual of the certificate is the larger of the
    1-norm of `value P - value` and `|sum(weights) + leaving - 1|`.

    A random walk on a line of three cells:

        >>> from jaxcell import examples, mapping, markov
        >>> chain = examples.walk()
        >>> groups = mapping.persistent_groups(chain)
        >>> markov.limiting_distribution(chain, groups).value.round(6).tolist()
        [0.25, 0.5, 0.25]
    """
    group = group_of(chain, groups)
    matrix = chain.to_scipy()
    share, leaving, weighed = _weights(matrix, groups, group, weights)
    inside = np.flatnonzero(group >= 0)
    within, products = solve_stationary(matrix[inside][:, inside], group[inside])
    value = np.zeros(chain.cells)
    value[inside] = within * share[group[inside]]
    residual = max(np.abs(matrix.T @ value - value).sum(), abs(share.sum() + leaving - 1))
    certificate = Certificate(weighed + products, float(residual), _TOLERANCE)
    certificate.check("limiting_distribution", throw)
    value, share = jax.device_put((value, share))
    return LimitingDistribution(value, share, leaving, certificate)


def _weights(
    matrix: scipy.sparse.csr_array,
    groups: PersistentGroups,
    group: Int[np.ndarray, "cells"],
    weights: npt.ArrayLike | None,
) -> tuple[Float[np.ndarray, "groups"], float, int]:
    """Return the weights of the groups and of the sink, and the number of matrix products."""
    if weights is None or (isinstance(weights, str) and weights == "basin"):
        return _basins(matrix, groups.count, group)
    if groups.count == 0:
        raise ValueError(
            "weights: the chain has no persistent groups; it leaves the space with probability 1"
        )
    if isinstance(weights, str):
        if weights != "size":
            raise ValueError(f"weights: expected 'basin', 'size' or an array, got {weights!r}")
        size = np.asarray(groups.size)
        return size / size.sum(), 0.0, 0
    share = np.asarray(weights, float)
    if share.shape != (groups.count,):
        raise ValueError(
            f"weights: expected {groups.count}, one per group, got shape {share.shape}"
        )
    if not (share.min() >= 0 and abs(share.sum() - 1) <= _TOLERANCE):
        raise ValueError(f"weights: expected numbers from 0 that sum to 1, got {share.tolist()}")
    return share, 0.0, 0


def _basins(
    matrix: scipy.sparse.csr_array, count: int, group: Int[np.ndarray, "cells"]
) -> tuple[Float[np.ndarray, "groups"], float, int]:
    leaving = leaving_rows(matrix)
    if count == 1 and not leaving.any():
        return np.ones(1), 0.0, 0
    start = np.full(group.size, 1 / group.size)
    part = Transient.of(matrix, group < 0)
    visits, products = part.visits(start[part.cells])
    branching = part.cells[part.branching]
    entering = matrix[branching].T @ visits
    inside = group >= 0
    share = np.zeros(count)
    np.add.at(share, group[inside], (start + entering)[inside])
    return share, float(leaving[branching] @ visits), products
