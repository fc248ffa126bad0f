import dataclasses
from collections.abc import Callable, Sequence
from typing import TypeAlias

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


Cells: TypeAlias = Bool[np.ndarray, "cells"]
"""A set of cells, as a mask."""
_Ends: TypeAlias = Float[np.ndarray, "part ends"]

# Tolerances of the relative error of a time, and of the absolute error of a probability.
TIME_TOLERANCE = 1e-6
PROBABILITY_TOLERANCE = 1e-10
# Largest number of iterative refinements of probabilities.
_REFINEMENTS = 4


@dataclasses.dataclass(frozen=True, eq=False)
class Absorption:
    """The probabilities of ending in each persistent group and in the sink, from each cell."""

    value: Float[Array, "groups cells"]
    "The probability of ending in each persistent group, from each cell."
    leaving: Float[Array, "cells"]
    "The probability of leaving the space for the sink, from each cell."
    certificate: Certificate


def absorption_probabilities(
    chain: Chain, groups: PersistentGroups, *, throw: bool = True
) -> Absorption:
    """Compute the probability that a chain ends in each persistent group, for each start.

    **Arguments:** a chain, and its persistent groups. **Returns:** the probability of each group
    for each start, exactly 1 if only one end is possible. The residual of the certificate is the
    largest difference between the probability from a cell and its mean after one step, or between 1
    and the sum of the probabilities from a cell.

    A random walk on a line of four cells, which stops at both ends:

        >>> from jaxcell import examples, mapping, markov
        >>> chain = examples.ruin()
        >>> groups = mapping.persistent_groups(chain)
        >>> (3 * markov.absorption_probabilities(chain, groups).value).round(6).tolist()
        [[3.0, 2.0, 1.0, 0.0], [0.0, 1.0, 2.0, 3.0]]
    """
    group = group_of(chain, groups)
    matrix = chain.to_scipy()
    part = Transient.of(matrix, group < 0)
    # A row per group and a row for the sink.
    value = (group == np.arange(groups.count + 1)[:, None]).astype(float)
    gain = matrix[part.cells] @ value.T
    gain[:, -1] = leaving_rows(matrix)[part.cells]
    ends, certificate = _ends(part, gain)
    certificate.check("absorption_probabilities", throw)
    value[:, part.cells] = ends.T
    return Absorption(jax.device_put(value[:-1]), jax.device_put(value[-1]), certificate)


def _ends(part: Transient, gain: _Ends) -> tuple[_Ends, Certificate]:
    """Compute the probability of each end (group or sink); `gain` is that of a step into it."""
    possible = gain.any(axis=0)
    if possible.sum() == 1:
        value, products = np.broadcast_to(possible.astype(float), gain.shape), 0
    else:
        value, products = part.expect(gain)
    residual = _residual(part, gain, value)
    for _ in range(_REFINEMENTS):
        if residual <= PROBABILITY_TOLERANCE:
            break
        left = _signed_residual(part, gain, value)
        change, more = part.expect(np.concatenate([np.maximum(left, 0), np.maximum(-left, 0)], 1))
        higher, lower = np.split(change, 2, axis=1)
        better = np.clip(value + higher - lower, 0, 1)
        products += more
        error = _residual(part, gain, better)
        if not error < residual:
            break
        value, residual = better, error
    return value, Certificate(products, residual, PROBABILITY_TOLERANCE)


def _residual(part: Transient, gain: _Ends, value: _Ends) -> float:
    mean = np.abs(gain + part.step @ value - value).max(initial=0.0)
    return float(max(mean, np.abs(value.sum(axis=1) - 1).max(initial=0.0)))


def _signed_residual(part: Transient, gain: _Ends, value: _Ends) -> _Ends:
    """Compute the residual `gain + Q x - x` of the values `x`, for an iterative refinement.

    It is the sum of `p (x' - x)` over the steps from a cell, where `x'` is the value after the
    step. So each row counts as summing to exactly 1. Otherwise the rounding error of its sum could
    be as large as the probability of a rare step that leaves the transient cells. Differences
    between cells with nearly equal values keep all their digits.
    """
    step, columns = part.step, []
    row = np.repeat(np.arange(part.cells.size), np.diff(step.indptr))
    for into, x in zip(gain.T, value.T, strict=True):
        within = np.bincount(row, step.data * (x[step.indices] - x[row]), x.size)
        columns.append(within + into * (1 - x) - (gain.sum(axis=1) - into) * x)
    return np.stack(columns, axis=1)


def absorption_times(chain: Chain, groups: PersistentGroups, *, throw: bool = True) -> Solution:
    """Compute the expected number of steps until a chain is in a persistent group or has left.

    **Arguments:** as for [`absorption_probabilities`][]. **Returns:** the time for each start, 0 in
    the groups. The residual of the certificate bounds the relative error of every time.

    A random walk on a line of four cells, which stops at both ends:

        >>> from jaxcell import examples, mapping, markov
        >>> chain = examples.ruin()
        >>> groups = mapping.persistent_groups(chain)
        >>> markov.absorption_times(chain, groups).value.round(6).tolist()
        [0.0, 2.0, 2.0, 0.0]
    """
    transient = group_of(chain, groups) < 0
    time = np.zeros(chain.cells)
    return times_until_left(chain.to_scipy(), transient, time, "absorption_times", throw)


def hitting_times(chain: Chain, target: npt.ArrayLike | int, *, throw: bool = True) -> Solution:
    """Compute the expected number of steps until a chain first reaches a set of cells.

    **Arguments:** a chain, and a cell, a list of cells, or a mask over the cells. **Returns:** the
    time for each start, 0 in the target, and `inf` if the chain may never arrive, because it can
    end elsewhere or leave the space first. The residual of the certificate bounds the relative
    error of every finite time. If the chain was estimated from samples, the field `moved` of the
    solution estimates the sampling error.

    A random walk on a line of three cells:

        >>> from jaxcell import examples, markov
        >>> markov.hitting_times(examples.walk(), target=2).value.round(6).tolist()
        [4.0, 3.0, 0.0]
    """
    require_x64("hitting_times")
    there = cell_mask(chain.cells, target)
    matrix = chain.to_scipy()
    _, may_fail = prospects(matrix, there)
    time = np.where(may_fail, np.inf, 0.0)
    times = times_until_left(matrix, ~may_fail & ~there, time, "hitting_times", throw)
    return with_moved(times, chain, hitting_times, there)


def with_moved(
    solution: Solution, chain: Chain, solve: Callable[..., Solution], target: Cells
) -> Solution:
    """Add `moved` to a solution: how much values change if `solve` has only half of the samples."""
    if chain.half is None:
        return solution
    value, other = solution.value, solve(chain.half, target, throw=False).value
    moved = jnp.where(value == other, 0.0, jnp.abs(value - other))
    return dataclasses.replace(solution, moved=moved)


def times_until_left(
    matrix: scipy.sparse.csr_array,
    inside: Cells,
    time: Float[np.ndarray, "cells"],
    caller: str,
    throw: bool,
) -> Solution:
    """Compute the expected number of steps from each cell `inside` until these cells are left.

    The result is written into `time`, which already contains the times of the other cells.
    """
    steps, certificate = leaving_times(matrix, inside)
    certificate.check(caller, throw)
    # A time below 1 is rounding: the true time is too long for 64-bit numbers.
    time[inside] = np.where(steps >= 1 - TIME_TOLERANCE, steps, np.inf)
    return Solution(jax.device_put(time), certificate)


def prospects(matrix: scipy.sparse.csr_array, there: Cells) -> tuple[Cells, Cells]:
    """Find the cells from which a chain can arrive at `there`, and those from which it may not."""
    can = reaching(matrix, there)
    # A chain that has arrived cannot fail any more.
    before = matrix.copy()
    before.data[np.repeat(there, np.diff(before.indptr))] = 0
    before.eliminate_zeros()
    return can, reaching(before, ~there & (~can | (leaving_rows(matrix) > 0)))


def leaving_times(
    matrix: scipy.sparse.csr_array, inside: Cells
) -> tuple[Float[np.ndarray, "inside"], Certificate]:
    """Compute the expected number of steps until a chain leaves the cells `inside`.

    The chain must be able to leave from each of them. The residual bounds the relative errors.
    """
    part = Transient.of(matrix, inside)
    gain = np.ones((part.cells.size, 1))
    steps, products = part.expect(gain)
    # With t = 1 + Q t + r, the error is at most max |r| times the true time.
    residual = np.abs(gain + part.step @ steps - steps).max(initial=0.0)
    return steps[:, 0], Certificate(products, float(residual), TIME_TOLERANCE)


def group_of(chain: Chain, groups: PersistentGroups) -> Int[np.ndarray, "cells"]:
    """Return the group of each cell, -1 for none, and check that the chain has these `groups`."""
    require_x64("a solve on a chain")
    if groups.group.shape[0] != chain.cells:
        raise ValueError(
            f"groups: expected the groups of this chain of {chain.cells} cells, got the groups of "
            f"a chain of {groups.group.shape[0]}"
        )
    return np.asarray(groups.group)


def common_cells(chains: Sequence[Chain], owner: str) -> int:
    """Return the number of cells that all chains share; errors say "the chain of {owner} 1 has"."""
    if not chains:
        raise ValueError(f"chains: expected a chain for each {owner}, got none")
    cells = chains[0].cells
    for number, chain in enumerate(chains):
        if chain.cells != cells:
            raise ValueError(
                f"chains: the chain of {owner} {number} has {chain.cells} cells, and the chain of "
                f"{owner} 0 has {cells}"
            )
    return cells


def cell_mask(cells: int, listed: npt.ArrayLike | int, name: str = "target") -> Cells:
    """Convert a cell, a list of cells, or a mask to a mask; error messages begin with `name`."""
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
