import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
import scipy.sparse
from jaxtyping import Array, Bool, Float

from ..base.certificate import Certificate, Solution
from ..base.divided import put_on_device
from ..base.precision import require_x64
from ..base.shown import Pictured
from ..base.wide import namespace, traced
from ..mapping.classes import persistent_groups, reaching
from ..mapping.generalized import Chain, ChainLike
from ..mapping.traced import like, on_host
from .hitting import TOLERANCE, Cells, cell_mask
from .passage import start_distribution
from .traced import CERTIFIED, expected
from .transient import Transient, leaving_of


def visits(
    chain: ChainLike,
    start: npt.ArrayLike | int,
    within: npt.ArrayLike | int | None = None,
    *,
    throw: bool = True,
) -> Solution:
    """Compute the expected number of visits to each cell before a chain leaves a set of cells.

    For one start, it is a row of the fundamental matrix `(I - Q)^-1` (Kemeny and Snell 1960). The
    start counts as a visit, so that the sum is the expected time.

    **Arguments:** a start as in [`jaxcell.markov.first_passage`][]; and the set, as a cell, a list
    of cells, or a mask, by default all transient cells, which the chain leaves when it is absorbed.

    **Returns:** the number of visits, 0 outside the set, and `inf` for cells that are reached, but
    from which the set cannot be left. The residual of the certificate bounds the sum of the errors
    of finite numbers, relative to their sum, and that of the probabilities of all ways out.

    A random walk on a line of four cells, which stops at both ends:

        >>> from jaxcell import examples, markov
        >>> (3 * markov.visits(examples.ruin(), start=1).value).round(6).tolist()
        [0.0, 4.0, 2.0, 0.0]
    """
    require_x64("visits")
    inside = (
        persistent_groups(chain).group < 0
        if within is None
        else cell_mask(chain.cells, within, "within")
    )
    begin = start_distribution(chain.cells, start)
    form = (like(float, chain.cells), like(bool, chain.cells), like(bool, chain.cells), *CERTIFIED)
    value, part, endless, products, error = on_host(_visits, form, chain, begin, inside)
    if traced(begin):
        error = jnp.where(jnp.isnan(begin).any(), jnp.nan, error)
    certificate = Certificate(products, error, TOLERANCE)
    certificate.check("visits", throw)
    value = expected(value, chain, part, begin, adjoint=True)
    return Solution(put_on_device(namespace(value).where(endless, np.inf, value)), certificate)


def _visits(
    matrix: scipy.sparse.csr_array, start: Float[np.ndarray, "cells"], inside: Cells
) -> tuple[Any, ...]:
    """Return the visits of the cells that can be left, these cells, and the cells without end."""
    inside = np.asarray(inside)
    cells = np.flatnonzero(inside)
    among = matrix[cells][:, cells]
    left = reaching(among, leaving_of(matrix[cells], inside) > 0)
    reached = reaching(among.T.tocsr(), start[cells] > 0)
    value, part, endless = np.zeros(inside.size), inside.copy(), np.zeros_like(inside)
    part[cells], endless[cells] = left, reached & ~left
    transient = Transient.of(matrix, part)
    found = transient.visits(start[part])
    value[part] = found.value
    return value, part, endless, found.products, max(transient.sum_error(found), found.exits_error)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Exits(Pictured):
    """The cells by which a chain leaves a set, at its first step out of it."""

    last: Float[Array, "cells"]
    "The probability that each cell is the last one in the set; the next may be out of the space."
    first: Float[Array, "cells"]
    "The probability that each cell is the first one outside; a start outside is its own exit."
    certificate: Certificate
    "The certificate; its residual bounds the sum of the errors of the probabilities `last`."


def exit_distribution(
    chain: ChainLike,
    start: npt.ArrayLike | int,
    within: npt.ArrayLike | int,
    *,
    throw: bool = True,
) -> Exits:
    """Compute the distributions of the cells by which a chain leaves a set.

    **Arguments:** as for [`visits`][]. **Returns:** the distributions of the last cell inside and
    of the first cell outside, which is also known as the hitting distribution of the complement.

    A random walk on a line of four cells, which stops at both ends, leaves the two cells between:

        >>> from jaxcell import examples, markov
        >>> exits = markov.exit_distribution(examples.ruin(), start=1, within=[1, 2])
        >>> (3 * exits.last).round(6).tolist(), (3 * exits.first).round(6).tolist()
        ([0.0, 2.0, 1.0, 0.0], [2.0, 0.0, 0.0, 1.0])
    """
    inside = cell_mask(chain.cells, within, "within")
    begin = start_distribution(chain.cells, start)
    found = visits(chain, begin, inside, throw=throw)
    # Cells with infinitely many visits have no step out of the set.
    counted = jnp.where(jnp.isfinite(found.value), found.value, 0.0)
    first = jnp.where(inside, 0.0, begin + chain.push(counted))
    return Exits(counted * out_of(chain, inside), first, found.certificate)


@jax.jit
def out_of(chain: Chain, inside: Bool[Array | np.ndarray, "cells"]) -> Float[Array, "cells"]:
    """Return the probability of a step from each cell out of a set, as a sum of probabilities."""
    inside = jnp.asarray(inside)
    return chain.leaving + jnp.sum(jnp.where(inside[chain.image], 0.0, chain.probability), axis=0)
