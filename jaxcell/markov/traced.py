"""Derivatives of quantities of chains in programs of JAX.

A quantity `x` solves a linear system `A x = b`, so its derivative solves `A dx = db - dA x`: the
same system with another right-hand side, or the transposed one (Schweitzer 1968).
"""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse
from jaxtyping import Array, Bool, Float

from ..base.wide import traced
from ..mapping.batch import Batch
from ..mapping.generalized import Chain
from ..mapping.traced import implicit, like, on_host
from .solving.rounds import eliminated
from .solving.solve import solve_signed
from .transient import Transient


# The number of iterations of a solver, and its residual.
CERTIFIED = like(int), like(float)


def expected(
    value: Float[Array | np.ndarray, "cells"],
    chain: Chain,
    inside: Bool[Array | np.ndarray, "cells"],
    gain: Any,
    *,
    adjoint: bool = False,
) -> Any:
    """Return `value` with its derivatives, where it solves `x = gain + P x` on cells `inside`.

    With `adjoint`, the equation is `x = gain + P' x`, and values of other cells are 0. Otherwise
    they are constant; those that are infinite do not matter to cells `inside`.
    """
    if not traced(value, chain, inside, gain):
        return value
    change = _visits_change if adjoint else _expected_change
    return implicit(change, value, (chain, inside, jnp.asarray(gain, value.dtype)))


def _expected_change(value: Any, inputs: Any, adjoint: bool = False) -> Any:
    chain, inside, gain = inputs
    now = jnp.where(inside if adjoint else jnp.isfinite(value), value, 0.0)
    left = gain + (chain.push(now) if adjoint else chain.pull(now)) - now
    return solve(chain, inside, left - jax.lax.stop_gradient(left), adjoint=adjoint)


def _visits_change(value: Any, inputs: Any) -> Any:
    return _expected_change(value, inputs, adjoint=True)


def solve(
    chain: Chain,
    inside: Bool[Array, "cells"],
    right: Float[Array, "cells"],
    *,
    adjoint: bool = False,
) -> Float[Array, "cells"]:
    """Solve `x = right + Q x`, or `x = right + Q' x` if `adjoint`, where `Q` is `P` on `inside`.

    Values of other cells are 0. The solution has derivatives in the probabilities and `right`.
    """
    step = chain.push if adjoint else chain.pull

    def apply(x: Float[Array, "cells"]) -> Float[Array, "cells"]:
        here = jnp.where(inside, x, 0.0)
        return x - jnp.where(inside, step(here), 0.0)

    def on(transposed: bool) -> Callable[..., Any]:
        one, many = (functools.partial(f, adjoint=transposed) for f in (_solved, _solved_of_many))
        form = like(float, chain.cells)
        return lambda _, b: on_host(one, form, chain, inside, b, many=many)

    right = jnp.where(inside, right, 0.0)
    return jax.lax.custom_linear_solve(apply, right, on(adjoint), on(not adjoint))


def _solved(
    matrix: scipy.sparse.csr_array,
    inside: Bool[np.ndarray, "cells"],
    right: Float[np.ndarray, "cells"],
    *,
    adjoint: bool,
) -> Float[np.ndarray, "cells"]:
    # Values of other cells are not changed by a solve.
    x, b = right.copy(), right[inside]
    if not b.any():
        return x
    part = Transient.of(matrix, inside)
    x[inside] = solve_signed(
        lambda columns: part.visited(columns)[0] if adjoint else part.expect(columns).value[:, :-1],
        b,
    )
    return x


def _solved_of_many(
    batch: Batch,
    inside: Bool[np.ndarray, "cells"],
    right: Float[np.ndarray, "members cells"],
    *,
    adjoint: bool,
) -> Float[np.ndarray, "members cells"]:
    # Eliminations without subtractions lose no digits.
    more, less = np.maximum(right.T, 0), np.maximum(-right.T, 0)
    x = eliminated(batch, inside, more, adjoint=adjoint)[0]
    return (x - eliminated(batch, inside, less, adjoint=adjoint)[0] if less.any() else x).T
