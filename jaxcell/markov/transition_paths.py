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
from ..base.wide import namespace, traced
from ..mapping.classes import reaching
from ..mapping.generalized import Chain, ChainLike
from ..mapping.traced import like, on_host
from .conditional import arrival_probabilities
from .hitting import TOLERANCE, Cells, cell_mask
from .limiting import limiting_distribution
from .traced import CERTIFIED, visited
from .transient import Transient


def committor(
    chain: ChainLike,
    source: npt.ArrayLike | int,
    target: npt.ArrayLike | int,
    *,
    backward: bool = False,
    throw: bool = True,
) -> Solution:
    """Compute the probability that a chain reaches a target before it reaches a source.

    The forward committor of a cell in neither set looks ahead: it is the probability that the chain
    reaches the target next. It is 0 if the chain ends elsewhere or leaves the space. The backward
    committor looks back: it is the probability that a chain in the long run, which is in the cell
    now, was last in the source and not in the target (E and Vanden-Eijnden 2006; Metzner, Schuette
    and Vanden-Eijnden 2009).

    **Arguments:** a chain; two disjoint sets of cells, each as a cell, a list of cells, or a mask;
    and whether to look back.

    **Returns:** the forward committor of each cell, 0 in the source and 1 in the target; or the
    backward committor, 1 in the source, 0 in the target, and NaN in cells where the chain never is
    in the long run. The residual of the certificate bounds the error of every probability, or the
    mean of the errors in the limiting distribution if `backward`.

    A random walk on a line of five cells:

        >>> import numpy as np
        >>> from jaxcell import markov
        >>> P = (np.eye(5, k=1) + np.eye(5, k=-1)) / 2
        >>> P[0, 0] = P[4, 4] = 0.5
        >>> markov.committor(P, source=0, target=4).value.round(6).tolist()
        [0.0, 0.25, 0.5, 0.75, 1.0]
        >>> markov.committor(P, source=0, target=4, backward=True).value.round(6).tolist()
        [1.0, 0.75, 0.5, 0.25, 0.0]
    """
    require_x64("committor")
    here, there, both = _two_sets(chain, source, target)
    if backward:
        share, mass, certificate = _last_in_source(chain, here, there)
        xp = namespace(share, mass)
        seen = share > 0
        value = xp.where(seen, mass / xp.where(seen, share, 1.0), xp.nan)
        solution = Solution(put_on_device(value + both), certificate)
    else:
        found = arrival_probabilities(_stopped(chain, here), there, throw=False)
        solution = dataclasses.replace(found, value=found.value + both)
    solution.certificate.check("committor", throw)
    return solution


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class ReactiveFlux(Pictured):
    """The transitions of a chain in the long run: its paths from a source directly to a target.

    A transition begins at the last cell of the source and ends at the first cell of the target.
    """

    gross: Float[Array, "branches cells"]
    """The number of transitions per step of the chain that use each branch: the image
    `chain.image[branch, cell]` after the cell. Steps that stay in a cell count as 0."""
    net: Float[Array, "branches cells"]
    "The same, minus the transitions that go back from the image to the cell; at least 0."
    rate: Real
    "The number of transitions per step of the chain."
    duration: Real
    "The mean number of steps of a transition; NaN if there are none."
    time: Real
    """The mean time until the chain is in the target, after it came to the source from the target:
    the number of steps per transition in which the chain was last in the source."""
    density: Float[Array, "cells"]
    "The share of the time that the chain is in each cell during a transition, between the sets."
    certificate: Certificate
    """The certificate. Its residual is the largest of the residuals of the limiting distribution
    and of the forward committor, the mean error of the backward committor, and the relative
    difference of the numbers of transitions that leave the source and enter the target."""


def reactive_flux(
    chain: ChainLike,
    source: npt.ArrayLike | int,
    target: npt.ArrayLike | int,
    *,
    throw: bool = True,
) -> ReactiveFlux:
    """Compute the flux of transitions from a source to a target in the long run.

    With the limiting distribution `pi`, the backward committor `b` and the forward committor `f`,
    the flux from cell `i` to cell `j` is `pi_i b_i p_ij f_j` (transition path theory: Metzner,
    Schuette and Vanden-Eijnden 2009). Small numbers keep their digits, because masses `pi b` are
    computed as expected visits, without the division by `pi`.

    **Arguments:** a chain with a persistent group, and two disjoint sets of cells. The rate is 0
    unless a persistent group has cells in both sets. **Returns:** the flux of each branch, the rate
    of transitions, and their durations.

    **Raises:** `ValueError` if the chain has no persistent group, because it leaves the space.

    A random walk on a line of five cells:

        >>> import numpy as np
        >>> from jaxcell import markov
        >>> P = (np.eye(5, k=1) + np.eye(5, k=-1)) / 2
        >>> P[0, 0] = P[4, 4] = 0.5
        >>> flux = markov.reactive_flux(P, source=0, target=4)
        >>> round(flux.rate, 6), round(flux.time, 6), round(flux.duration, 6)
        (0.025, 20.0, 6.0)
    """
    require_x64("reactive_flux")
    here, there, both = _two_sets(chain, source, target)
    share, mass, backward = _last_in_source(chain, here, there)
    if not traced(share) and not np.any(share):
        raise ValueError(
            "reactive_flux: the chain has no persistent group, so nothing remains in the long run; "
            "committor and visits serve chains that leave the space"
        )
    forward = arrival_probabilities(_stopped(chain, here), there, throw=False)
    given = put_on_device((mass + both, forward.value, here, there))
    gross, net, rate, duration, time, density, uneven = _flux(chain, *given)
    if not traced(gross):
        rate, duration, time, uneven = (float(x) for x in (rate, duration, time, uneven))
    errors = backward.residual, forward.certificate.residual, uneven
    worst: Any = jnp.stack(errors).max() if traced(errors) else max(errors)
    products = backward.iterations + forward.certificate.iterations
    certificate = Certificate(products, worst, TOLERANCE)
    certificate.check("reactive_flux", throw)
    return ReactiveFlux(gross, net, rate, duration, time, density, certificate)


@jax.jit
def _flux(
    chain: Chain,
    mass: Float[Array, "cells"],
    forward: Float[Array, "cells"],
    here: Bool[Array, "cells"],
    there: Bool[Array, "cells"],
) -> tuple[Any, ...]:
    image, me = chain.image, jnp.arange(chain.cells, dtype=chain.image.dtype)[None]

    def add(sums, branch):  # type: ignore[no-untyped-def]
        forth, back = sums
        end, chance = branch
        forth = forth + jnp.where(end[None] == image, chance[None], 0.0)
        return (forth, back + jnp.where(end[image] == me, chance[image], 0.0)), None

    start = jnp.zeros_like(chain.probability), jnp.zeros_like(chain.probability)
    # The probabilities of the steps from each cell to its image and back, over all branches.
    (forth, back), _ = jax.lax.scan(add, start, (image, chain.probability))
    moves = (image != me) & (chain.probability > 0)
    gross = jnp.where(moves, mass[None] * chain.probability * forward[image], 0.0)
    share = jnp.where(moves, chain.probability / jnp.where(moves, forth, 1.0), 0.0)
    net = jnp.maximum(gross - share * (mass[image] * back * forward[None]), 0.0)
    rate = jnp.sum(mass * chain.pull(forward), where=here)
    entering = jnp.sum(chain.push(mass), where=there)
    density = jnp.where(here | there, 0.0, mass * forward)
    duration = 1 + jnp.sum(density) / rate
    uneven = jnp.where(rate > 0, jnp.abs(entering / rate - 1), entering)
    return gross, net, rate, duration, jnp.sum(mass) / rate, density, uneven


def _two_sets(chain: Chain, source: Any, target: Any) -> tuple[Any, Any, Any]:
    """Return the masks of two sets, and 0, or NaN for traced sets that are not disjoint."""
    here = cell_mask(chain.cells, source, "source")
    there = cell_mask(chain.cells, target, "target")
    xp = namespace(here, there)
    both = here & there
    if traced(both):
        wrong = both.any() | ~here.any() | ~there.any()
        return here, there, xp.where(wrong, xp.nan, 0.0)
    if both.any():
        raise ValueError(
            f"source, target: expected two disjoint sets, but both have cell {int(both.argmax())}"
        )
    return here, there, 0.0


def _stopped(chain: Chain, here: Any) -> Chain:
    """Return the chain that leaves the space in its next step from the cells `here`."""
    half = None if chain.half is None else _stopped(chain.half, here)
    probability = jnp.where(jnp.asarray(here)[None], 0.0, chain.probability)
    return Chain(chain.image, probability, half)


def _last_in_source(chain: Chain, here: Any, there: Any) -> tuple[Any, Any, Certificate]:
    """Compute the limiting distribution, and its mass that was last in the source `here`."""
    limit = limiting_distribution(chain, throw=False)
    share = limit.value
    xp = namespace(share, here)
    entering = chain.push(xp.where(here, share, 0.0))
    form = like(float, chain.cells), like(bool, chain.cells), *CERTIFIED
    mass, inside, products, error = on_host(_masses, form, chain, share, here, there, entering)
    mass = visited(mass, chain, inside, entering)
    mass = xp.where(here, share, mass)
    residual = namespace(error, limit).maximum(limit.certificate.residual, error)
    products = products + limit.certificate.iterations
    return share, mass, Certificate(products, residual, TOLERANCE)


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
    found = part.visits(np.asarray(entering)[inside])
    mass[inside] = found.value
    return mass, inside, found.products, part.sum_error(found) * float(found.value.sum())
