import contextlib
import dataclasses
import functools
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


# Relative change of the distribution that counts as rounding.
_ROUNDING = 2.0**-46
# Change that may be rounding, and change of a guess that is of no use.
_SURE, _ROUGH = 1e-9, 1e-3
# Largest number of cells whose matrix is squared, of squarings, and of solves.
_DENSE, _SQUARINGS, _SOLVES = 500, 60, 100
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
    """The certificate; its residual bounds the relative error of `leaving`. With derivatives, it is
    at least the error of the right eigenvector, of which they are made."""


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
    # The right eigenvector is needed for derivatives.
    compute = functools.partial(_found, both=traced(chain, inside))
    form = (like(float, chain.cells),) * 2, *CERTIFIED
    (value, survival), solves, residual = on_host(compute, form, chain, inside)
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


def _found(matrix: scipy.sparse.csr_array, inside: Cells, *, both: bool) -> tuple[Any, ...]:
    """Return the distribution and the right eigenvector, the number of solves, and the residual."""
    part, found = slowest_part(matrix, np.asarray(inside))
    vectors = np.zeros((2, part.size))
    vectors[0, part], residual = found.value, found.residual
    if both:
        transient = Transient.of(matrix, part)
        now = _guess(transient, ahead=True)
        now = now / now.max()
        solves, before, changed = 0, math.inf, 1.0
        while solves < _SOLVES and changed > _ROUNDING:
            last, now = now, transient.expect(now[:, None]).value[:, 0]
            now = now / now.max()
            solves, before, changed = solves + 1, changed, float(np.abs(now - last).max())
        vectors[1, part] = now
        # Changes that shrink slowly add up to more than the last one.
        left = changed / (1 - changed / before) if changed < before else changed
        residual = max(residual, left)
    return tuple(vectors), found.solves, residual


def slowest_part(matrix: scipy.sparse.csr_array, inside: Cells) -> tuple[Cells, "_Settled"]:
    """Find the part of a set that is reached from the component that is left most slowly.

    Returns its mask and its distribution.
    """
    cells = np.flatnonzero(inside)
    among, out = matrix[cells][:, cells], leaving_of(matrix, inside)[cells]
    kept = ~reaching(among, out > 0)
    if kept.any():
        raise ValueError(
            f"within: the set is never left from cell {cells[kept][0]}; limiting_distribution "
            "serves closed sets"
        )
    count, label = csgraph.connected_components(among, connection="strong")

    def settled(members: np.ndarray) -> tuple[np.ndarray, _Settled]:
        part = np.zeros(inside.size, bool)
        part[cells[members]] = True
        return part, _Settled.of(Transient.of(matrix, part))

    leaves = np.zeros(count)
    if count > 1:
        onward = among - scipy.sparse.diags_array(among.diagonal())
        leaves[label] = out + onward @ np.ones(cells.size)
        for number in np.flatnonzero(np.bincount(label) > 1):
            leaves[number] = settled(label == number)[1].leaving
    return settled(reaching(among.T.tocsr(), label == leaves.argmin()))


@dataclasses.dataclass(frozen=True, eq=False)
class _Settled:
    """The quasi-stationary distribution of a part all of which its slowest component reaches."""

    value: Float[np.ndarray, "part"]
    leaving: float
    solves: int
    residual: float
    "A bound on the relative error of `leaving`."

    @classmethod
    def of(cls, part: Transient) -> "_Settled":
        value, solves, before, changed = _guess(part), 0, math.inf, 1.0
        # Later changes are rounding if they do not shrink.
        while solves < _SOLVES and (changed > _SURE or _ROUNDING < changed < 0.9 * before):
            solves += 1
            last, found = value, part.visits(value)
            value = found.value / found.value.sum()
            before, changed = changed, float(np.abs(value / last - 1).max())
            if solves == 1 and changed > _ROUGH:
                value = np.full(value.size, 1 / value.size)
        with np.errstate(all="ignore"):
            error = np.fmin(found.relative, found.left / last)
            ratio = found.value / last
            bound = (ratio / (1 - error)).max() / (ratio / (1 + error)).min() - 1
        residual = float(bound) if error.max() < 1 and np.isfinite(bound) else math.inf
        return cls(value, float(part.leaving @ value), solves, residual)


def _guess(part: Transient, ahead: bool = False) -> Float[np.ndarray, "part"]:
    """Guess the left eigenvector of the visits of a part, by default the uniform distribution.

    With `ahead`, guess the right one.
    """
    size, guess = part.cells.size, np.ones(part.cells.size)
    if size <= _DENSE:
        # The rows of a high power of the visits are proportional to it.
        power = part.visited(np.eye(size))[0]
        power = power if ahead else power.T
        for _ in range(_SQUARINGS):
            power = power / power.max()
            power = power @ power
        guess = power[power.sum(axis=1).argmax()]
    elif size <= solve.LIMITS.complete:
        with contextlib.suppress(RuntimeError):
            apply = solve.factored(part.step)
            visits = linalg.LinearOperator(
                part.step.shape, lambda x: apply(x.reshape(-1, 1), not ahead)[:, 0], dtype=float
            )
            start = np.random.default_rng(_SEED).random(size)
            guess = np.abs(linalg.eigs(visits, k=1, which="LR", v0=start)[1][:, 0].real)
    return np.maximum(guess / guess.sum(), np.finfo(float).tiny)
