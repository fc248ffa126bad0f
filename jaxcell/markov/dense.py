"""Quantities of a small chain with one closed class, as functions of its dense transition matrix.

They work under `jit`, `vmap` and `grad`, and do not check the matrix: its rows must sum to 1, and
it must have one closed class; the other cells are transient. Derivatives are exact for changes of
the matrix that preserve the sums of its rows.

All quantities follow from one inverse, `G = (I - P + 1 u')^-1` with `u` the uniform distribution,
which exists even if the chain is periodic. Like the fundamental matrix of Kemeny and Snell, it is a
generalized inverse of `I - P` with `G 1 = 1`. The stationary distribution is `u' G` (Hunter 1982).

A random walk on a line of three cells:

    >>> from jaxcell import examples
    >>> from jaxcell.markov import dense
    >>> P = examples.walk().to_scipy().toarray()
    >>> dense.stationary(P).round(6).tolist(), float(dense.kemeny(P).round(6))
    ([0.25, 0.5, 0.25], 1.5)
    >>> dense.hitting(P).round(6).tolist()
    [[0.0, 1.0, 4.0], [3.0, 0.0, 3.0], [4.0, 1.0, 0.0]]
"""

import functools
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy.typing as npt
from jaxtyping import Array, Float

from ..base.indices import as_array
from ..base.precision import require_x64
from ..base.shown import own_names
from ..base.wide import wide
from ..mapping.generalized import Chain


__dir__ = functools.partial(own_names, globals())


@wide
def matrix(chain: Chain) -> Float[Array, "cells cells"]:
    """Return the transition matrix of a chain, without the sink."""
    cells = jnp.broadcast_to(jnp.arange(chain.cells), chain.image.shape)
    return jnp.zeros((chain.cells, chain.cells)).at[cells, chain.image].add(chain.probability)


def _of_matrix(quantity: Callable[[Array], Array]) -> Callable[[npt.ArrayLike], Array]:
    """Compile a quantity, and let it check and convert its matrix."""
    compiled = jax.jit(quantity)

    @wide
    @functools.wraps(quantity)
    def call(P: npt.ArrayLike) -> Array:
        require_x64(f"dense.{quantity.__name__}")
        matrix = as_array(P, "P")
        if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1]:
            raise ValueError(f"P: expected as many rows as columns, got shape {matrix.shape}")
        if not jnp.issubdtype(matrix.dtype, jnp.floating):
            matrix = matrix.astype(float)
        return compiled(matrix)

    return call


@_of_matrix
def stationary(P: Float[Array, "cells cells"]) -> Float[Array, "cells"]:
    """Compute the stationary distribution, `pi P = pi`."""
    return jnp.mean(_inverse(P), axis=0)


@_of_matrix
def hitting(P: Float[Array, "cells cells"]) -> Float[Array, "cells cells"]:
    """Compute the expected number of steps from each cell to the first visit of each other cell.

    The entry `i, j` is the time from `i` to `j`. If the chain has transient cells, the times from
    them are correct, but the times to them are wrong: they should be infinite.
    """
    inverse = _inverse(P)
    return (jnp.diagonal(inverse)[None, :] - inverse) / jnp.mean(inverse, axis=0)[None, :]


@_of_matrix
def kemeny(P: Float[Array, "cells cells"]) -> Float[Array, ""]:
    """Compute Kemeny's constant: the expected number of steps to a random cell.

    The cell is drawn from the stationary distribution. If the chain starts in this cell, the
    number of steps is 0. The constant is the same for all starts.
    """
    return jnp.trace(_inverse(P)) - 1


@_of_matrix
def entropy_rate(P: Float[Array, "cells cells"]) -> Float[Array, ""]:
    """Compute the entropy of a step, `-sum_ij pi_i p_ij log p_ij`, in nats.

    Derivatives with respect to entries of `P` that are 0 count as 0, although they are infinite.
    """
    edge = P > 0
    surprise = -jnp.log(jnp.where(edge, P, 1.0))
    return jnp.sum(stationary(P) * jnp.sum(P * surprise, axis=1))


@jax.custom_jvp
def _inverse(P: Float[Array, "cells cells"]) -> Float[Array, "cells cells"]:
    # XLA merges equal operations, so a program that computes several quantities of a matrix inverts
    # it once. With jaxlib 0.10, two factorisations of a batch can wait for each other without end.
    cells = P.shape[-1]
    factors, _, order = jax.lax.linalg.lu(jnp.eye(cells, dtype=P.dtype) - P + 1 / cells)
    # JAX refuses `jnp.linalg.inv`, which takes rows of a constant, if the axes of a mesh are
    # explicit. The rest of it is the same.
    rows = (order[:, None] == jnp.arange(cells, dtype=order.dtype)[None]).astype(P.dtype)
    lower = jax.lax.linalg.triangular_solve(
        factors, rows, left_side=True, lower=True, unit_diagonal=True
    )
    return jax.lax.linalg.triangular_solve(factors, lower, left_side=True)


@_inverse.defjvp
def _inverse_jvp(primals, tangents):  # type: ignore[no-untyped-def]
    inverse = _inverse(*primals)
    times = functools.partial(jnp.matmul, precision="highest")
    return inverse, times(times(inverse, tangents[0]), inverse)
