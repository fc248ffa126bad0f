import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
import scipy.sparse
from jaxtyping import Array, Bool, Float, Int

from ..base.certificate import Certificate, Solution
from ..base.divided import put_on_device
from ..base.indices import check_indices
from ..base.precision import require_x64
from ..base.shown import Pictured
from ..base.wide import namespace, traced
from ..mapping.batch import Batch
from ..mapping.classes import PersistentGroups, check_groups, persistent_groups, reaching
from ..mapping.generalized import Chain, ChainLike, leaving_rows
from ..mapping.traced import like, on_host
from .solving.rounds import eliminated
from .traced import CERTIFIED, expected
from .transient import Transient


Cells: TypeAlias = Bool[np.ndarray, "cells"]
"""A set of cells, as a mask."""

# Tolerance of the relative error of a time, and of the absolute error of a probability.
TOLERANCE = 1e-6


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Absorption(Pictured):
    """The probabilities of ending in each persistent group and in the sink, from each cell."""

    value: Float[Array, "groups cells"]
    "The probability of ending in each persistent group, from each cell."
    leaving: Float[Array, "cells"]
    "The probability of leaving the space for the sink, from each cell."
    certificate: Certificate


def absorption_probabilities(
    chain: ChainLike, groups: PersistentGroups | None = None, *, throw: bool = True
) -> Absorption:
    """Compute the probability that a chain ends in each persistent group, for each start.

    **Arguments:** a chain, and its persistent groups, which are found if they are not given.
    **Returns:** the probability of each group for each start, exactly 1 if only one end is
    possible. The residual of the certificate bounds the error of every probability.

    A random walk on a line of four cells, which stops at both ends:

        >>> from jaxcell import examples, markov
        >>> chain = examples.ruin()
        >>> (3 * markov.absorption_probabilities(chain).value).round(6).tolist()
        [[3.0, 2.0, 1.0, 0.0], [0.0, 1.0, 2.0, 3.0]]
    """
    require_x64("absorption_probabilities")
    groups = groups or persistent_groups(chain)
    return absorption(chain, check_groups(chain, groups), groups.size.shape[0], throw)


def absorption(chain: Chain, group: Any, count: int, throw: bool) -> Absorption:
    """Compute [`absorption_probabilities`][] for `count` closed sets; transient cells have -1."""
    compute = functools.partial(_absorption, count=count)
    form = like(float, count + 1, chain.cells), *CERTIFIED
    value, products, error = on_host(compute, form, chain, group)
    certificate = Certificate(products, error, TOLERANCE)
    certificate.check("absorption_probabilities", throw)
    if traced(chain, group):
        gain = jnp.zeros_like(value).at[-1].set(chain.leaving)
        value = jax.vmap(expected, (0, None, None, 0))(value, chain, group < 0, gain)
    value = put_on_device(value)
    return Absorption(value[:-1], value[-1], certificate)


def _absorption(
    matrix: scipy.sparse.csr_array, group: Int[np.ndarray, "cells"], count: int
) -> tuple[Float[np.ndarray, "ends cells"], int, float]:
    """Return the probability of each group and of the sink, the products, and a bound on errors."""
    part = Transient.of(matrix, group < 0)
    # A row per group and a row for the sink.
    value = (group == np.arange(count + 1)[:, None]).astype(float)
    gain = matrix[part.cells] @ value.T
    gain[:, -1] = leaving_rows(matrix)[part.cells]
    possible = gain.any(axis=0)
    if possible.sum() == 1:
        value[:, part.cells] = possible[:, None]
        return value, 0, 0.0
    ends = part.expect(gain)
    value[:, part.cells] = ends.value[:, :-1].T.clip(0, 1)
    return value, ends.products, float(ends.error[:, :-1].max(initial=0.0))


def absorption_times(
    chain: ChainLike, groups: PersistentGroups | None = None, *, throw: bool = True
) -> Solution:
    """Compute the expected number of steps until a chain is in a persistent group or has left.

    **Arguments:** as for [`absorption_probabilities`][]. **Returns:** the time for each start, 0 in
    the groups. The residual of the certificate bounds the relative error of every time.

    A random walk on a line of four cells, which stops at both ends:

        >>> from jaxcell import examples, markov
        >>> markov.absorption_times(examples.ruin()).value.round(6).tolist()
        [0.0, 2.0, 2.0, 0.0]
    """
    require_x64("absorption_times")
    inside = check_groups(chain, groups or persistent_groups(chain)) < 0
    return _times_until_left(chain, inside, np.zeros(chain.cells), "absorption_times", throw)


def hitting_times(chain: ChainLike, target: npt.ArrayLike | int, *, throw: bool = True) -> Solution:
    """Compute the expected number of steps until a chain first reaches a set of cells.

    **Arguments:** a chain, and a cell, a list of cells, or a mask over the cells. **Returns:** the
    time for each start, 0 in the target, and `inf` if the chain may never arrive, because it can
    end elsewhere or leave the space first. The residual of the certificate bounds the relative
    error of every finite time. If the chain has a coarser chain `half`, the field `moved` of the
    solution estimates the error of the cells and samples.

    A random walk on a line of three cells:

        >>> from jaxcell import examples, markov
        >>> markov.hitting_times(examples.walk(), target=2).value.round(6).tolist()
        [4.0, 3.0, 0.0]
    """
    require_x64("hitting_times")
    there = cell_mask(chain.cells, target)
    form = (like(bool, chain.cells),) * 2
    _, may_fail = on_host(prospects, form, chain, there, of_steps=True)
    xp = namespace(may_fail)
    others = xp.where(there.any(), xp.where(may_fail, np.inf, 0.0), np.nan)
    times = _times_until_left(chain, ~may_fail & ~there, others, "hitting_times", throw)
    return with_moved(times, chain, hitting_times, there)


def with_moved(
    solution: Solution, chain: Chain, solve: Callable[..., Solution], target: Any
) -> Solution:
    """Add `moved` to a solution: how much values change if `solve` has the coarser `chain.half`."""
    if chain.half is None:
        return solution
    value, other = solution.value, solve(chain.half, target, throw=False).value
    moved = jnp.where(value == other, 0.0, jnp.abs(value - other))
    return dataclasses.replace(solution, moved=moved)


def _times_until_left(chain: Chain, inside: Any, others: Any, caller: str, throw: bool) -> Solution:
    """Compute the expected number of steps from each cell `inside` until these cells are left.

    The times of the other cells are in `others`, which is 0 inside.
    """
    form = like(float, chain.cells), *CERTIFIED
    time, products, error = on_host(_times, form, chain, inside, many=_times_of_many)
    if traced(others):
        error = jnp.where(jnp.isnan(others).any(), jnp.nan, error)
    certificate = Certificate(products, error, TOLERANCE)
    certificate.check(caller, throw)
    time = time + others
    return Solution(put_on_device(expected(time, chain, inside, 1.0)), certificate)


def _times(
    matrix: scipy.sparse.csr_array, inside: Cells
) -> tuple[Float[np.ndarray, "cells"], int, float]:
    time = np.zeros(inside.size)
    time[inside], certificate = leaving_times(matrix, inside)
    return time, certificate.iterations, certificate.residual


def _times_of_many(batch: Batch, inside: Cells) -> tuple[Any, int, Any]:
    time, error = eliminated(batch, inside, np.ones((inside.size, 1)))
    return time.T, 0, error


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
    Times that are too long for 64-bit numbers are `inf`.
    """
    part = Transient.of(matrix, inside)
    steps = part.expect(np.empty((part.cells.size, 0)))
    value, error = steps.value[:, 0], float(steps.relative.max(initial=0.0))
    # A time below 1 is rounding.
    value = np.where(value >= 1 - TOLERANCE, value, np.inf)
    return value, Certificate(steps.products, error, TOLERANCE)


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


def cell_mask(cells: int, listed: npt.ArrayLike | int, name: str = "target") -> Any:
    """Convert a cell, a list of cells, or a mask to a mask; error messages begin with `name`.

    A list that is as long as a mask has no cell twice, so that no mask of numbers is taken for one.
    If JAX traces the cells and one of them does not exist, the mask is empty.
    """
    if traced(listed):
        return _traced_mask(cells, listed, name)
    array = np.asarray(listed)
    if array.dtype == bool:
        if array.shape != (cells,):
            raise ValueError(f"{name}: expected a mask of {cells} cells, got {array.shape}")
        mask = array
    else:
        number = np.asarray(check_indices(array, cells, name)).astype(np.int64)
        times = np.bincount(number.ravel(), minlength=cells)
        if number.size == cells and times.max() > 1:
            raise ValueError(
                f"{name}: cell {times.argmax()} stands {times.max()} times; a mask has booleans"
            )
        mask = times > 0
    check_target(mask, name)
    return mask


def check_target(there: Bool[np.ndarray, "cells"], name: str = "target") -> None:
    """Raise a `ValueError` for an empty set of cells."""
    if not there.any():
        raise ValueError(f"{name}: expected at least one cell, got none")


def _traced_mask(cells: int, listed: Any, name: str) -> Bool[Array, "cells"]:
    if listed.dtype != bool:
        exist = jnp.all((listed >= 0) & (listed < cells))
        return jnp.zeros(cells, bool).at[check_indices(listed, cells, name)].set(True) & exist
    if listed.shape != (cells,):
        raise ValueError(f"{name}: expected a mask of {cells} cells, got {listed.shape}")
    return listed
