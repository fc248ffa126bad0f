import dataclasses
import functools
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
import scipy.sparse
from jaxtyping import Array, Float, Int

from ..base.certificate import Certificate, Real
from ..base.divided import of_members, put_on_device
from ..base.indices import as_array
from ..base.precision import require_x64
from ..base.shown import Pictured
from ..base.wide import traced
from ..mapping.batch import Batch, Sums
from ..mapping.classes import PersistentGroups, check_groups, persistent_groups
from ..mapping.generalized import Chain, ChainLike, leaving_rows
from ..mapping.traced import implicit, like, on_host
from .solving.rounds import eliminated
from .solving.stationary import solve_stationary
from .traced import CERTIFIED, solve
from .transient import Transient


_TOLERANCE = 1e-8


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class LimitingDistribution(Pictured):
    """The share of the time that a chain spends in each cell in the long run."""

    value: Float[Array, "cells"]
    "The share of the time spent in each cell; the shares and `leaving` sum to 1."
    weights: Float[Array, "groups"]
    "The weight of each persistent group: the probability of ending in it."
    leaving: Real
    "The probability of leaving the space from a random start; 0 if weights were given."
    certificate: Certificate


def limiting_distribution(
    chain: ChainLike,
    groups: PersistentGroups | None = None,
    weights: Literal["basin", "size"] | npt.ArrayLike | None = None,
    *,
    throw: bool = True,
) -> LimitingDistribution:
    """Compute the time average of a chain: the limit of `(p + p P + ... + p P^(n-1)) / n`.

    It exists even if the chain is periodic. Only the weights of the persistent groups depend on
    `p`, the distribution of the start.

    **Arguments:** a chain, its persistent groups, which are found if they are not given, and the
    weights of the groups: numbers that sum to 1, one per group (if the chain is traced, one per
    cell, with zeros after the groups); `"size"`, for weights proportional to the sizes of the
    groups; or `"basin"`, the default, for the probabilities of ending in each group from a random
    start.

    **Returns:** the shares of the cells. The residual of the certificate is the larger of the
    1-norm of `value P - value` and a bound on the sum of the errors of weights and of `leaving`.

    A random walk on a line of three cells:

        >>> import numpy as np
        >>> from jaxcell import markov
        >>> P = np.array([[0, 1, 0], [0.5, 0, 0.5], [0, 1, 0]])
        >>> markov.limiting_distribution(P).value.round(6).tolist()
        [0.25, 0.5, 0.25]
    """
    require_x64("limiting_distribution")
    limit, _ = limit_of(chain, groups, weights)
    limit.certificate.check("limiting_distribution", throw)
    return limit


def limit_of(
    chain: Chain,
    groups: PersistentGroups | None = None,
    weights: Any = None,
    *,
    by_entries: bool = False,
) -> tuple[LimitingDistribution, Any]:
    """Compute [`limiting_distribution`][], and a bound on its relative errors in each group."""
    groups = groups or persistent_groups(chain)
    group = check_groups(chain, groups)
    share, leaving, *about = _weights(chain, groups, group, weights)
    form = like(float, chain.cells), *CERTIFIED, like(float)
    given = chain, group, share, *about
    compute = functools.partial(_limit, by_entries=by_entries)
    value, products, residual, relative = on_host(compute, form, *given, many=_limit_of_many)
    certificate = Certificate(products, residual, _TOLERANCE)
    if traced(chain, groups, share):
        value = implicit(_change, value, (chain, group, share))
    value, share = put_on_device((value, share))
    return LimitingDistribution(value, share, leaving, certificate), relative


def _limit(
    matrix: scipy.sparse.csr_array,
    group: Int[np.ndarray, "cells"],
    share: Float[np.ndarray, "groups"],
    products: int,
    uncertain: float,
    *,
    by_entries: bool,
) -> tuple[Float[np.ndarray, "cells"], int, float, float]:
    inside = np.flatnonzero(group >= 0)
    within, more, relative = solve_stationary(
        matrix[inside][:, inside], group[inside], by_entries=by_entries
    )
    value = np.zeros(group.size)
    value[inside] = within * share[group[inside]]
    residual = max(np.abs(matrix.T @ value - value).sum(), uncertain)
    return value, int(products) + more, float(residual), relative


def _limit_of_many(
    batch: Batch,
    group: Int[np.ndarray, "cells"],
    share: Float[np.ndarray, "members groups"],
    products: int,
    uncertain: Float[np.ndarray, "members"],
) -> tuple[Any, int, Any, Any]:
    """Compute the visits to each cell between two visits to the first cell of its group."""
    cells = np.flatnonzero(group >= 0)
    root = np.zeros((group.size, 1))
    root[cells[np.unique(group[cells], return_index=True)[1]]] = 1
    visits, error = eliminated(
        batch, (group >= 0) & (root[:, 0] == 0), batch.push(root)[:-1], adjoint=True
    )
    value = np.zeros((group.size, len(share))) + visits + root
    total = np.zeros((share.shape[1], value.shape[1]))
    Sums.of(group[cells]).add(total, value[cells])
    with np.errstate(all="ignore"):
        value[cells] *= (share.T / total)[group[cells]]
    left = np.abs(batch.push(value)[:-1] - value).sum(axis=0)
    return value.T, products, np.maximum(left, uncertain), 2 * error


def _change(value: Float[Array, "cells"], inputs: Any) -> Float[Array, "cells"]:
    """Compute the limiting distribution from its values, for its derivatives.

    In each group, shares are proportional to the visits to cells between two visits to the
    likeliest cell.
    """
    chain, group, share = inputs
    rows = share.size
    place = jnp.where(group >= 0, group, rows)
    most = jax.ops.segment_max(value, place, rows + 1)[place]
    first = jnp.arange(group.size, dtype=group.dtype)
    root = jax.ops.segment_min(jnp.where(value == most, first, group.size), place, rows + 1)
    is_root = (first == root[place]) & (group >= 0)
    visits = jnp.where(group >= 0, value / jnp.where(most > 0, most, 1.0), 0.0)
    visits = jnp.where(is_root, 1.0, visits)
    left = chain.push(visits) - visits
    inside = (group >= 0) & ~is_root
    visits = visits + solve(chain, inside, left - jax.lax.stop_gradient(left), adjoint=True)
    total = jax.ops.segment_sum(visits, place, rows + 1)
    total, share = (of_members(x, place)[place] for x in (total, jnp.pad(share, (0, 1))))
    return jnp.where(group >= 0, visits / total * share, 0.0)


def _weights(
    chain: Chain,
    groups: PersistentGroups,
    group: Int[Array | np.ndarray, "cells"],
    weights: npt.ArrayLike | None,
) -> tuple[Any, Any, Any, Any]:
    """Return the weights of groups and sink, the number of products, and a bound on errors."""
    rows = groups.size.shape[0]
    if weights is None or (isinstance(weights, str) and weights == "basin"):
        form = like(float, rows), like(float), *CERTIFIED
        compute = functools.partial(_basins, rows=rows)
        many = functools.partial(_basins_of_many, rows=rows)
        share, leaving, *about = on_host(compute, form, chain, group, many=many)
        if traced(chain, groups):
            share, leaving = implicit(_basins_change, (share, leaving), (chain, group))
        return share, leaving, *about
    if not rows:
        raise ValueError(
            "weights: the chain has no persistent groups; it leaves the space with probability 1"
        )
    if isinstance(weights, str):
        if weights != "size":
            raise ValueError(f"weights: expected 'basin', 'size' or an array, got {weights!r}")
        size = groups.size.astype(np.float64)
        return size / size.sum(), 0.0, 0, 0.0
    share = as_array(weights, "weights")
    if share.shape != (rows,):
        raise ValueError(f"weights: expected {rows}, one per group, got shape {share.shape}")
    if traced(share):
        right = (share.min() >= 0) & (jnp.abs(share.sum() - 1) <= _TOLERANCE)
        return jnp.where(right, share, jnp.nan), 0.0, 0, 0.0
    share = np.asarray(share, float)
    if not (share.min() >= 0 and abs(share.sum() - 1) <= _TOLERANCE):
        raise ValueError(f"weights: expected numbers from 0 that sum to 1, got {share.tolist()}")
    return share, 0.0, 0, 0.0


def _basins_change(now: Any, inputs: Any) -> tuple[Float[Array, "groups"], Float[Array, ""]]:
    """Compute the weights of basins and the probability of leaving, for their derivatives."""
    chain, group = inputs
    start = jnp.full(group.size, 1 / group.size)
    visits = solve(chain, group < 0, start, adjoint=True)
    entering = jnp.where(group >= 0, start + chain.push(visits), 0.0)
    share = jax.ops.segment_sum(entering, jnp.maximum(group, 0), now[0].size)
    return share, chain.leaving @ visits


def _basins(
    matrix: scipy.sparse.csr_array, group: Int[np.ndarray, "cells"], rows: int
) -> tuple[Float[np.ndarray, "groups"], float, int, float]:
    leaving = leaving_rows(matrix)
    if group.max() == 0 and not leaving.any():
        return (np.arange(rows) == 0).astype(float), 0.0, 0, 0.0
    start = np.full(group.size, 1 / group.size)
    part = Transient.of(matrix, group < 0)
    visited = part.visits(start[part.cells])
    entering = matrix[part.cells].T @ visited.value
    inside = group >= 0
    share = np.zeros(rows)
    np.add.at(share, group[inside], (start + entering)[inside])
    left = float(leaving[part.cells] @ visited.value)
    return share, left, visited.products, visited.exits_error


def _basins_of_many(
    batch: Batch, group: Int[np.ndarray, "cells"], rows: int
) -> tuple[Any, Any, int, Any]:
    if group.max() == 0 and not (batch.head == group.size).any():
        return (np.arange(rows) == 0).astype(float), 0.0, 0, 0.0
    start = np.full((group.size, batch.chance.shape[1]), 1 / group.size)
    visits, error = eliminated(batch, group < 0, start, adjoint=True)
    entering = batch.push(visits)
    inside = np.flatnonzero(group >= 0)
    share = np.zeros((rows, start.shape[1]))
    Sums.of(group[inside]).add(share, (start + entering[:-1])[inside])
    return share.T, entering[-1], 0, error
