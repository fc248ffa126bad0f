import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from ..base.certificate import Certificate
from ..base.connected import check_connected, vertices_apart
from ..base.limits import MAX_VERTICES
from . import conic
from .checked import one_each
from .conic import Rules
from .constraints import Linear, room
from .graph import Graph
from .multiplicative import least_resistance
from .resistance import Emphasis, HostLaplacian, interior_point
from .tour import on_walk, shortest_tour


# With more vertices, a method of first order closes the gap this far, in so many inversions.
_COARSE, _INVERSIONS = 1e-2, 300


@dataclasses.dataclass(frozen=True, eq=False)
class MinimumCommute:
    """The weights of the edges with which a walk commutes fastest."""

    weights: Float[np.ndarray, "edges"]
    "The weight of each edge; they are not negative and sum to 1."
    commute_time: float
    "The mean over pairs of vertices of the expected time there and back, in steps or as given."
    tour: Int[np.ndarray, "steps"] | None
    "The closed walk whose edges are emphasised, in order."
    certificate: Certificate
    prices: Float[np.ndarray, "constraints"] | None = None
    "By how much the time falls for each linear constraint, to first order, if it yields by 1."


def minimum_commute(
    graph: Graph,
    emphasis: Sequence[int] | None = None,
    share: float = 0.8,
    *,
    durations: Any = None,
    constraints: Sequence[Linear] | Rules = (),
    tolerance: float = 1e-8,
    throw: bool = True,
) -> MinimumCommute:
    """Edge weights with the minimum average expected commute time, MAECT (Alam 2018, Eq. 4.4, 4.5).

    The weights `w` define a random walk that takes an edge with a probability in proportion to its
    weight. With `X` the pseudo-inverse of the weighted Laplacian, the commute times, averaged over
    pairs of different vertices, are `C = 4 / (n - 1) tr X`: twice the expression of Eq. 4.3, which
    is the average hitting time. `C` is convex in the weights.

    An interior-point method finds them, with one Cholesky factorisation of the edges by edges
    Hessian a step. That is dense linear algebra on arrays of hundreds, which LAPACK does on the
    host, with nothing to compile before; neither JAX nor its 64-bit numbers are needed. Compiled
    programs, [`jaxcell.optimize.minimum_commute_sweep`][], take the same steps for many problems at
    once, but seconds before the first one on each graph.

    On more than 2,000 vertices that Hessian is too large, and steps of first order are taken, with
    one inverse of the vertices by vertices Laplacian each.

    **Arguments:**

    - `graph`: a connected graph.
    - `emphasis`: vertices to be visited more often, two or more. The shortest closed tour through
        them is that of [`jaxcell.optimize.shortest_tour`][].
    - `share`: the least sum of the weights on the edges of that tour, 0 to 1.
    - `durations`: array `[edges]`, how long each edge takes, positive; by default 1. The commute
        time is then in their unit, and `share` one of the time. With `t_e` these durations, a walk
        there and back takes `sum_e w_e t_e` times as long as its steps, so that `w_e t_e` are the
        weights of the same problem with `b_e / sqrt(t_e)` in place of `b_e`.
    - `constraints`: linear ones; or, on up to 60 vertices, a function that gives any constraints of
        cvxpy that are convex in the weights and in the shares of time at the vertices, such as
        `lambda weights, visits: [cvxpy.norm(weights) <= 0.3]`. Not with durations.
    - `tolerance`: of the relative gap; on more than 2,000 vertices at least 0.01, and at least 1e-4
        with constraints of cvxpy.
    - `throw`: whether to raise when the answer is not good enough.

    **Returns:** [`MinimumCommute`][]. The residual of its certificate is the relative duality gap:
    no weights bring the average commute time below `(1 - residual) commute_time`. This is an
    A-optimal design, in which for any weights `u`, `C(u) >= C(w) tr X / sum_e u_e |X b_e|^2` with
    `b_e` the difference of the ends of edge `e` (Ghosh, Boyd and Saberi 2008). With constraints it
    is for all `u` that meet them, by prices of the constraints, or by a program of cvxpy.

    **Raises:** `ValueError` for a graph that is not connected, naming a vertex of each part; for an
    emphasis that is not two or more different vertices of the graph; for durations that are not
    positive; for a share that is not 0 to
    1, or that leaves nothing but rounding to vertices that are not on the tour.
    `RuntimeError` if the gap does not close, and if no weights meet the constraints, naming some
    that contradict each other.

    Of a line of three vertices both edges weigh the same; of the pairs, two take 4 steps there and
    back and one 8:

        >>> from jaxcell import optimize
        >>> graph = optimize.Graph([[0, 1], [1, 2]])
        >>> best = optimize.minimum_commute(graph)
        >>> best.weights.round(6).tolist(), round(best.commute_time, 6)
        ([0.5, 0.5], 5.333333)
    """
    if not 0 <= share <= 1:
        raise ValueError(f"share: expected 0 to 1, got {share}")
    if not tolerance > 0:
        raise ValueError(f"tolerance: expected a positive number, got {tolerance}")
    check_connected(graph.vertices, graph.edges)
    tour, emphasised = None, np.ones(len(graph.edges), bool)
    if emphasis is not None:
        try:
            tour = shortest_tour(graph, emphasis)
        except ValueError as error:
            raise ValueError(f"emphasis: {error}") from None
        emphasised = on_walk(graph, tour)
    if callable(constraints) or constraints:
        if durations is not None:
            raise ValueError("constraints: expected none where edges take time")
        if graph.vertices > MAX_VERTICES:
            raise ValueError(
                f"constraints: expected at most {MAX_VERTICES:,} vertices, got {graph.vertices:,}"
            )
        met = _constrained(graph, tour, emphasised, share, constraints, tolerance)
        met.certificate.check("minimum_commute", throw)
        return met
    # An edge that may have no weight is left out, and so is a bound that nothing can break.
    allowed = emphasised if share == 1 else np.ones_like(emphasised)
    if share == 1 and tour is not None:
        left_out = np.setdiff1d(np.arange(graph.vertices), tour)
        if left_out.size:
            raise ValueError(
                f"share is 1, but the tour leaves out vertex {left_out[0]}, which no walk would "
                "ever visit; expected less than 1"
            )
    edges, on_tour = graph.edges[allowed], emphasised[allowed]
    times = np.ones(len(graph.edges))
    if durations is not None:
        times = one_each("durations", durations, len(graph.edges), "an edge")
    times = times[allowed]
    bound = 0.0 if on_tour.all() else float(share)
    problem = Emphasis(on_tour, bound, np.ones_like(on_tour))
    laplacian = HostLaplacian(graph.vertices, edges, times)
    if graph.vertices > MAX_VERTICES:
        tolerance = max(tolerance, _COARSE)
        found, steps = least_resistance(laplacian, problem, tolerance, _INVERSIONS)
    else:
        try:
            found, steps = interior_point(laplacian, problem, tolerance)
        except np.linalg.LinAlgError:
            if not bound:
                raise
            raise ValueError(
                f"share is {share!r}: what it leaves to other edges is lost in rounding; expected "
                "less"
            ) from None
    numbers = found.numbers[: len(edges)] / times
    weights = np.zeros(len(graph.edges))
    weights[allowed] = numbers / numbers.sum()
    certificate = Certificate(int(steps), float(found.gap), tolerance)
    certificate.check("minimum_commute", throw)
    time = 4 * float(found.resistance) / (graph.vertices - 1)
    return MinimumCommute(weights, time, tour, certificate)


def _constrained(
    graph: Graph,
    tour: Int[np.ndarray, "steps"] | None,
    on_tour: Bool[np.ndarray, "edges"],
    share: float,
    constraints: Sequence[Linear] | Rules,
    tolerance: float,
) -> MinimumCommute:
    """The best weights that meet constraints, with the emphasis as one of them."""
    emphasis = [] if tour is None else [Linear("the emphasis", on_tour, lower=share)]
    if callable(constraints):
        best = conic.least_resistance(graph, emphasis, constraints)
        time = 4 * best.resistance / (graph.vertices - 1)
        certificate = Certificate(best.iterations, best.gap, max(tolerance, conic.TOLERANCE))
        return MinimumCommute(best.weights, time, tour, certificate)
    left = room(len(graph.edges), [*constraints, *emphasis])
    apart = vertices_apart(graph.vertices, graph.edges[left.used])
    if apart is not None:
        raise RuntimeError(
            f"constraints: they leave no weight to edges between vertex {apart[1]} and vertex "
            f"{apart[0][0]}"
        )
    laplacian = HostLaplacian(graph.vertices, graph.edges[left.used], np.ones(left.edges))
    found, steps = interior_point(laplacian, left, tolerance)
    weights = np.zeros(len(graph.edges))
    weights[left.used] = found.numbers[: left.edges]
    paid = np.abs(found.prices / left.units)[left.owner >= 0]
    prices = np.bincount(left.owner[left.owner >= 0], paid, len(constraints) + len(emphasis))
    return MinimumCommute(
        weights,
        4 / (graph.vertices - 1) * float(found.resistance),
        tour,
        Certificate(int(steps), float(found.gap), tolerance),
        4 / (graph.vertices - 1) * prices[: len(constraints)],
    )
