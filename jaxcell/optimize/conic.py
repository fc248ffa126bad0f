"""Least commute time under any convex constraints, by a cone program of cvxpy."""

import warnings
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import scipy.sparse
from jaxtyping import Float

from .constraints import Linear
from .graph import Graph
from .laplacian import resistance_gains


MAX_VERTICES = 60
"""Largest number of vertices of a cone program, which has a variable for each pair of a vertex and
an edge; up to this number it takes some seconds."""

TOLERANCE = 1e-4
"Tolerance of the relative gap of a cone program."

_ACCURATE = dict.fromkeys(("tol_gap_abs", "tol_gap_rel", "tol_feas"), 1e-12)

Rules: TypeAlias = Callable[[Any, Any], Sequence[Any]]
"""A function that returns constraints of cvxpy on its arguments, the weights of edges and the
shares of time at vertices."""


class ConicWeights(NamedTuple):
    """The weights with the least sum of resistances, and their accuracy."""

    weights: Float[np.ndarray, "edges"]
    resistance: float
    "The sum of resistances with these weights."
    least: float
    "The least sum according to the solver."
    gap: float
    "A bound on the relative excess of `resistance` over the least sum, by a linear program."
    iterations: int


def least_resistance(
    graph: Graph,
    constraints: Sequence[Linear],
    rules: Rules | None = None,
    *,
    durations: Float[np.ndarray, "edges"] | None = None,
) -> ConicWeights:
    """Find the weights with the least sum of resistances between all vertices, by Clarabel.

    The sum is the least energy `sum_e |F_e|^2 / w_e` of currents `F` that lead from each vertex
    evenly to all other vertices, through edges with conductances `w`. With durations `t`, `w` are
    shares of time and the energy is `sum_e t_e |F_e|^2 / w_e`.

    **Raises:** `ValueError` for rules that are not convex, or for rules on a graph that is too
    large; `RuntimeError` if no weights meet the constraints and rules.
    """
    import cvxpy

    vertices, edges = graph.vertices, len(graph.edges)
    times = np.ones(edges) if durations is None else durations
    if rules is not None and vertices > MAX_VERTICES:
        raise ValueError(
            f"constraints: rules of cvxpy are for up to {MAX_VERTICES} vertices, got {vertices}; "
            "expected linear constraints"
        )
    weights = cvxpy.Variable(edges, name="weights")
    visits = _incidence(graph, 1.0).T @ weights / 2
    bounds: list[Any] = [weights >= 0, cvxpy.sum(weights) == 1]
    for rule in constraints:
        bounds += [rule.coefficients @ weights >= rule.lower] if np.isfinite(rule.lower) else []
        bounds += [rule.coefficients @ weights <= rule.upper] if np.isfinite(rule.upper) else []
    bounds += [] if rules is None else list(rules(weights, visits))
    flow = cvxpy.Variable((vertices, edges))
    evenly = flow @ _incidence(graph, -1.0) == np.eye(vertices) - 1 / vertices
    energy = cvxpy.sum(
        [cvxpy.quad_over_lin(flow[:, e], weights[e]) * times[e] for e in range(edges)]
    )
    problem = cvxpy.Problem(cvxpy.Minimize(energy), [*bounds, evenly])
    if not problem.is_dcp():
        raise ValueError("constraints: expected rules that are convex by those of cvxpy")
    least = _solve(problem, [] if rules is None else bounds[2:])
    best = np.maximum(np.asarray(weights.value), 0)
    best /= best.sum()
    resistance, gain = resistance_gains(vertices, graph.edges, best / times)
    gain /= times
    steps = int(problem.solver_stats.num_iters or 0)
    most = cvxpy.Problem(cvxpy.Maximize(gain / gain.max() @ weights), bounds)
    gap = 1 - resistance / (gain.max() * _solve(most, []))
    return ConicWeights(best, resistance, least, max(0.0, gap), steps)


def _incidence(graph: Graph, other: float) -> scipy.sparse.csr_array:
    """Make the matrix with 1 at the first end of each edge, and `other` at the second end."""
    edge = np.repeat(np.arange(len(graph.edges)), 2)
    entries = np.tile([1.0, other], len(graph.edges)), (edge, graph.edges.ravel())
    return scipy.sparse.csr_array(entries, (len(graph.edges), graph.vertices))


def _solve(problem: Any, constraints: Sequence[Any]) -> float:
    """Solve a problem of cvxpy; the caller decides by a gap whether the result is accurate enough.

    **Raises:** `RuntimeError` if no variables meet the constraints; the message names those of the
    given constraints that contradict each other.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        problem.solve(solver="CLARABEL", **_ACCURATE)
    if problem.status not in ("optimal", "optimal_inaccurate"):
        named = ", ".join(map(str, _contradicting(problem, constraints)))
        because = f", because of {named}" if named else ""
        raise RuntimeError(
            f"constraints: no weights meet them{because} (Clarabel says {problem.status})"
        )
    return float(problem.value)


def _contradicting(problem: Any, constraints: Sequence[Any]) -> list[Any]:
    """Find a minimal set of constraints that contradict each other, given the other constraints."""
    import cvxpy

    named = {id(constraint) for constraint in constraints}
    always = [constraint for constraint in problem.constraints if id(constraint) not in named]
    kept = list(constraints)
    for constraint in constraints:
        without = [other for other in kept if other is not constraint]
        trial = cvxpy.Problem(cvxpy.Minimize(0), [*always, *without])
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            trial.solve(solver="CLARABEL")
        if trial.status in ("infeasible", "infeasible_inaccurate"):
            kept = without
    return kept
