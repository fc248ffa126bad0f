import warnings
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy.sparse
from jaxtyping import Float

from ..base.optional_modules import import_module
from .constraints import Linear
from .graph import Graph


_ACCURATE = dict.fromkeys(("tol_gap_abs", "tol_gap_rel", "tol_feas"), 1e-12)


class ConicWeights(NamedTuple):
    """The weights of edges with the least sum of resistances between the vertices."""

    weights: Float[np.ndarray, "edges"]
    least: float
    "The least sum of resistances, as the solver returns it."


def least_resistance(
    graph: Graph, constraints: Sequence[Linear], durations: Float[np.ndarray, "edges"] | None = None
) -> ConicWeights:
    """Find the weights with the least sum of resistances under constraints, with Clarabel.

    The sum is the least energy `sum_e |F_e|^2 / w_e` of currents `F` through edges with
    conductances `w`: one from each vertex, which leaves at all other vertices in equal parts. With
    durations `t`, `w` are shares of time and the energy is `sum_e t_e |F_e|^2 / w_e`.
    """
    # Imported here because only `--verify` needs cvxpy, which takes a second.
    cvxpy = import_module("cvxpy")

    vertices, edges = graph.vertices, len(graph.edges)
    times = np.ones(edges) if durations is None else durations
    weights = cvxpy.Variable(edges, nonneg=True)
    bounds = [cvxpy.sum(weights) == 1]
    for rule in constraints:
        bounds += [rule.coefficients @ weights >= rule.lower] if np.isfinite(rule.lower) else []
        bounds += [rule.coefficients @ weights <= rule.upper] if np.isfinite(rule.upper) else []
    entries = np.tile([1.0, -1.0], edges), (np.repeat(np.arange(edges), 2), graph.edges.ravel())
    incidence = scipy.sparse.csr_array(entries, (edges, vertices))
    flow = cvxpy.Variable((vertices, edges))
    evenly = flow @ incidence == np.eye(vertices) - 1 / vertices
    energy = cvxpy.sum(
        [cvxpy.quad_over_lin(flow[:, e], weights[e]) * times[e] for e in range(edges)]
    )
    problem = cvxpy.Problem(cvxpy.Minimize(energy), [*bounds, evenly])
    with warnings.catch_warnings():
        # The caller compares the result, so that its inaccuracy needs no warning.
        warnings.simplefilter("ignore")
        least = problem.solve(solver="CLARABEL", **_ACCURATE)
    return ConicWeights(np.asarray(weights.value), float(least))
