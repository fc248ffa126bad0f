import dataclasses
from typing import Any

import numpy as np
import scipy.sparse
from jaxtyping import Float

from ..base.certificate import Certificate
from ..base.connected import check_connected
from ..base.process import one_blas_thread
from ..mapping import Chain
from .checked import shares_of_time
from .graph import Graph
from .spectral import SpectralProblem, least_norm


@dataclasses.dataclass(frozen=True, eq=False)
class FastestMixing:
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


@dataclasses.dataclass(frozen=True, eq=False)
class FastestAveraging:
    """The weights with which averaging between neighbours converges fastest."""

    weights: Float[np.ndarray, "edges"]
    "The weight of each edge, of either sign."
    matrix: Float[np.ndarray, "vertices vertices"]
    "The matrix of a round of averaging: the identity minus the weighted Laplacian."
    rate: float
    "The factor by which a round shrinks the distance from the average, in the worst case."
    certificate: Certificate


def fastest_mixing(
    graph: Graph, stationary: Any = None, *, tolerance: float = 1e-7, throw: bool = True
) -> FastestMixing:
    """Find the fastest mixing Markov chain on a graph, FMMC (Boyd, Diaconis and Xiao 2004).

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
    spectral gap can exceed `1 - rate`, relative to `1 - rate`. It comes from a dual solution: no
    chain has a rate below `tr Y - sqrt(pi)' Y sqrt(pi) - pi' z`, for a symmetric `Y` whose
    eigenvalues have moduli with sum 1, and `z >= 0` with `z_i + z_j >= s' Y s` for each edge, where
    `s = e_i / sqrt(pi_i) - e_j / sqrt(pi_j)`.

    **Raises:** `ValueError` for a graph that is not connected, or for a wrong `stationary`;
    `RuntimeError` if the residual stays above the tolerance.

    A line of three vertices; at its ends the chain stays half of the time:

        >>> from jaxcell import optimize
        >>> graph = optimize.Graph([[0, 1], [1, 2]])
        >>> best = optimize.fastest_mixing(graph)
        >>> best.transition.round(4).tolist(), round(best.rate, 4)
        ([[0.5, 0.5, 0.0], [0.5, 0.0, 0.5], [0.0, 0.5, 0.5]], 0.5)
    """
    stationary = (
        np.full(graph.vertices, 1 / graph.vertices)
        if stationary is None
        else shares_of_time(stationary, graph.vertices)
    )
    # Weights are not negative, and their sum at a vertex is at most its share of time.
    edges = len(graph.edges)
    ends = (np.ones(2 * edges), (graph.edges.ravel(), np.repeat(np.arange(edges), 2)))
    at = scipy.sparse.csr_array(ends, shape=(graph.vertices, edges))
    bounds = scipy.sparse.vstack([-scipy.sparse.eye_array(edges), at], format="csr")
    limits = np.append(np.zeros(edges), stationary)
    weights, rate, certificate = _fastest(graph, stationary, bounds, limits, tolerance)
    certificate.check("fastest_mixing", throw)
    flow = graph.matrix(weights).toarray()
    holding = np.maximum(0, stationary - flow.sum(axis=0))
    transition = (flow + np.diag(holding)) / stationary[:, None]
    return FastestMixing(weights, holding, transition, rate, certificate)


def fastest_averaging(
    graph: Graph, *, tolerance: float = 1e-7, throw: bool = True
) -> FastestAveraging:
    """Find the fastest distributed linear averaging on a graph, FDLA (Xiao and Boyd 2004).

    In each round, each vertex replaces its number by `x_i + sum_j w_ij (x_j - x_i)`, with the sum
    over its neighbours. The numbers converge to their average, and with these weights they converge
    fastest. The problem is the same as for [`fastest_mixing`][], but weights may be negative, so
    that they define no chain.

    **Arguments:**

    - `graph`: a connected graph.
    - `tolerance`: tolerance of the relative gap.
    - `throw`: whether to raise `RuntimeError` if the residual exceeds the tolerance.

    **Returns:** [`FastestAveraging`][]. The residual of its certificate bounds the relative
    distance of `1 - rate` from its maximum.

    **Raises:** `ValueError` for a graph that is not connected; `RuntimeError` for a large residual.

    A line of three vertices:

        >>> from jaxcell import optimize
        >>> graph = optimize.Graph([[0, 1], [1, 2]])
        >>> best = optimize.fastest_averaging(graph)
        >>> best.weights.round(4).tolist(), round(best.rate, 4)
        ([0.5, 0.5], 0.5)
    """
    n = graph.vertices
    even = np.full(n, 1 / n)
    nothing = scipy.sparse.csr_array((0, len(graph.edges)), dtype=np.float64)
    weights, rate, certificate = _fastest(graph, even, nothing, np.zeros(0), tolerance)
    certificate.check("fastest_averaging", throw)
    weights = n * weights
    off = graph.matrix(weights).toarray()
    matrix = np.eye(n) + off - np.diag(off.sum(axis=0))
    return FastestAveraging(weights, matrix, rate, certificate)


def _fastest(
    graph: Graph,
    stationary: Float[np.ndarray, "vertices"],
    bounds: scipy.sparse.csr_array,
    limits: Float[np.ndarray, "bounds"],
    tolerance: float,
) -> tuple[Float[np.ndarray, "edges"], float, Certificate]:
    """Solve from a start inside the bounds, with steps that stay in at least half of the time."""
    if not tolerance > 0:
        raise ValueError(f"tolerance: expected a positive number, got {tolerance}")
    check_connected(graph.vertices, graph.edges)
    problem = SpectralProblem(graph.edges, np.sqrt(stationary), bounds, limits)
    degree = np.bincount(graph.edges.ravel(), minlength=graph.vertices)
    start = (stationary / (2 * degree))[graph.edges].min(axis=1)
    with one_blas_thread():
        weights, rate, bound, steps = least_norm(problem, start, tolerance)
    gap = max(0.0, (rate - bound) / (1 - rate))
    return weights, rate, Certificate(steps, gap, tolerance)
