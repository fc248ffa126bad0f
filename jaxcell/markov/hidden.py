import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..mapping import ObservedChain


@jax.jit
def filtered(
    model: ObservedChain, start: Float[Array, "cells"], observations: Int[Array, "times"]
) -> tuple[Float[Array, "times+1 cells"], Float[Array, ""]]:
    """How probable each cell is after each observation: the forward filter of a hidden chain.

    Works under `vmap` over the start and the observations.

    **Arguments:**

    - `model`: the chain with its observations.
    - `start`: the distribution before the first observation.
    - `observations`: 0 or 1 each.

    **Returns:** the distributions, all 0 after an observation that cannot be, and the logarithm of
    the probability of the observations.

    A robot in one of three cells in a row, which goes on for sure and bumps at the end:

        >>> import numpy as np
        >>> from jaxcell import mapping, markov
        >>> moves, bumps = np.eye(3, k=1), np.diag([0.0, 0.0, 1.0])
        >>> model = mapping.ObservedChain.from_scipy(moves, bumps)
        >>> found, _ = markov.filtered(model, np.ones(3) / 3, np.array([0, 1]))
        >>> found.round(3).tolist()
        [[0.333, 0.333, 0.333], [0.0, 0.5, 0.5], [0.0, 0.0, 1.0]]
    """

    def observe(weight, observation):  # type: ignore[no-untyped-def]
        weight = model.step(weight, observation)
        total = weight.sum()
        weight = weight / jnp.where(total > 0, total, 1.0)
        return weight, (weight, total)

    _, (later, totals) = jax.lax.scan(observe, start, observations)
    return jnp.concatenate([start[None], later]), jnp.log(totals).sum()


@jax.jit
def smoothed(
    model: ObservedChain, start: Float[Array, "cells"], observations: Int[Array, "times"]
) -> Float[Array, "times+1 cells"]:
    """How probable each cell was at each time, given all observations.

    Works under `vmap` over the start and the observations.

    **Arguments:**

    - `model`, `start`, `observations`: as for [`filtered`][].

    **Returns:** the distributions, all 0 where the observations cannot be.

    A robot in one of three cells in a row that does not bump in two steps began in the first:

        >>> import numpy as np
        >>> from jaxcell import mapping, markov
        >>> moves, bumps = np.eye(3, k=1), np.diag([0.0, 0.0, 1.0])
        >>> model = mapping.ObservedChain.from_scipy(moves, bumps)
        >>> markov.smoothed(model, np.ones(3) / 3, np.array([0, 0])).tolist()
        [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    """
    forward, _ = filtered(model, start, observations)

    def before(value, observation):  # type: ignore[no-untyped-def]
        value = model.back(value, observation)
        value = value / jnp.where(value.max() > 0, value.max(), 1.0)
        return value, value

    last = jnp.ones_like(start)
    _, back = jax.lax.scan(before, last, observations, reverse=True)
    weight = forward * jnp.concatenate([back, last[None]])
    total = weight.sum(axis=1, keepdims=True)
    return weight / jnp.where(total > 0, total, 1.0)


@jax.jit
def possible(
    model: ObservedChain, start: Bool[Array, "cells"], observations: Int[Array, "times"]
) -> Bool[Array, "times+1 cells"]:
    """The cells that each observation leaves possible, whatever their probabilities.

    Works under `vmap` over the start and the observations.

    **Arguments:**

    - `model`, `observations`: as for [`filtered`][].
    - `start`: the cells that are possible before the first observation.

    **Returns:** the sets.

    A robot in one of three cells in a row, which goes on for sure and bumps at the end:

        >>> import numpy as np
        >>> from jaxcell import mapping, markov
        >>> moves, bumps = np.eye(3, k=1), np.diag([0.0, 0.0, 1.0])
        >>> model = mapping.ObservedChain.from_scipy(moves, bumps)
        >>> markov.possible(model, np.ones(3, bool), np.array([0])).tolist()
        [[True, True, True], [False, True, True]]
    """

    def observe(known, observation):  # type: ignore[no-untyped-def]
        known = model.step(known.astype(model.chain.probability.dtype), observation) > 0
        return known, known

    _, later = jax.lax.scan(observe, start, observations)
    return jnp.concatenate([start[None], later])
