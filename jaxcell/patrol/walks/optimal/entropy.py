import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy.special
from jaxtyping import Array, Float

from ....base.certificate import Certificate
from ....markov import dense
from ....optimize import Graph
from ....optimize.checked import check_count
from .descent import OptimizedWalk, minimize
from .polytope import ChainPolytope
from .sinkhorn import scale_to_stationary


# Of an entropy, in nats.
_TOLERANCE = 1e-8
# Of a return that comes later than the horizon.
_TAIL = 0.1


def maximum_entropy_rate(
    graph: Graph, stationary: Any = None, *, stay: bool = False, throw: bool = True
) -> OptimizedWalk:
    """The chain whose next step is hardest to predict.

    Without a stationary distribution that is `p_ij = A_ij v_j / (lambda v_i)`, with `lambda` and
    `v` the Perron root and vector of the adjacency matrix `A`: all walks of one length between two
    vertices are then equally likely, and the entropy rate is `log lambda` (Shannon 1948). With one,
    the problem is convex, and the optimum scales the rows and columns of `A` (George, Jafarpour and
    Bullo 2019). Both chains are reversible.

    **Arguments:**

    - `graph`: a connected graph.
    - `stationary`: array `[vertices]`, the share of the time to be spent at each vertex, positive.
    - `stay`: whether the patroller may wait at a vertex.
    - `throw`: whether to raise when the answer is not good enough.

    **Returns:** [`OptimizedWalk`][jaxcell.patrol.OptimizedWalk], with the entropy rate in nats a
    step. The residual of its certificate is by how much, in nats, another chain can be above it.

    **Raises:** `ValueError` for a graph that is not connected, and a stationary distribution that
    no chain on the graph has, naming the vertices at which too much time would be spent;
    `RuntimeError` if rounding spoils the answer.

    On a star with three tips, whose adjacency matrix has the root `sqrt(3)`:

        >>> from jaxcell import patrol
        >>> graph = patrol.Graph([[0, 1], [0, 2], [0, 3]])
        >>> best = patrol.maximum_entropy_rate(graph)
        >>> round(best.value, 6), best.matrix[0].round(6).tolist()
        (0.549306, [0.0, 0.333333, 0.333333, 0.333333])
    """
    among = ChainPolytope.on(graph, stationary, stay=stay)
    ways = among.matrix(np.ones(among.tails.size))
    if among.stationary is None:
        vector = np.abs(np.linalg.eigh(ways)[1][:, -1])
        follow = ways * vector
        growth = follow.sum(axis=1) / vector
        matrix = follow / follow.sum(axis=1, keepdims=True)
        # A chain goes from i to j with a surprise of log growth_i + log v_i - log v_j under this
        # one, whose mean bounds its own entropy, and over a long time the v cancel.
        weight = growth * vector**2
        value = float(weight @ scipy.special.entr(matrix).sum(axis=1) / weight.sum())
        residual = math.log(growth.max()) - value
    else:
        matrix = scale_to_stationary(ways, among.stationary)
        value = float(among.stationary @ scipy.special.entr(matrix).sum(axis=1))
        surprise = -np.log(matrix[among.tails, among.heads])
        gap = among.gap(matrix[among.tails, among.heads], among.stationary[among.tails] * surprise)
        residual = gap + float(np.abs(among.stationary @ matrix - among.stationary).sum())
    certificate = Certificate(1, max(0.0, residual), _TOLERANCE)
    certificate.check("maximum_entropy_rate", throw)
    return OptimizedWalk(matrix, value, 0, certificate)


def maximum_return_time_entropy(
    graph: Graph,
    stationary: Any = None,
    *,
    stay: bool = False,
    horizon: int | None = None,
    starts: int = 8,
    seed: int = 0,
    tolerance: float = 1e-5,
    throw: bool = True,
) -> OptimizedWalk:
    """A chain whose times of return are hard to predict (Duan, George and Bullo 2020).

    The value is [`return_time_entropy`][jaxcell.patrol.return_time_entropy] up to the horizon. The
    problem is not convex: the answer is a local optimum, the best that several starts lead to.

    **Arguments:**

    - `graph`: a connected graph.
    - `stationary`: array `[vertices]`, the share of the time to be spent at each vertex, positive.
    - `stay`: whether the patroller may wait at a vertex.
    - `horizon`: the last number of steps that counts. By default, with a stationary distribution,
        so many that no vertex has a return that is later with a probability of more than 0.1,
        whatever the chain (by Markov's inequality); else as with the uniform one. The mass that a
        chain has beyond is `1 - return_time_law(matrix, horizon).sum(axis=0)`.
    - `starts`: how many chains to start from. The first goes along a short closed tour.
    - `seed`: of the other starts, which are random.
    - `tolerance`: of the residual.
    - `throw`: whether to raise when the answer is not good enough.

    **Returns:** [`OptimizedWalk`][jaxcell.patrol.OptimizedWalk], with the entropy in nats. The
    residual of its certificate is the Frank-Wolfe gap relative to the value, or to 1 if that is
    more: to first order, no chain is better by a larger share.

    **Raises:** as [`maximum_entropy_rate`][jaxcell.patrol.maximum_entropy_rate]; `ValueError` for a
    horizon of less than 1 step.

    A patroller that must move cannot be at one vertex for more than half of the time:

        >>> from jaxcell import patrol
        >>> graph = patrol.Graph([[0, 1], [1, 2], [2, 0]])
        >>> patrol.maximum_return_time_entropy(graph, [0.6, 0.2, 0.2])
        Traceback (most recent call last):
            ...
        ValueError: stationary: vertices 0 have 0.6 of the time, but those that follow have only ...
    """
    among = ChainPolytope.on(graph, stationary, stay=stay)
    if horizon is None:
        least = 1 / graph.vertices if among.stationary is None else float(among.stationary.min())
        horizon = math.ceil(1 / (_TAIL * least)) - 1
    check_count("horizon", horizon)
    found = minimize(
        "maximum_return_time_entropy",
        _predictable,
        among,
        (np.zeros(horizon),),
        starts=starts,
        seed=seed,
        tolerance=tolerance,
        throw=throw,
    )
    return OptimizedWalk(found.matrix, -found.value, found.start, found.certificate)


def return_time_law(
    P: Float[Array, "vertices vertices"], horizon: int
) -> Float[Array, "steps vertices"]:
    """The probability that a chain is first back at a vertex after 1, 2, ... steps.

    **Arguments:**

    - `P`: the transition matrix.
    - `horizon`: the last number of steps that is asked for.

    **Returns:** a row for each number of steps, a column for each vertex.

    **Raises:** `ValueError` for a horizon of less than 1 step.

    Two vertices, between which the chain goes half the time:

        >>> import jax.numpy as jnp
        >>> from jaxcell import patrol
        >>> patrol.return_time_law(jnp.array([[0.5, 0.5], [0.5, 0.5]]), 3).tolist()
        [[0.5, 0.5], [0.25, 0.25], [0.125, 0.125]]
    """
    check_count("horizon", horizon)

    def step(first, _):  # type: ignore[no-untyped-def]
        back = jnp.diagonal(first)
        return P @ (first - jnp.diag(back)), back

    return jax.lax.scan(step, P, None, length=horizon)[1]


def return_time_entropy(P: Float[Array, "vertices vertices"], horizon: int) -> Float[Array, ""]:
    """The entropy of the time until a chain is first back at a vertex, in nats.

    That is `-sum_i pi_i sum_k F_k(i, i) log F_k(i, i)`, with `F_k` the law of the first return and
    `pi` the stationary distribution, as far as the horizon. With none, it is at least the entropy
    rate and at most as many times that as there are vertices.

    **Arguments:**

    - `P`: the transition matrix of an irreducible chain.
    - `horizon`: the last number of steps that counts.

    **Returns:** the entropy in nats, a scalar that can be differentiated in `P`.

    **Raises:** `ValueError` for a horizon of less than 1 step.

    Two vertices, between which the chain goes half the time; nearly all of `2 log 2`:

        >>> import jax.numpy as jnp
        >>> from jaxcell import patrol
        >>> round(float(patrol.return_time_entropy(jnp.array([[0.5, 0.5], [0.5, 0.5]]), 20)), 3)
        1.386
    """
    law = return_time_law(P, horizon)
    surprise = -jnp.log(jnp.where(law > 0, law, 1.0))
    return jnp.sum(dense.stationary(P) * jnp.sum(law * surprise, axis=0))


def _predictable(
    matrices: Float[Array, "1 vertices vertices"], steps: Float[Array, "horizon"]
) -> Float[Array, ""]:
    """The horizon is the length of an array, because the shapes are what is compiled for."""
    return -return_time_entropy(matrices[0], steps.size)
