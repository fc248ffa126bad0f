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
from .traced import CERTIFIED, visited
from .transient import Transient, leaving_of


def visits(
    chain: ChainLike,
    start: npt.ArrayLike | int,
    within: npt.ArrayLike | int | None = None,
    *,
    throw: bool = True,
) -> Solution:
    """Compute the expected number of visits to each cell before a chain leaves a set of cells.

    For a start in one cell, the numbers are a row of the fundamental matrix `(I - Q)^-1` (Kemeny
    and Snell 1960, chapter 3). The start counts as a visit. Their sum is the expected time.

    **Arguments:**

    - `start`: a cell, a list of cells, a mask, or a distribution, as in
        [`jaxcell.markov.first_passage`][].
    - `within`: the cells in which visits count until the chain first leaves them, as a cell, a list
        or a mask; by default all transient cells, which the chain leaves when it is absorbed.

    **Returns:** the number of visits to each cell, 0 outside the set, and `inf` for cells that are
    reached but from which the set cannot be left. The residual of the certificate bounds the sum of
    the errors of the finite numbers, relative to their sum.

    A random walk on a line of four cells, which stops at both ends:

        >>> from jaxcell import examples, markov
        >>> (3 * markov.visits(examples.ruin(), start=1).value).round(6).tolist()
        [0.0, 4.0, 2.0, 0.0]
    """
    inside = _within(chain, within)
    return _visits(chain, start_distribution(chain.cells, start), inside, "visits", throw)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Exits(Pictured):
    """The cells by which a chain leaves a set, at its first step out of it."""

    last: Float[Array, "cells"]
    """The probability that each cell is the last one before the chain leaves the set; the sum is
    the probability of ever leaving it from inside. The next step may lead out of the space."""
    first: Float[Array, "cells"]
    """The probability that each cell is the first one outside the set; a start outside is its own
    exit."""
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
    inside = _within(chain, within)
    begin = start_distribution(chain.cells, start)
    found = _visits(chain, begin, inside, "exit_distribution", throw, exits=True)
    last, first = _exits(chain, *put_on_device((begin, inside, found.value)))
    return Exits(last, first, found.certificate)


def _within(chain: Chain, within: npt.ArrayLike | int | None) -> Any:
    if within is None:
        return persistent_groups(chain).group < 0
    return cell_mask(chain.cells, within, "within")


@jax.jit
def _exits(
    chain: Chain,
    start: Float[Array, "cells"],
    inside: Bool[Array, "cells"],
    visits: Float[Array, "cells"],
) -> tuple[Float[Array, "cells"], Float[Array, "cells"]]:
    # Cells with infinitely many visits have no step out of the set.
    counted = jnp.where(jnp.isfinite(visits), visits, 0.0)
    first = jnp.where(inside, 0.0, start + chain.push(counted))
    return counted * out_of(chain, inside), first


def out_of(chain: Chain, inside: Bool[Array, "cells"]) -> Float[Array, "cells"]:
    """Return the probability of a step from each cell out of a set, as a sum of probabilities."""
    return chain.leaving + jnp.sum(jnp.where(inside[chain.image], 0.0, chain.probability), axis=0)


def _visits(
    chain: Chain, start: Any, inside: Any, caller: str, throw: bool, exits: bool = False
) -> Solution:
    """Compute the visits, and the certificate of all exits if `exits`, otherwise of the visits."""
    require_x64(caller)
    form = like(float, chain.cells), like(bool, chain.cells), like(bool, chain.cells), *CERTIFIED
    value, part, endless, products, *errors = on_host(
        _counted, (*form, like(float)), chain, start, inside
    )
    sound = jnp.where(jnp.isnan(start).any(), jnp.nan, 0.0) if traced(start) else 0.0
    certificate = Certificate(products, errors[exits] + sound, TOLERANCE)
    certificate.check(caller, throw)
    value = visited(value, chain, part, start)
    value = namespace(value).where(endless, np.inf, value)
    return Solution(put_on_device(value), certificate)


def _counted(
    matrix: scipy.sparse.csr_array, start: Float[np.ndarray, "cells"], inside: Cells
) -> tuple[Any, ...]:
    """Return the visits of the cells that can be left, these cells, and the cells without end."""
    inside = np.asarray(inside)
    among = scipy.sparse.diags_array(inside.astype(float)) @ matrix
    among = scipy.sparse.csr_array(among @ scipy.sparse.diags_array(inside.astype(float)))
    among.eliminate_zeros()
    part = inside & reaching(among, inside & (leaving_of(matrix, inside) > 0))
    endless = inside & ~part & reaching(among.T.tocsr(), inside & (start > 0))
    value = np.zeros(inside.size)
    transient = Transient.of(matrix, part)
    found = transient.visits(start[part])
    value[part] = found.value
    return value, part, endless, found.products, transient.sum_error(found), found.exits_error
