import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
import scipy.sparse
from jaxtyping import Array, Float, Int

from ....base.certificate import Certificate, Numbers, Real
from ....base.precision import require_x64
from ....base.process import one_blas_thread
from ....base.shown import Shown
from ....mapping import Chain
from ....optimize.validation import check_count
from .polytope import ChainPolytope


# Pressures of the barrier, for all moves together and relative to the value. They fall so slowly
# that a few quasi-Newton steps are enough for each pressure.
_PRESSURES = 10 ** -np.arange(3, 9.1, 0.5)
_STEPS = 60
# Number of stored steps and gradients: fewer cannot model the different curvatures of the barrier.
_MEMORY = 30

# The function to minimise, of the transition matrices of the robots and further arguments.
Measure = Callable[..., Float[Array, ""]]


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class OptimizedWalk(Shown):
    """A chain of a patroller that minimises or maximises a quantity, such as its entropy rate."""

    matrix: Float[Numbers, "vertices vertices"]
    value: Real
    "The value of the minimised or maximised quantity."
    certificate: Certificate

    @property
    def chain(self) -> Chain:
        """The chain whose cells are the vertices."""
        return Chain.from_scipy(scipy.sparse.csr_array(self.matrix))


def minimize(
    what: str,
    measure: Measure,
    polytope: ChainPolytope,
    arguments: tuple[Any, ...],
    *,
    starts: int,
    seed: int,
    tolerance: float,
    throw: bool,
) -> OptimizedWalk:
    """Minimise `measure(matrices, *arguments)` from several starts, and return the best chain.

    `what` is the name of the calling function, for messages.

    **Returns:** [`OptimizedWalk`][]. The residual of its certificate is the Frank-Wolfe gap divided
    by the value, or by 1 if the value is below 1: to first order, no chain improves the value by a
    larger share. If the problem is convex, this holds for any change, not only to first order. The
    iterations are the total over all starts.
    """
    require_x64(what)
    check_count("starts", starts)
    begin = polytope.starts(starts, 1, seed)
    chains, values, steps = descend(measure, polytope, begin, arguments)
    best = int(np.nanargmin(values))
    moves = chains[best, 0]
    matrix = polytope.matrix(moves)
    gradient = np.asarray(_gradient(measure, matrix[None], arguments))[0]
    gap = polytope.gap(moves, -gradient[polytope.tails, polytope.heads])
    value = float(values[best])
    certificate = Certificate(steps, gap / max(1, abs(value)), tolerance)
    certificate.check(what, throw)
    return OptimizedWalk(matrix, value, certificate)


@one_blas_thread()
def descend(
    measure: Measure,
    polytope: ChainPolytope,
    starts: Float[np.ndarray, "starts robots moves"],
    arguments: tuple[Any, ...],
    most: int = _STEPS,
) -> tuple[Float[np.ndarray, "starts robots moves"], Float[np.ndarray, "starts"], int]:
    """Follow the gradient within the polytope of the chains, from several starts.

    A logarithmic barrier keeps all probabilities positive; its weight, the pressure, falls. For
    each pressure, at most `most` steps of L-BFGS minimise the measure. Their variables are the
    relative changes of the probabilities, projected so that the equalities remain satisfied. This
    affine scaling finds optima with many probabilities of 0; Adam and L-BFGS on logits slow down
    near such optima. Starts run one after the other, because under `vmap` all line searches would
    wait for the slowest.

    The measure is a function of the transition matrices `[robots, vertices, vertices]` and the
    arguments. It is compiled once per shape if it is the same function object in each call.

    **Returns:** the chains, their values, and the number of steps taken.
    """
    fixed = polytope.tails, polytope.heads, polytope.equalities()[0]
    # optax mixes integers of 32 and 64 bits.
    with jax.numpy_dtype_promotion("standard"):
        paths = [
            _path(measure, polytope.vertices, *fixed, start, arguments, most) for start in starts
        ]
    chains, values, steps = (np.array(part) for part in zip(*paths, strict=True))
    return chains, values, int(steps.sum())


@functools.partial(jax.jit, static_argnames=("measure", "vertices"))
def _path(
    measure: Measure,
    vertices: int,
    tails: Int[Array, "moves"],
    heads: Int[Array, "moves"],
    equalities: Float[Array, "equalities moves"],
    start: Float[Array, "robots moves"],
    arguments: tuple[Any, ...],
    most: int | Int[Array, ""],
) -> tuple[Float[Array, "robots moves"], Float[Array, ""], Int[Array, ""]]:
    robots, moves = start.shape
    optimizer = optax.lbfgs(memory_size=_MEMORY)

    def value(p):  # type: ignore[no-untyped-def]
        matrix = jnp.zeros((robots, vertices, vertices), p.dtype)
        return measure(matrix.at[:, tails, heads].set(p), *arguments)

    def pressed(carry, pressure):  # type: ignore[no-untyped-def]
        p, unit, taken = carry
        scaled = equalities[None] * p[:, None, :]
        inverse = jnp.linalg.pinv(scaled, rtol=1e-12)

        def moved(x):  # type: ignore[no-untyped-def]
            """Apply the relative changes `x`, projected onto those that preserve the equalities."""
            broken = jnp.einsum("rej,rj->re", scaled, x)
            return p * (1 + x - jnp.einsum("rie,re->ri", inverse, broken))

        def loss(x):  # type: ignore[no-untyped-def]
            q = moved(x)
            inside = jnp.all(q > 0)
            q = jnp.where(inside, q, p)
            barrier = pressure * jnp.mean(jnp.log(q))
            return jnp.where(inside, value(q) / unit - barrier, jnp.inf)

        derivative = optax.value_and_grad_from_state(loss)

        def step(state):  # type: ignore[no-untyped-def]
            x, memory, steps, _ = state
            at, gradient = derivative(x, state=memory)
            change, memory = optimizer.update(
                gradient, memory, x, value=at, grad=gradient, value_fn=loss
            )
            return x + change, memory, steps + 1, jnp.max(jnp.abs(gradient))

        def goes_on(state):  # type: ignore[no-untyped-def]
            _, _, steps, slope = state
            # In these coordinates, the slope of the barrier is its pressure on a move.
            return (steps < most) & (slope > 1e-2 * pressure / moves)

        x = jnp.zeros_like(p)
        begin = (x, optimizer.init(x), jnp.array(0), jnp.array(jnp.inf, p.dtype))
        x, _, steps, _ = jax.lax.while_loop(goes_on, step, begin)
        return (moved(x), unit, taken + steps), None

    begin = (start, jnp.maximum(1, jnp.abs(value(start))), jnp.array(0))
    (p, _, taken), _ = jax.lax.scan(pressed, begin, jnp.asarray(_PRESSURES))
    return p, value(p), taken


@functools.partial(jax.jit, static_argnames=("measure",))
def _gradient(
    measure: Measure, matrices: Float[Array, "robots vertices vertices"], arguments: tuple[Any, ...]
) -> Float[Array, "robots vertices vertices"]:
    return jax.grad(measure)(matrices, *arguments)
