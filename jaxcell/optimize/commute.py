import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from ..base.certificate import Certificate
from ..base.connected import check_connected, vertices_apart
from ..base.limits import MAX_VERTICES
from ..base.shown import Pictured
from .constraints import Linear, Room, room
from .graph import Graph, GraphLike
from .multiplicative import least_resistance
from .resistance import Emphasis, Laplacian, interior_point
from .tour import on_walk, shortest_tour
from .validation import one_each


# Least tolerance of the gap of the first-order method, on large graphs.
_COARSE = 1e-2


@dataclasses.dataclass(frozen=True, eq=False)
class MinimumCommute(Pictured):
    """The weights of edges for which a random walk has the least mean commute time."""

    weights: Float[np.ndarray, "edges"]
    "The weight of each edge. Weights are not negative and sum to 1."
    commute_time: float
    "The mean commute time over pairs of vertices, in steps or in the unit of the durations."
    tour: Int[np.ndarray, "steps"] | None
    "The vertices of the closed walk whose edges are emphasised, in order, or `None`."
    certificate: Certificate
    prices: Float[np.ndarray, "constraints"] | None = None
    "Shadow price of each linear constraint: the decrease of the time per unit of relaxation."


def minimum_commute(
    graph: GraphLike,
    emphasis: Sequence[int] | None = None,
    share: float = 0.8,
    *,
    durations: Any = None,
    constraints: Sequence[Linear] = (),
    tolerance: float = 1e-8,
    throw: bool = True,
) -> MinimumCommute:
    """Find edge weights with minimum average expected commute time, MAECT.

    It runs on the host, because the steps of its solver in SciPy depend on the values.

    See Alam 2018, Eq. 4.4 and 4.5. The weights `w` define a random walk that takes an edge with a
    probability in proportion to its weight. With `X` the pseudo-inverse of the weighted Laplacian,
    the mean commute time over pairs of different vertices is `C = 4 / (n - 1) tr X`, convex in `w`.

    An interior-point method computes the weights, with one Cholesky factorisation of the Hessian,
    `[edges, edges]`, per step. On more than 2,000 vertices the Hessian is too large. A first-order
    method then computes the weights, with one inverse of the Laplacian per step.

    **Arguments:**

    - `graph`: a connected graph.
    - `emphasis`: two or more vertices to visit more often. The closed tour through these vertices
        is [`jaxcell.optimize.shortest_tour`][].
    - `share`: the least sum of the weights on the edges of the tour, from 0 to 1.
    - `durations`: array `[edges]`, the travel time of each edge, positive; by default 1. With
        durations, the commute time is in their unit, and `share` is a share of the time.
    - `constraints`: linear constraints, only without `durations` and on at most 2,000 vertices.
    - `tolerance`: tolerance of the relative gap; on more than 2,000 vertices at least 0.01.
    - `throw`: whether to raise `RuntimeError` if the residual exceeds the tolerance.

    **Returns:** [`MinimumCommute`][]. The residual of its certificate is the relative duality gap:
    no weights that meet the constraints have an average commute time below `(1 - residual)
    commute_time`. Without constraints, all weights `u` satisfy `C(u) >= C(w) tr X / sum_e u_e |X
    b_e|^2`, with `b_e = e_i - e_j` for an edge from `i` to `j` (Ghosh, Boyd and Saberi 2008).

    On a line of three vertices both edges have the same weight. The commute time is 4 steps for two
    pairs of vertices, and 8 steps for the third pair:

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
    if constraints:
        if durations is not None:
            raise ValueError("constraints: expected none with durations")
        if graph.vertices > MAX_VERTICES:
            raise ValueError(
                f"constraints: expected at most {MAX_VERTICES:,} vertices, got {graph.vertices:,}"
            )
    times = np.ones(len(graph.edges))
    if durations is not None:
        times = one_each("durations", durations, len(graph.edges), "per edge")
    problem: Room | Emphasis
    if constraints:
        problem = _room(graph, tour, emphasised, share, constraints)
        used = problem.used
    else:
        # Edges that must have weight 0 are left out, and so is a bound that is always met.
        used = emphasised if share == 1 else np.ones_like(emphasised)
        on_tour = emphasised[used]
        problem = Emphasis(on_tour, 0.0 if on_tour.all() else float(share))
        left_out = np.setdiff1d(np.arange(graph.vertices), graph.edges[used])
        if left_out.size:
            raise ValueError(
                f"share is 1, but the tour leaves out vertex {left_out[0]}, which no walk would "
                "ever visit; expected less than 1"
            )
    laplacian = Laplacian(graph.vertices, graph.edges[used], times[used])
    if isinstance(problem, Emphasis) and graph.vertices > MAX_VERTICES:
        tolerance = max(tolerance, _COARSE)
        best, steps = least_resistance(laplacian, problem, tolerance)
    else:
        try:
            best, steps = interior_point(laplacian, problem, tolerance)
        except np.linalg.LinAlgError:
            if isinstance(problem, Room) or not problem.share:
                raise
            raise ValueError(
                f"share is {share!r}: the rest for other edges is lost in rounding; expected less"
            ) from None
    certificate = Certificate(int(steps), float(best.gap), tolerance)
    certificate.check("minimum_commute", throw)
    numbers = best.numbers[: used.sum()] / times[used]
    weights = np.zeros(len(graph.edges))
    weights[used] = numbers / numbers.sum()
    per_resistance = 4 / (graph.vertices - 1)
    prices = None
    if isinstance(problem, Room) and best.prices is not None:
        prices = per_resistance * problem.prices_of(best.prices, len(constraints))
    return MinimumCommute(weights, per_resistance * best.resistance, tour, certificate, prices)


def _room(
    graph: Graph,
    tour: Int[np.ndarray, "steps"] | None,
    on_tour: Bool[np.ndarray, "edges"],
    share: float,
    constraints: Sequence[Linear],
) -> Room:
    """Find the set of weights that constraints allow, with at least `share` on the tour."""
    emphasis = [] if tour is None else [Linear("the emphasis", on_tour, lower=share)]
    left = room(len(graph.edges), [*constraints, *emphasis])
    apart = vertices_apart(graph.vertices, graph.edges[left.used])
    if apart is not None:
        raise RuntimeError(
            f"constraints: they leave no weight for edges between vertex {apart[1]} and vertex "
            f"{apart[0][0]}"
        )
    return left
