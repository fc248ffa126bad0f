import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jaxtyping import Array, Bool, Float

from ..base.divided import put_on_device, start_loop
from ..base.precision import require_x64
from ..base.wide import namespace, traced
from ..mapping.generalized import Chain, ChainLike
from ..mapping.sequence import check_steps
from .hitting import cell_mask


# Largest difference of the sum of a distribution from 1.
_ROUNDING = 1e-9


def first_passage(
    chain: ChainLike, start: npt.ArrayLike | int, target: npt.ArrayLike | int, steps: int
) -> Float[Array, "{steps}+1"]:
    """Compute the law of the number of steps until a chain first reaches a set of cells.

    The law is exact, because the distribution before the arrival is propagated step by step.

    **Arguments:**

    - `start`: a cell; a list of cells or a mask, from which one cell is drawn with equal
        probability; or the probabilities of all cells as floating-point numbers.
    - `target`: a cell, a list of cells, or a mask over the cells.

    **Returns:** the probability that the chain arrives after `0, 1, ..., steps` steps. The
    rest, up to 1, is the probability that it has not arrived or has left the space.

    A random walk on a line of three cells:

        >>> from jaxcell import examples, markov
        >>> markov.first_passage(examples.walk(), start=0, target=2, steps=5).tolist()
        [0.0, 0.0, 0.5, 0.0, 0.25, 0.0]
    """
    require_x64("first_passage")
    check_steps(steps)
    distribution = start_distribution(chain.cells, start)
    there = cell_mask(chain.cells, target)
    return _law(chain, *put_on_device((distribution, there)), steps)


@functools.partial(jax.jit, static_argnames="steps")
def survivals(
    chain: Chain, there: Bool[Array, "cells"], value: Float[Array, "cells"], steps: int
) -> tuple[Float[Array, "{steps} cells"], Float[Array, "cells"]]:
    """Compute, for each start, the probability that a chain has not arrived in the target `there`.

    `value` contains the probabilities after earlier steps; without any, they are 1 outside the
    target. Returns those after 0 to `steps - 1` more steps, and separately after `steps` steps.
    """
    leaving, rounding = chain.leaving, chain.rounding

    def step(value, _):  # type: ignore[no-untyped-def]
        later = chain.pull(value) + (leaving + rounding * value)
        return jnp.where(there, 0.0, later), value

    start = start_loop(value, chain.probability, there)
    after, values = jax.lax.scan(step, start, length=steps)
    return values, after


@functools.partial(jax.jit, static_argnames="steps")
def _law(
    chain: Chain, start: Float[Array, "cells"], there: Bool[Array, "cells"], steps: int
) -> Float[Array, "{steps}+1"]:
    def step(now, _):  # type: ignore[no-untyped-def]
        return chain.push(jnp.where(there, 0.0, now)), jnp.sum(now, where=there)

    start = start_loop(start, chain.probability, there)
    law = jax.lax.scan(step, start, length=steps + 1)[1]
    return jnp.where(there.any(), law, jnp.nan)


def start_distribution(cells: int, start: Any) -> Any:
    """Return the probability of starting in each cell, as in [`first_passage`][].

    In a program, the probabilities of a wrong start are NaN.
    """
    array = start if traced(start) else np.asarray(start)
    if not array.size or not np.issubdtype(array.dtype, np.floating):
        mask = cell_mask(cells, array, "start")
        xp = namespace(mask)
        share = 1 / xp.maximum(mask.sum(), 1)
        return xp.where(mask.any(), xp.where(mask, share, 0.0), np.nan)
    if array.shape != (cells,):
        raise ValueError(f"start: expected {cells} probabilities, got shape {array.shape}")
    right = (array.min() >= 0) & (abs(array.sum() - 1) <= _ROUNDING)
    if traced(array):
        return jnp.where(right, array, jnp.nan).astype(np.float64)
    if not right:
        raise ValueError(
            f"start: expected probabilities that sum to 1, got the least {array.min()} and the sum "
            f"{array.sum()}"
        )
    return array.astype(np.float64)
