import functools
import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy.special
from jaxtyping import Array, Float

from ....base.certificate import Certificate
from ....base.precision import require_x64
from ....base.wide import traced
from ....mapping.traced import first_derivative_only, implicit, like, on_host
from ....markov import dense
from ....optimize import Graph, GraphLike
from ....optimize.validation import check_count
from .descent import OptimizedWalk, minimize
from .polytope import ChainPolytope
from .sinkhorn import scale_to_stationary


# Tolerance of an entropy, in nats.
_TOLERANCE = 1e-8
# Largest probability of a return after the default horizon.
_TAIL = 0.1


def maximum_entropy_rate(
    graph: GraphLike, stationary: Any = None, *, stay: bool = False, throw: bool = True
) -> OptimizedWalk:
    """Find the chain with the largest entropy rate, whose next step is hardest to predict.

    Without a stationary distribution, the chain is `p_ij = A_ij v_j / (lambda v_i)`, with `lambda`
    and `v` the Perron root and vector of the adjacency matrix `A`: all walks of one length between
    two vertices are equally likely, and the entropy rate is `log lambda` (Shannon 1948). With a
    stationary distribution the problem is convex, and the optimum scales the rows and columns of
    `A` (George, Jafarpour and Bullo 2019). Both chains are reversible.

    **Arguments:** as in [`jaxcell.patrol.walks.minimum_kemeny`][]. **Returns:**
    [`OptimizedWalk`][jaxcell.patrol.walks.OptimizedWalk], with the entropy rate in nats per step.
    The residual of its certificate, in nats, is an upper bound on the amount by which another chain
    can exceed this rate. The distribution may be traced by `jit`, `vmap` and `grad`.

    A star with three leaves, whose adjacency matrix has the Perron root `sqrt(3)`:

        >>> from jaxcell import patrol
        >>> graph = patrol.Graph([[0, 1], [0, 2], [0, 3]])
        >>> best = patrol.walks.maximum_entropy_rate(graph)
        >>> round(best.value, 6), best.matrix[0].round(6).tolist()
        (0.549306, [0.0, 0.333333, 0.333333, 0.333333])
    """
    require_x64("maximum_entropy_rate")
    if stationary is None:
        among = ChainPolytope.on(graph, stay=stay)
        adjacency = among.matrix(np.ones(among.tails.size))
        vector = np.abs(np.linalg.eigh(adjacency)[1][:, -1])
        follow = adjacency * vector
        growth = follow.sum(axis=1) / vector
        matrix = follow / follow.sum(axis=1, keepdims=True)
        # Under this chain, a step of any chain from i to j has the surprise log growth_i + log v_i
        # - log v_j. Its mean bounds the entropy of that chain, and in the long run the v cancel.
        weight = growth * vector**2
        value = float(weight @ scipy.special.entr(matrix).sum(axis=1) / weight.sum())
        residual = math.log(growth.max()) - value
        residual = max(0.0, residual)
    else:
        compute = functools.partial(_scaled, graph, stay)
        form = like(float, graph.vertices, graph.vertices), like(float), like(float)
        matrix, value, residual = on_host(compute, form, (), stationary)
        if traced(stationary):
            matrix, value = implicit(_scaled_change, (matrix, value), stationary)
    certificate = Certificate(1, residual, _TOLERANCE)
    certificate.check("maximum_entropy_rate", throw)
    return OptimizedWalk(matrix, value, certificate)


def _scaled(
    graph: Graph, stay: bool, _: tuple[()], stationary: Any
) -> tuple[Float[np.ndarray, "vertices vertices"], float, float]:
    among = ChainPolytope.on(graph, stationary, stay=stay)
    share: Any = among.stationary
    matrix = scale_to_stationary(among.matrix(np.ones(among.tails.size)), share)
    value = float(share @ scipy.special.entr(matrix).sum(axis=1))
    surprise = -np.log(matrix[among.tails, among.heads])
    gap = among.gap(matrix[among.tails, among.heads], share[among.tails] * surprise)
    residual = gap + float(np.abs(share @ matrix - share).sum())
    return matrix, value, max(0.0, residual)


@first_derivative_only("maximum_entropy_rate")
def _scaled_change(now: Any, stationary: Float[Array, "vertices"]) -> Any:
    """Compute the chain and its entropy rate from their values, for their derivatives.

    The flows `a_i w_ij b_j` change with the logarithms of `a` and `b`, so that the sums of their
    rows and columns remain the shares of time.
    """
    matrix, value = now
    share = stationary / jnp.sum(stationary)
    fixed = jax.lax.stop_gradient(share)
    flow = fixed[:, None] * matrix
    sums = jnp.block([[jnp.diag(fixed), flow], [flow.T, jnp.diag(fixed)]])
    a, b = jnp.split(jnp.linalg.pinv(sums) @ jnp.tile(share - fixed, 2), 2)
    change = flow * (a[:, None] + b[None, :])
    surprise = -jnp.log(jnp.where(matrix > 0, matrix, 1.0))
    return (flow + change) / share[:, None], value + jnp.sum(change * surprise)


def maximum_return_time_entropy(
    graph: GraphLike,
    stationary: Any = None,
    *,
    stay: bool = False,
    horizon: int | None = None,
    starts: int = 8,
    seed: int = 0,
    tolerance: float = 1e-2,
    throw: bool = True,
) -> OptimizedWalk:
    """Find a chain whose return times are hard to predict (Duan, George and Bullo 2020).

    The value is [`return_time_entropy`][jaxcell.patrol.walks.return_time_entropy] up to the
    horizon. The problem is not convex: the result is a local optimum, the best of several starts.

    **Arguments:**

    - `graph`, `stationary`, `stay`, `starts`, `seed`, `throw`: as in
        [`jaxcell.patrol.walks.minimum_kemeny`][].
    - `horizon`: the longest return time that counts. By default it is so long that, at each vertex,
        longer return times have a probability of at most 0.1 for any chain with the stationary
        distribution, or with the uniform one if none is given (Markov's inequality).
    - `tolerance`: tolerance of the residual; on trees, less than 0.001 takes many steps.

    **Returns:** [`OptimizedWalk`][jaxcell.patrol.walks.OptimizedWalk], with the entropy in nats.
    The residual of its certificate is that of [`jaxcell.patrol.walks.minimum_kemeny`][].

    A patroller that must move cannot be at one vertex for more than half of the time:

        >>> from jaxcell import patrol
        >>> graph = patrol.Graph([[0, 1], [1, 2], [2, 0]])
        >>> patrol.walks.maximum_return_time_entropy(graph, [0.6, 0.2, 0.2])
        Traceback (most recent call last):
            ...
        ValueError: stationary: vertices 0 have 0.6 of the time, but those that follow have only ...
    """
    among = ChainPolytope.on(graph, stationary, stay=stay)
    if horizon is None:
        least = 1 / graph.vertices if among.stationary is None else float(among.stationary.min())
        horizon = math.ceil(1 / (_TAIL * least)) - 1
    check_count("horizon", horizon)
    search: Any = {"starts": starts, "seed": seed, "tolerance": tolerance, "throw": throw}
    name = "maximum_return_time_entropy"
    walk = minimize(name, _predictable, among, (np.zeros(horizon),), **search)
    return OptimizedWalk(walk.matrix, -walk.value, walk.certificate)


def return_time_entropy(P: Float[Array, "vertices vertices"], horizon: int) -> Float[Array, ""]:
    """Compute the entropy of the time of first return to a vertex, in nats.

    The entropy is `-sum_i pi_i sum_k F_k(i, i) log F_k(i, i)`, with `F_k` the law of the first
    return and `pi` the stationary distribution, up to the horizon.

    **Arguments:** the transition matrix of an irreducible chain, and the longest return time that
    counts. **Returns:** the entropy in nats, a scalar that is differentiable in `P`.

    Two vertices; half of the steps go to the other vertex. The entropy is nearly `2 log 2`:

        >>> import jax.numpy as jnp
        >>> from jaxcell import patrol
        >>> round(float(patrol.walks.return_time_entropy(jnp.full((2, 2), 0.5), 20)), 3)
        1.386
    """
    check_count("horizon", horizon)

    def step(first, _):  # type: ignore[no-untyped-def]
        back = jnp.diagonal(first)
        return P @ (first - jnp.diag(back)), back

    law = jax.lax.scan(step, P, None, length=horizon)[1]
    surprise = -jnp.log(jnp.where(law > 0, law, 1.0))
    return jnp.sum(dense.stationary(P) * jnp.sum(law * surprise, axis=0))


def _predictable(
    matrices: Float[Array, "1 vertices vertices"], steps: Float[Array, "horizon"]
) -> Float[Array, ""]:
    # The horizon is passed as the length of an array because JAX compiles once per shape.
    return -return_time_entropy(matrices[0], steps.size)
