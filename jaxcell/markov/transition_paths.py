import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
import scipy.sparse
from jaxtyping import Array, Bool, Float

from ..base.certificate import Certificate, Real, Solution
from ..base.divided import put_on_device
from ..base.precision import require_x64
from ..base.shown import Pictured
from ..base.wide import traced
from ..mapping.classes import reaching
from ..mapping.generalized import Chain, ChainLike
from ..mapping.traced import like, on_host
from .conditional import arrival_probabilities, arrivals
from .hitting import TOLERANCE, Cells, cell_mask
from .limiting import limit_of
from .traced import CERTIFIED, expected
from .transient import Transient


# Smaller shares of the time lose digits.
_TINY = 1e-290


def committor(
    chain: ChainLike,
    source: npt.ArrayLike | int,
    target: npt.ArrayLike | int,
    *,
    backward: bool = False,
    throw: bool = True,
) -> Solution:
    """Compute the probability that a chain reaches a target before it reaches a source.

    The forward committor looks ahead; it is 0 where the chain ends elsewhere or leaves the space.
    The backward committor looks back: it is the probability that a chain in the long run, which is
    in the cell now, was last in the source and not in the target (Metzner, Schuette and
    Vanden-Eijnden 2009).

    **Arguments:** two disjoint sets, each as a cell, a list of cells, or a mask; and whether to
    look back. **Returns:** the probability for each cell. The backward committor is NaN in cells
    where the chain never is in the long run, or less often than once in 1e290 steps. The residual
    of the certificate bounds the error of every probability, relative to it if `backward`.

    A random walk on a line of four cells, which stops at both ends:

        >>> from jaxcell import examples, markov
        >>> (3 * markov.committor(examples.ruin(), source=0, target=3).value).round(6).tolist()
        [0.0, 1.0, 2.0, 3.0]
    """
    require_x64("committor")
    here, there, both = _two_sets(chain, source, target)
    if backward:
        share, mass, certificate, relative, total = _last_in_source(chain, here, there)
        known = share > _TINY
        value = jnp.where(known, mass / jnp.where(known, share, 1.0), jnp.nan)
        # Rounding may exceed 1 by a few units in the last digit.
        value = value - jax.lax.stop_gradient(jnp.maximum(value - 1, 0.0))
        error = _relative(relative, total, jnp.min(share, where=known, initial=1.0))
        solution = Solution(value, dataclasses.replace(certificate, residual=error))
    else:
        solution = arrival_probabilities(_stopped(chain, here), there, throw=False)
    solution.certificate.check("committor", throw)
    return dataclasses.replace(solution, value=solution.value + both)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class ReactiveFlux(Pictured):
    """The transitions of a chain in the long run: its paths from a source directly to a target."""

    gross: Float[Array, "branches cells"]
    """The number of transitions per step of the chain that use each branch, from the cell to
    `chain.image[branch, cell]`; 0 for steps that stay in a cell."""
    net: Float[Array, "branches cells"]
    "The same, minus the transitions that go back from the image to the cell; at least 0."
    rate: Real
    "The number of transitions per step of the chain."
    duration: Real
    "The mean number of steps from the last cell in the source to the first cell in the target."
    time: Real
    "The mean time to the target, after the chain came to the source from the target."
    density: Float[Array, "cells"]
    "The share of the time that the chain is in each cell during a transition, between the sets."
    certificate: Certificate
    """The certificate. Its residual is the largest of the residual of the limiting distribution, of
    bounds on the errors of the two committors, relative to what they count for, and of the
    relative difference of the numbers of transitions that leave the source and enter the target."""


def reactive_flux(
    chain: ChainLike,
    source: npt.ArrayLike | int,
    target: npt.ArrayLike | int,
    *,
    throw: bool = True,
) -> ReactiveFlux:
    """Compute the flux of transitions from a source to a target in the long run.

    With the limiting distribution `pi` and the committors `b` and `f`, the flux from cell `i` to
    cell `j` is `pi_i b_i p_ij f_j` (Metzner, Schuette and Vanden-Eijnden 2009). Small numbers keep
    their digits, because `pi b` is computed as expected visits, without a division by `pi`.

    **Arguments:** a chain with a persistent group, and two sets as for [`committor`][].
    **Returns:** fluxes and times. The rate is 0 unless a persistent group has cells in both sets.

    A random walk on a line of three cells:

        >>> from jaxcell import examples, markov
        >>> flux = markov.reactive_flux(examples.walk(), source=0, target=2)
        >>> round(flux.rate, 6), round(flux.time, 6), round(flux.duration, 6)
        (0.125, 4.0, 2.0)
    """
    require_x64("reactive_flux")
    here, there, both = _two_sets(chain, source, target)
    share, mass, backward, before, total = _last_in_source(chain, here, there)
    if not traced(share) and not np.any(share):
        raise ValueError(
            "reactive_flux: the chain has no persistent group, so nothing remains in the long run; "
            "committor and visits serve chains that leave the space"
        )
    none = both + jnp.where(jnp.any(share > 0), 0.0, jnp.nan)
    forward, relative = arrivals(_stopped(chain, here), there, by_entries=True)
    given = put_on_device((mass + none, forward.value, here, there))
    (gross, net, density), numbers = _flux(chain, *given)
    rate, duration, time, uneven = numbers if traced(numbers) else map(float, numbers)
    # If relative errors are unknown, the sum of errors is compared with the mass on the way.
    behind = _relative(before, total, rate * duration)
    ahead = _relative(relative, forward.certificate.residual, rate / jnp.sum(mass, where=here))
    residual = _largest(backward.residual, behind, ahead, uneven)
    products = backward.iterations + forward.certificate.iterations
    certificate = Certificate(products, residual, TOLERANCE)
    certificate.check("reactive_flux", throw)
    return ReactiveFlux(gross, net, rate, duration, time, density, certificate)


@jax.jit
def _flux(
    chain: Chain,
    mass: Float[Array, "cells"],
    forward: Float[Array, "cells"],
    here: Bool[Array, "cells"],
    there: Bool[Array, "cells"],
) -> tuple[Any, Any]:
    image, me = chain.image.astype(int), jnp.arange(chain.cells)[None]
    # The probabilities of the steps from each cell to its image and back, over all branches.
    step, opposite = me * chain.cells + image, image * chain.cells + me
    order = jnp.sort(step.ravel())
    first = jnp.searchsorted(order, step)
    sums = jnp.zeros(step.size).at[first].add(chain.probability)
    place = jnp.minimum(jnp.searchsorted(order, opposite), step.size - 1)
    forth, back = sums[first], jnp.where(order[place] == opposite, sums[place], 0.0)
    moves = (image != me) & (chain.probability > 0)
    gross = jnp.where(moves, mass[None] * chain.probability * forward[image], 0.0)
    share = jnp.where(moves, chain.probability / jnp.where(moves, forth, 1.0), 0.0)
    net = jnp.maximum(gross - share * (mass[image] * back * forward[None]), 0.0)
    rate = jnp.sum(mass * chain.pull(forward), where=here)
    entering = jnp.sum(chain.push(mass), where=there)
    density = jnp.where(here | there, 0.0, mass * forward)
    uneven = jnp.where(rate > 0, jnp.abs(entering / rate - 1), entering)
    numbers = rate, 1 + jnp.sum(density) / rate, jnp.sum(mass) / rate, uneven
    return (gross, net, density), numbers


def _relative(relative: Any, total: Any, least: Any) -> Any:
    """Bound errors relative to a number, at least `least`, by either of two bounds."""
    error = jnp.fmin(relative, jnp.where(total > 0, jnp.asarray(total) / least, 0.0))
    error = jnp.where(jnp.isnan(error), jnp.inf, error)
    return error if traced(error) else float(error)


def _largest(*errors: Any) -> Any:
    return jnp.stack(errors).max() if traced(errors) else max(errors)


def _two_sets(chain: Chain, source: Any, target: Any) -> tuple[Any, Any, Any]:
    """Return the masks of two sets, and 0, or NaN for traced sets that are not disjoint."""
    here = cell_mask(chain.cells, source, "source")
    there = cell_mask(chain.cells, target, "target")
    both = here & there
    if traced(both):
        wrong = both.any() | ~here.any() | ~there.any()
        return here, there, jnp.where(wrong, jnp.nan, 0.0)
    if both.any():
        raise ValueError(
            f"source, target: expected two disjoint sets, but both have cell {int(both.argmax())}"
        )
    return here, there, 0.0


def _stopped(chain: Chain, here: Any) -> Chain:
    """Return the chain that leaves the space in its next step from the cells `here`."""
    half = None if chain.half is None else _stopped(chain.half, here)
    return Chain(chain.image, jnp.where(here[None], 0.0, chain.probability), half)


def _last_in_source(chain: Chain, here: Any, there: Any) -> tuple[Any, Any, Certificate, Any, Any]:
    """Compute the limiting distribution, and its mass that was last in the source `here`.

    Returns a certificate of the distribution, a bound on the relative errors, and one on their sum.
    """
    limit, relative = limit_of(chain, by_entries=True)
    entering = chain.push(jnp.where(here, limit.value, 0.0))
    form = like(float, chain.cells), like(bool, chain.cells), *CERTIFIED, like(float)
    given = chain, limit.value, here, there, entering
    mass, inside, products, total, more = on_host(_masses, form, *given)
    mass = jnp.where(here, limit.value, expected(mass, chain, inside, entering, adjoint=True))
    certificate = limit.certificate
    iterations = products + certificate.iterations
    total = _largest(certificate.residual, total)
    certificate = Certificate(iterations, certificate.residual, TOLERANCE)
    return limit.value, mass, certificate, 2 * relative + more, total


def _masses(
    matrix: scipy.sparse.csr_array,
    share: Float[np.ndarray, "cells"],
    here: Cells,
    there: Cells,
    entering: Float[np.ndarray, "cells"],
) -> tuple[Any, ...]:
    ends = np.asarray(here | there)
    inside = (share > 0) & ~ends & reaching(matrix, ends)
    mass = np.zeros(ends.size)
    part = Transient.of(matrix, inside)
    found = part.visits(np.asarray(entering)[inside], by_entries=True)
    mass[inside] = found.value
    total = part.sum_error(found) * float(found.value.sum())
    return mass, inside, found.products, total, found.relative
