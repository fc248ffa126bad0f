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
from scipy.sparse import csgraph, linalg

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


# Relative change of entries that counts as rounding, per cell of a part.
_ROUNDING = 2.0**-50
# Largest number of squarings of a matrix, and of solves of a large part.
_SQUARINGS, _SOLVES = 60, 60
# Parts whose decays differ relatively by less are equally persistent.
_TIE = 1e-9
_SEED = 0


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class QuasiStationary(Pictured):
    """The distribution of a chain that has not left a set for a long time."""

    value: Float[Array, "cells"]
    "The distribution over the cells, 0 outside the set."
    leaving: Real
    """The probability that the next step leaves the set. It is a sum over the steps out of the set,
    and has all its digits even if it is tiny."""
    certificate: Certificate
    """The certificate. Its residual bounds the relative error of `leaving`, and is at least the
    largest relative change of an entry of the distribution by another iteration."""

    @property
    def rate(self) -> Real:
        """The decay rate per step: after `n` steps the set is not left with `exp(-rate n)`."""
        rate: Any = -jnp.log1p(-self.leaving)
        return rate if traced(self.leaving) else float(rate)

    @property
    def time(self) -> Real:
        """The mean number of steps until the chain leaves the set."""
        return 1 / self.leaving


def quasi_stationary(
    chain: ChainLike, within: npt.ArrayLike | int, *, throw: bool = True
) -> QuasiStationary:
    """Compute the quasi-stationary distribution of a chain in a set of cells, and its decay rate.

    It is the distribution `v` with `v Q = (1 - leaving) v`, where `Q` is the part of the transition
    matrix in the set (Darroch and Seneta 1965). If the chain starts with this distribution, it
    leaves the set after a geometric number of steps. It is also the limit of the distribution of a
    chain that has not left the set, from a start in the part of the set that is left most slowly.
    Cells that are not reached from this part have 0. It exists also for periodic sets, where it is
    the mean of this limit over a period.

    The matrix of expected visits `(I - Q)^-1`, which is computed without subtractions, is applied
    until the distribution does not change. The quotients of entries before and after an application
    bound `leaving` (Collatz 1942, Wielandt 1950).

    **Arguments:** a chain, and a set as a cell, a list of cells, or a mask. **Returns:** the
    distribution and the probability of leaving.

    **Raises:** `ValueError` if a part of the set is never left, or if two separate parts are left
    equally slowly, so that the distribution depends on the start.

    A walk on a line of four cells, two of which are left at both ends:

        >>> from jaxcell import examples, markov
        >>> found = markov.quasi_stationary(examples.ruin(), within=[1, 2])
        >>> found.value.round(6).tolist(), round(found.leaving, 6)
        ([0.0, 0.5, 0.5, 0.0], 0.5)
    """
    require_x64("quasi_stationary")
    inside = cell_mask(chain.cells, within, "within")
    vector = like(float, chain.cells)
    # The right eigenvector is needed only for derivatives.
    compute = _both if traced(chain, inside) else _distribution
    form = vector, like(bool, chain.cells), vector, *CERTIFIED
    value, part, survival, iterations, residual = on_host(compute, form, chain, inside)
    certificate = Certificate(iterations, residual, TOLERANCE)
    certificate.check("quasi_stationary", throw)
    if traced(chain, inside):
        kept = part[None] & part[chain.image]
        among = Chain(chain.image, jnp.where(kept, chain.probability, 0.0))
        fixed = jax.lax.stop_gradient(1 - value @ out_of(chain, inside))
        modes = jnp.stack([fixed]), survival[None], value[None] / (value @ survival)
        _, _, left = implicit(change_of_modes, tuple(map(_complex, modes)), (among,))
        value = left[0].real / jnp.sum(left[0].real)
        return QuasiStationary(value, value @ out_of(chain, inside), certificate)
    leaving = float(value @ leaving_of(chain.to_scipy(), inside))
    return QuasiStationary(put_on_device(value), leaving, certificate)


def _distribution(matrix: scipy.sparse.csr_array, inside: Cells) -> tuple[Any, ...]:
    """Return the distribution, its part of the set, NaN per cell, and the certificate."""
    part, found = slowest_part(matrix, np.asarray(inside))
    return _spread(part, found.value), part, np.full(part.size, np.nan), *found.certified


def _both(matrix: scipy.sparse.csr_array, inside: Cells) -> tuple[Any, ...]:
    """Return the same, with the right eigenvector, whose largest entry is 1, in place of NaN."""
    part, found = slowest_part(matrix, np.asarray(inside))
    transient, now = Transient.of(matrix, part), found.survival
    for _ in range(_SOLVES):
        last, now = now, transient.expect(now[:, None]).value[:, 0]
        now = now / now.max()
        if np.abs(now - last).max() <= _ROUNDING * now.size:
            break
    return _spread(part, found.value), part, _spread(part, now), *found.certified


def _spread(part: Cells, values: Float[np.ndarray, "part"]) -> Float[np.ndarray, "cells"]:
    whole = np.zeros(part.size)
    whole[part] = values
    return whole


@dataclasses.dataclass(frozen=True, eq=False)
class _Found:
    """The quasi-stationary distribution of a part of a chain."""

    value: Float[np.ndarray, "part"]
    survival: Float[np.ndarray, "part"]
    "An approximate right eigenvector."
    leaving: float
    certified: tuple[int, float]
    "The number of solves, and the residual."

    @classmethod
    def of(cls, matrix: scipy.sparse.csr_array, part: Cells) -> "_Found":
        """Find the distribution in a part, from all of which the slowest component is reached.

        An application of the visits multiplies the distribution by the mean time in the part.
        """
        transient = Transient.of(matrix, part)
        value, survival = _guess(transient)
        residual, solves = math.inf, 0
        while solves < _SOLVES:
            solves += 1
            found = transient.visits(value)
            with np.errstate(all="ignore"):
                ratio = found.value / value
                error = np.fmin(found.relative, found.left / value)
                low, high = (ratio / (1 + error)).min(), (ratio / (1 - error)).max()
                left = high / low - 1 if error.max() < 1 else math.inf
            total = found.value.sum()
            if not math.isfinite(total):
                break
            value = found.value / total
            changed = ratio.max() / ratio.min() - 1
            better, residual = left < residual / 2, float(np.fmin(left, residual))
            if changed <= _ROUNDING * value.size or (residual <= TOLERANCE and not better):
                break
        leaving = float(transient.leaving @ value)
        return cls(value, survival, leaving, (solves, residual))


def _guess(part: Transient) -> tuple[Float[np.ndarray, "part"], Float[np.ndarray, "part"]]:
    """Guess the left and the right eigenvector of the visits of a part."""
    size = part.cells.size
    ones = np.ones(size)
    if size <= solve.LIMITS.small:
        # A high power of the visits is the product of both eigenvectors.
        power = part.visited(np.eye(size))[0].T
        for _ in range(_SQUARINGS):
            power = power / power.max()
            power = power @ power
        row, column = power.sum(axis=1).argmax(), power.sum(axis=0).argmax()
        left, right = power[row], power[:, column]
    else:
        left = right = ones
        if size <= solve.LIMITS.complete:
            with contextlib.suppress(RuntimeError):
                left = np.abs(_nearest_to_1(part.step).real)
    least = np.finfo(float).tiny
    return np.maximum(left / left.sum(), least), right / right.max()


def _nearest_to_1(step: scipy.sparse.csr_array) -> Any:
    """Return the left eigenvector of the eigenvalue that is nearest to 1."""
    apply = solve.factored(step)
    inverse = linalg.LinearOperator(
        step.shape, matvec=lambda x: apply(x.reshape(-1, 1), True)[:, 0], dtype=float
    )
    start = np.random.default_rng(_SEED).random(step.shape[0])
    return linalg.eigs(step.T.tocsr(), k=1, sigma=1.0, OPinv=inverse, v0=start)[1][:, 0]


def slowest_part(matrix: scipy.sparse.csr_array, inside: Cells) -> tuple[Cells, _Found]:
    """Find the part that is reached from the component that is left most slowly, and solve it."""
    cells = np.flatnonzero(inside)
    among = matrix[cells][:, cells]
    out = leaving_of(matrix, inside)[cells]
    kept = ~reaching(among, out > 0)
    if kept.any():
        raise ValueError(
            f"quasi_stationary: the set is never left from cell {cells[kept][0]}; "
            "limiting_distribution serves closed sets"
        )
    count, label = csgraph.connected_components(among, connection="strong")
    if count == 1:
        return inside, _Found.of(matrix, inside)
    size = np.bincount(label)
    leaves = np.full(count, math.inf)
    off = among - scipy.sparse.diags_array(among.diagonal())
    alone = size[label] == 1
    leaves[label[alone]] = (out + off @ np.ones(cells.size))[alone]
    for number in np.flatnonzero(size > 1):
        part = np.zeros(inside.size, bool)
        part[cells[label == number]] = True
        leaves[number] = _Found.of(matrix, part).leaving
    slowest = int(leaves.argmin())
    begin = label == slowest
    reached = reaching(among.T.tocsr(), begin)
    if (np.delete(leaves, slowest) <= leaves[slowest] * (1 + _TIE)).any():
        raise ValueError(
            "quasi_stationary: two separate parts of the set are left equally slowly, so that the "
            "distribution depends on the start; choose one of the parts"
        )
    part = np.zeros(inside.size, bool)
    part[cells[reached]] = True
    return part, _Found.of(matrix, part)


def _complex(values: Any) -> Any:
    return values.astype(complex)
