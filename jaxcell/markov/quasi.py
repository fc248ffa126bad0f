import contextlib
import dataclasses
import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
import scipy.sparse
from jaxtyping import Array, Float
from scipy.sparse import linalg

from ..base.certificate import Certificate, Real
from ..base.divided import put_on_device
from ..base.precision import require_x64
from ..base.shown import Pictured
from ..base.wide import traced
from ..mapping.classes import reaching
from ..mapping.generalized import Chain, ChainLike
from ..mapping.traced import implicit, like, on_host
from .hitting import TOLERANCE, Cells, cell_mask
from .sets.modes import change_of_modes
from .solving import solve
from .traced import CERTIFIED
from .transient import Transient, leaving_of
from .visited import out_of


# Relative change of the distribution that counts as rounding.
_ROUNDING = 2.0**-46
# Largest number of squarings of a matrix, and of solves.
_SQUARINGS, _SOLVES = 60, 100
_SEED = 0


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class QuasiStationary(Pictured):
    """The distribution of a chain that has not left a set for a long time."""

    value: Float[Array, "cells"]
    leaving: Real
    """The probability that the next step leaves the set: a sum of probabilities of steps, with all
    its digits. The decay rate per step is `-log1p(-leaving)`, and the mean time `1 / leaving`."""
    certificate: Certificate
    "The certificate; its residual bounds the relative error of `leaving`."


def quasi_stationary(
    chain: ChainLike, within: npt.ArrayLike | int, *, throw: bool = True
) -> QuasiStationary:
    """Compute the quasi-stationary distribution of a chain in a set of cells, and its decay.

    It is the distribution `v` with `v Q = (1 - leaving) v`, where `Q` is the part of the transition
    matrix in the set (Darroch and Seneta 1965). A chain that starts with it leaves the set after a
    geometric number of steps. It is the limit of the distribution of a chain that has not left,
    from any start in the part of the set that is left most slowly (in a periodic set, the mean of
    the limit over a period); if two parts are equally slow, it is that of one of them.

    The expected visits `(I - Q)^-1`, computed without subtractions, are applied until `v` does not
    change. The quotients of its entries before and after bound `leaving` (Collatz and Wielandt).

    **Arguments:** a chain, and a set as a cell, a list of cells, or a mask, from all of which it is
    possible to leave. **Returns:** the distribution and the probability of leaving.

    A walk on a line of four cells, two of which are left at both ends:

        >>> from jaxcell import examples, markov
        >>> found = markov.quasi_stationary(examples.ruin(), within=[1, 2])
        >>> found.value.round(6).tolist(), round(found.leaving, 6)
        ([0.0, 0.5, 0.5, 0.0], 0.5)
    """
    require_x64("quasi_stationary")
    inside = cell_mask(chain.cells, within, "within")
    form = (like(float, chain.cells),) * 2, *CERTIFIED
    (value, survival), solves, residual = on_host(_found, form, chain, inside)
    certificate = Certificate(solves, residual, TOLERANCE)
    certificate.check("quasi_stationary", throw)
    if not traced(chain, inside):
        leaving = float(value @ leaving_of(chain.to_scipy(), inside))
        return QuasiStationary(put_on_device(value), leaving, certificate)
    kept = (value > 0)[None] & (value > 0)[chain.image]
    among = Chain(chain.image, jnp.where(kept, chain.probability, 0.0))
    stays = jax.lax.stop_gradient(1 - value @ out_of(chain, inside))
    modes = jnp.stack([stays]), survival[None], value[None] / (value @ survival)
    modes = implicit(change_of_modes, tuple(x.astype(complex) for x in modes), (among,))
    value = modes[2][0].real / jnp.sum(modes[2][0].real)
    return QuasiStationary(value, value @ out_of(chain, inside), certificate)


def _found(matrix: scipy.sparse.csr_array, inside: Cells) -> tuple[Any, ...]:
    """Return the distribution and the right eigenvector, the number of solves, and the residual."""
    part, found = slowest_part(matrix, np.asarray(inside))
    both = np.zeros((2, part.size))
    both[:, part] = found[:2]
    return tuple(both), *found[2:]


def slowest_part(
    matrix: scipy.sparse.csr_array, inside: Cells
) -> tuple[Cells, tuple[Float[np.ndarray, "part"], Float[np.ndarray, "part"], int, float]]:
    """Find the part of a set that is reached from the component that is left most slowly.

    Returns its mask, its distribution and right eigenvector, the number of solves, and a bound on
    the relative error of the probability of leaving.
    """
    cells = np.flatnonzero(inside)
    kept = ~reaching(matrix[cells][:, cells], leaving_of(matrix, inside)[cells] > 0)
    if kept.any():
        raise ValueError(
            f"within: the set is never left from cell {cells[kept][0]}; limiting_distribution "
            "serves closed sets"
        )
    transient = Transient.of(matrix, inside)
    left, right = _guess(transient)
    # Both eigenvectors are positive only in the slowest component.
    begin = np.arange(left.size) == (left * right).argmax()
    reached = reaching(transient.step.T.tocsr(), begin)
    part = np.zeros(inside.size, bool)
    part[cells[reached]] = True
    value, survival = np.maximum(left[reached], np.finfo(float).tiny), right[reached]
    transient, solves, changed = Transient.of(matrix, part), 0, math.inf
    while solves < _SOLVES and changed > _ROUNDING:
        solves += 1
        last, found = value, transient.visits(value)
        value = found.value / found.value.sum()
        changed = float(np.abs(value / last - 1).max())
    for _ in range(_SOLVES):
        before, survival = survival, transient.expect(survival[:, None]).value[:, 0]
        survival = survival / survival.max()
        if np.abs(survival - before).max() <= _ROUNDING:
            break
    with np.errstate(all="ignore"):
        error = np.fmin(found.relative, found.left / last)
        ratio = found.value / last
        bound = (ratio / (1 - error)).max() / (ratio / (1 + error)).min() - 1
    residual = float(bound) if error.max() < 1 and np.isfinite(bound) else math.inf
    return part, (value, survival, solves, residual)


def _guess(part: Transient) -> tuple[Float[np.ndarray, "part"], Float[np.ndarray, "part"]]:
    """Guess the left and the right eigenvector of the visits of a part."""
    size = part.cells.size
    if size <= solve.LIMITS.small:
        # A high power of the visits is the product of both eigenvectors.
        power = part.visited(np.eye(size))[0].T
        for _ in range(_SQUARINGS):
            power = power / power.max()
            power = power @ power
        row, column = power.sum(axis=1).argmax(), power.sum(axis=0).argmax()
        return power[row] / power[row].sum(), power[:, column] / power[:, column].max()
    left = right = np.ones(size) / size
    # If this fails, the guess is uniform.
    with contextlib.suppress(RuntimeError):
        if size <= solve.LIMITS.complete:
            apply = solve.factored(part.step)
            start = np.random.default_rng(_SEED).random(size)
            left, right = (_nearest_to_1(apply, start, adjoint) for adjoint in (True, False))
    return left / left.sum(), right


def _nearest_to_1(apply: Any, start: np.ndarray, adjoint: bool) -> Float[np.ndarray, "part"]:
    """Return the eigenvector of a matrix for the largest eigenvalue of its visits `apply`."""
    visits = linalg.LinearOperator(
        (start.size, start.size), lambda x: apply(x.reshape(-1, 1), adjoint)[:, 0], dtype=float
    )
    return np.abs(linalg.eigs(visits, k=1, which="LR", v0=start)[1][:, 0].real)
