import dataclasses
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
import scipy.sparse
from jaxtyping import Array, Bool, Float, Int

from ..base.certificate import Certificate, Solution
from ..base.precision import require_x64
from ..mapping.classes import PersistentGroups, reaching
from ..mapping.generalized import Chain, leaving_rows
from .transient import Transient


# Tolerances of the relative error of a time, and of the absolute error of a probability.
TIME_TOLERANCE = 1e-6
PROBABILITY_TOLERANCE = 1e-10
# Largest number of refinements of probabilities.
_REFINEMENTS = 4


@dataclasses.dataclass(frozen=True, eq=False)
class Absorption:
    """The end of a chain from each cell. The probabilities of a cell and leaving sum to 1."""

    value: Float[Array, "groups cells"]
    "The probability of ending in each persistent group."
    leaving: Float[Array, "cells"]
    "The probability of leaving the space for the sink."
    certificate: Certificate


def absorption_probabilities(
    chain: Chain, groups: PersistentGroups, *, throw: bool = True
) -> Absorption:
    """Compute the probability that a chain ends in each persistent group: its stochastic basins.

    **Arguments:** a chain, and its persistent groups. **Returns:** probabilities by group and cell;
    nothing is solved if there is only one end. The residual of the certificate is the largest
    difference, over cells and groups, of the probability of a cell from the mean over its images,
    or of the sum of its probabilities from 1.

    **Raises:** `RuntimeError` if the solve stalls; `ValueError` if the groups are of another chain.

    A random walk between two ends, where it stays:

        >>> from jaxcell import examples, mapping, markov
        >>> chain = examples.ruin()
        >>> groups = mapping.persistent_groups(chain)
        >>> (3 * markov.absorption_probabilities(chain, groups).value).round(6).tolist()
        [[3.0, 2.0, 1.0, 0.0], [0.0, 1.0, 2.0, 3.0]]
    """
    group = group_of(chain, groups)
    matrix = chain.to_scipy()
    part = Transient.of(matrix, group < 0)
    rows = matrix[part.cells]
    count = groups.count
    # A column per group and a column for the sink.
    gain = np.zeros((part.cells.size, count + 1))
    cell = np.repeat(np.arange(part.cells.size), np.diff(rows.indptr))
    into = group[rows.indices]
    np.add.at(gain, (cell[into >= 0], into[into >= 0]), rows.data[into >= 0])
    gain[:, -1] = leaving_rows(matrix)[part.cells]
    ends, certificate = _ends(part, gain)
    certificate.check("absorption_probabilities", throw)
    value = np.zeros((count + 1, chain.cells))
    value[group[group >= 0], np.flatnonzero(group >= 0)] = 1
    value[:, part.cells] = ends.T
    return Absorption(jax.device_put(value[:-1]), jax.device_put(value[-1]), certificate)


def _ends(
    part: Transient, gain: Float[np.ndarray, "part ends"]
) -> tuple[Float[np.ndarray, "part ends"], Certificate]:
    """Compute the probability of every end from each cell of a part."""
    possible = gain.any(axis=0)
    if possible.sum() == 1:
        value, products = np.broadcast_to(possible.astype(float), gain.shape), 0
    else:
        value, products = part.expect(gain)
    residual = _error(part, gain, value)
    for _ in range(_REFINEMENTS):
        if residual <= PROBABILITY_TOLERANCE:
            break
        left = _left(part, gain, value)
        change, more = part.expect(np.concatenate([np.maximum(left, 0), np.maximum(-left, 0)], 1))
        higher, lower = np.split(change, 2, axis=1)
        better = np.clip(value + higher - lower, 0, 1)
        products += more
        error = _error(part, gain, better)
        if not error < residual:
            break
        value, residual = better, error
    return value, Certificate(products, residual, PROBABILITY_TOLERANCE)


def _error(
    part: Transient, gain: Float[np.ndarray, "part ends"], value: Float[np.ndarray, "part ends"]
) -> float:
    """Return the largest difference from the means over images, or of a sum from 1."""
    mean = np.abs(gain + part.step @ value - value).max(initial=0.0)
    return float(max(mean, np.abs(value.sum(axis=1) - 1).max(initial=0.0)))


def _left(
    part: Transient, gain: Float[np.ndarray, "part ends"], value: Float[np.ndarray, "part ends"]
) -> Float[np.ndarray, "part ends"]:
    """Compute the residual of an iterative refinement, `gain + Q x - x`, from differences only.

    It is the sum of `p (x' - x)` over the steps from a cell. So a row counts as if it summed to 1
    exactly, although its rounding may be as large as a rare step out of the part; and where cells
    nearly agree, their small differences have all their digits.
    """
    step, columns = part.step, []
    row = np.repeat(np.arange(part.cells.size), np.diff(step.indptr))
    for into, x in zip(gain.T, value.T, strict=True):
        within = np.bincount(row, step.data * (x[step.indices] - x[row]), x.size)
        columns.append(within + into * (1 - x) - (gain.sum(axis=1) - into) * x)
    return np.stack(columns, axis=1)


def absorption_times(chain: Chain, groups: PersistentGroups, *, throw: bool = True) -> Solution:
    """Compute the expected number of steps until a chain is in a persistent group or has left.

    **Arguments:** a chain, and its persistent groups. **Returns:** times, 0 on the groups. The
    residual of the certificate bounds the relative error of every time. Errors are those of
    [`absorption_probabilities`][].

    A random walk between two ends, where it stays:

        >>> from jaxcell import examples, mapping, markov
        >>> chain = examples.ruin()
        >>> groups = mapping.persistent_groups(chain)
        >>> markov.absorption_times(chain, groups).value.round(6).tolist()
        [0.0, 2.0, 2.0, 0.0]
    """
    transient = group_of(chain, groups) < 0
    time = np.zeros(chain.cells)
    return _times(chain.to_scipy(), transient, time, "absorption_times", throw)


def hitting_times(
    chain: Chain,
    target: npt.ArrayLike | int,
    *,
    throw: bool = True,
) -> Solution:
    """Compute the expected number of steps until a chain is first in a set of cells.

    **Arguments:** a chain, and a cell, a list of cells, or a mask over the cells. **Returns:**
    times, 0 on the target, and `inf` where the chain may never arrive, because it can end elsewhere
    or leave the space first. The residual of the certificate bounds the relative error of every
    finite time; `moved` is about the error that the samples of a chain cause.

    **Raises:** `RuntimeError` if the solve stalls; `ValueError` for a wrong target.

    A random walk on a line of three cells:

        >>> from jaxcell import examples, markov
        >>> chain = examples.walk()
        >>> markov.hitting_times(chain, target=2).value.round(6).tolist()
        [4.0, 3.0, 0.0]
    """
    require_x64("hitting_times")
    there = cell_mask(chain.cells, target)
    matrix = chain.to_scipy()
    _, may_fail = prospects(matrix, there)
    time = np.where(may_fail, np.inf, 0.0)
    times = _times(matrix, ~may_fail & ~there, time, "hitting_times", throw)
    return with_moved(times, chain, lambda half: hitting_times(half, there, throw=False))


def with_moved(solution: Solution, chain: Chain, solve: Callable[[Chain], Solution]) -> Solution:
    """Add to a solution how far half of the samples of a chain move each value."""
    if chain.half is None:
        return solution
    value, other = solution.value, solve(chain.half).value
    moved = jnp.where(value == other, 0.0, jnp.abs(value - other))
    return dataclasses.replace(solution, moved=moved)


def _times(
    matrix: scipy.sparse.csr_array,
    inside: Bool[np.ndarray, "cells"],
    time: Float[np.ndarray, "cells"],
    what: str,
    throw: bool,
) -> Solution:
    """Compute the expected numbers of steps until a part of a chain is left; fill them in."""
    steps, certificate = leaving_times(matrix, inside)
    certificate.check(what, throw)
    # A time below 1 is noise of a time that is too long for 64-bit numbers.
    time[inside] = np.where(steps >= 1 - TIME_TOLERANCE, steps, np.inf)
    return Solution(jax.device_put(time), certificate)


def prospects(
    matrix: scipy.sparse.csr_array, there: Bool[np.ndarray, "cells"]
) -> tuple[Bool[np.ndarray, "cells"], Bool[np.ndarray, "cells"]]:
    """Return masks of the cells from which a chain can come to a set, and can fail to."""
    can = reaching(matrix, there)
    # Cells beyond the target do not count.
    before = matrix.copy()
    before.data[np.repeat(there, np.diff(before.indptr))] = 0
    before.eliminate_zeros()
    return can, reaching(before, ~there & (~can | (leaving_rows(matrix) > 0)))


def leaving_times(
    matrix: scipy.sparse.csr_array, inside: Bool[np.ndarray, "cells"]
) -> tuple[Float[np.ndarray, "inside"], Certificate]:
    """Compute the expected numbers of steps until a chain leaves cells that it cannot stay in."""
    part = Transient.of(matrix, inside)
    gain = np.ones((part.cells.size, 1))
    steps, products = part.expect(gain)
    # With t = 1 + Q t + r and 0 <= t, the error is at most max |r| times the true time.
    residual = np.abs(gain + part.step @ steps - steps).max(initial=0.0)
    return steps[:, 0], Certificate(products, float(residual), TIME_TOLERANCE)


def group_of(chain: Chain, groups: PersistentGroups) -> Int[np.ndarray, "cells"]:
    """Return the persistent group of each cell, on the host.

    **Raises:** `ValueError` if the groups are of another chain; `RuntimeError` where JAX is set to
    32 bits.
    """
    require_x64("a solve on a chain")
    if groups.group.shape[0] != chain.cells:
        raise ValueError(
            f"groups: expected those of this chain of {chain.cells} cells, got those of one of "
            f"{groups.group.shape[0]}"
        )
    return np.asarray(groups.group)


def cell_mask(
    cells: int, listed: npt.ArrayLike | int, name: str = "target"
) -> Bool[np.ndarray, "cells"]:
    """Return a set of cells as a mask; `name` is that of the argument, for errors.

    **Raises:** `ValueError` for a set that is empty or has a cell that does not exist.
    """
    array = np.asarray(listed)
    if array.dtype == bool:
        if array.shape != (cells,):
            raise ValueError(f"{name}: expected a mask of {cells} cells, got {array.shape}")
        mask = array
    else:
        members = np.atleast_1d(array)
        if members.size and not np.issubdtype(members.dtype, np.integer):
            raise ValueError(f"{name}: expected whole numbers of cells, got {members.dtype}")
        wrong = members[(members < 0) | (members >= cells)]
        if wrong.size:
            raise ValueError(f"{name}: cell {wrong[0]} does not exist; cells are 0 to {cells - 1}")
        mask = np.zeros(cells, bool)
        mask[members.astype(np.int64)] = True
    if not mask.any():
        raise ValueError(f"{name}: expected at least one cell, got none")
    return mask
