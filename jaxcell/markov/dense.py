"""Quantities of a small irreducible chain, as functions of its dense transition matrix.

They work under `jit`, `vmap` and `grad`, and check nothing: rows must sum to 1, and all cells
except transient ones must make one closed class. Derivatives are exact along changes of the matrix
that keep its row sums, as every parametrisation of the transition probabilities does.

All follow from one inverse, `G = (I - P + 1 u')^-1` with `u` the uniform distribution, which exists
even if the chain is periodic. It is a generalized inverse of `I - P` with `G 1 = 1` that serves
like the fundamental matrix of Kemeny and Snell, and the stationary distribution is `u' G` (Hunter
1982).
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


@jax.jit
def stationary(P: Float[Array, "cells cells"]) -> Float[Array, "cells"]:
    """Compute the distribution with `pi P = pi`.

    A random walk on a line of three cells:

        >>> import jax.numpy as jnp
        >>> from jaxcell.markov import dense
        >>> P = jnp.array([[0, 1, 0], [0.5, 0, 0.5], [0, 1, 0]])
        >>> dense.stationary(P).round(6).tolist()
        [0.25, 0.5, 0.25]
    """
    cells = P.shape[-1]
    return jnp.linalg.solve(_shifted(P).T, jnp.full(cells, 1 / cells, P.dtype))


@jax.jit
def hitting(P: Float[Array, "cells cells"]) -> Float[Array, "cells cells"]:
    """Compute the expected number of steps from cell `i` until first at cell `j`; 0 if `i = j`.

    The chain must be irreducible; times to a transient cell are wrong, times from it are right.

    A random walk on a line of three cells:

        >>> import jax.numpy as jnp
        >>> from jaxcell.markov import dense
        >>> P = jnp.array([[0, 1, 0], [0.5, 0, 0.5], [0, 1, 0]])
        >>> dense.hitting(P).round(6).tolist()
        [[0.0, 1.0, 4.0], [3.0, 0.0, 3.0], [4.0, 1.0, 0.0]]
    """
    inverse = jnp.linalg.inv(_shifted(P))
    return (jnp.diagonal(inverse)[None, :] - inverse) / jnp.mean(inverse, axis=0)[None, :]


@jax.jit
def kemeny(P: Float[Array, "cells cells"]) -> Float[Array, ""]:
    """Compute Kemeny's constant: the expected number of steps to a cell drawn from `pi`.

    A cell drawn where the chain is counts 0 steps.

    A random walk on a line of three cells:

        >>> import jax.numpy as jnp
        >>> from jaxcell.markov import dense
        >>> P = jnp.array([[0, 1, 0], [0.5, 0, 0.5], [0, 1, 0]])
        >>> float(dense.kemeny(P).round(6))
        1.5
    """
    return jnp.trace(jnp.linalg.inv(_shifted(P))) - 1


@jax.jit
def entropy_rate(P: Float[Array, "cells cells"]) -> Float[Array, ""]:
    """Compute the entropy of a step, `-sum_ij pi_i p_ij log p_ij`, in nats.

    An entry that is 0 is no edge; its derivative, which is infinite, counts as 0.

    A random walk on a line of three cells:

        >>> import jax.numpy as jnp
        >>> from jaxcell.markov import dense
        >>> P = jnp.array([[0, 1, 0], [0.5, 0, 0.5], [0, 1, 0]])
        >>> float((dense.entropy_rate(P) / jnp.log(2.0)).round(6))
        0.5
    """
    edge = P > 0
    surprise = -jnp.log(jnp.where(edge, P, 1.0))
    return jnp.sum(stationary(P) * jnp.sum(P * surprise, axis=1))


def _shifted(P: Float[Array, "cells cells"]) -> Float[Array, "cells cells"]:
    cells = P.shape[-1]
    return jnp.eye(cells, dtype=P.dtype) - P + 1 / cells
