import dataclasses
from typing import Any

import numpy as np
import scipy.sparse
from jaxtyping import Float

from ..base.certificate import Certificate
from ..base.connected import check_connected
from ..base.process import one_blas_thread
from ..base.shown import Shown
from ..mapping import Chain
from .graph import GraphLike
from .spectral import SpectralProblem, least_norm
from .validation import distribution


@dataclasses.dataclass(frozen=True, eq=False)
class FastestMixing(Shown):
    """The reversible chain on a graph that converges fastest to its stationary distribution."""

    weights: Float[np.ndarray, "edges"]
    "The long-run share of steps along each edge in one direction: `pi_i p_ij = pi_j p_ji`."
    holding: Float[np.ndarray, "vertices"]
    "The long-run share of steps that stay at each vertex: `pi_i p_ii`."
    transition: Float[np.ndarray, "vertices vertices"]
    "The probability `p_ij` of a step from the first vertex to the second."
    rate: float
    "The second largest modulus of an eigenvalue of `transition`."
    certificate: Certificate

    @property
    def chain(self) -> Chain:
        """The chain of a patroller, [`jaxcell.mapping.Chain`][], whose cells are the vertices."""
        return Chain.from_scipy(self.transition)


def fastest_mixing(
    graph: GraphLike, stationary: Any = None, *, tolerance: float = 1e-7, throw: bool = True
) -> FastestMixing:
    """Find the fastest mixing Markov chain on a graph, FMMC (Boyd, Diaconis and Xiao 2004).

    It runs on the host, because the steps of its solver in SciPy depend on the values.

    Among the reversible chains that step along edges or stay, and that have a given stationary
    distribution, this chain has the least second largest eigenvalue modulus. An interior-point
    method solves the semidefinite program.

    **Arguments:**

    - `graph`: a connected graph.
    - `stationary`: array `[vertices]`, the share of the time to spend at each vertex, positive and
        with sum 1; by default uniform.
    - `tolerance`: tolerance of the relative gap.
    - `throw`: whether to raise `RuntimeError` if the residual exceeds the tolerance.

    **Returns:** [`FastestMixing`][]. The residual of its certificate bounds by how much the largest
    spectral gap can exceed `1 - rate`, relative to `1 - rate`. It comes from a dual solution.

    A line of three vertices; at its ends the chain stays half of the time:

        >>> from jaxcell import optimize
        >>> graph = optimize.Graph([[0, 1], [1, 2]])
        >>> best = optimize.fastest_mixing(graph)
        >>> best.transition.round(4).tolist(), round(best.rate, 4)
        ([[0.5, 0.5, 0.0], [0.5, 0.0, 0.5], [0.0, 0.5, 0.5]], 0.5)
    """
    if not tolerance > 0:
        raise ValueError(f"tolerance: expected a positive number, got {tolerance}")
    check_connected(graph.vertices, graph.edges)
    share = np.full(graph.vertices, 1 / graph.vertices)
    if stationary is not None:
        share = distribution("stationary", stationary, graph.vertices, "per vertex")
    # Weights are not negative, and their sum at a vertex is at most its share of time.
    edges = len(graph.edges)
    ends = (np.ones(2 * edges), (graph.edges.ravel(), np.repeat(np.arange(edges), 2)))
    at = scipy.sparse.csr_array(ends, shape=(graph.vertices, edges))
    bounds = scipy.sparse.vstack([-scipy.sparse.eye_array(edges), at], format="csr")
    limits = np.append(np.zeros(edges), share)
    problem = SpectralProblem(graph.edges, np.sqrt(share), bounds, limits)
    # The start uses at most half of the time at each vertex, so that it is inside the bounds.
    degree = np.bincount(graph.edges.ravel(), minlength=graph.vertices)
    start = (share / (2 * degree))[graph.edges].min(axis=1)
    with one_blas_thread():
        weights, rate, bound, steps = least_norm(problem, start, tolerance)
    certificate = Certificate(steps, max(0.0, (rate - bound) / (1 - rate)), tolerance)
    certificate.check("fastest_mixing", throw)
    flow = graph.matrix(weights).toarray()
    holding = np.maximum(0, share - flow.sum(axis=0))
    transition = (flow + np.diag(holding)) / share[:, None]
    return FastestMixing(weights, holding, transition, rate, certificate)
