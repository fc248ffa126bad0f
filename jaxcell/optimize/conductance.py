import contextlib
import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import scipy.linalg
from jaxtyping import Bool, Float, Int

from ..base.certificate import Certificate
from ..base.connected import check_connected
from ..base.limits import MAX_VERTICES
from ..base.threads import one_blas_thread
from .graph import Graph
from .interior_point import predictor_corrector
from .laplacian import pseudo_inverse
from .multiplicative import least_resistance
from .tour import on_walk, shortest_tour


_STEPS = 100
# A share that any weights have, to rounding.
_NOTHING = 1e-12
# With more edges, steps are computed in 32 bits, and by all cores.
_LARGE = 2000
# Below this, the distance from the central path is rounding.
_ROUNDING = 1e-16
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


def minimum_commute(
    graph: Graph,
    emphasis: Sequence[int] | None = None,
    share: float = 0.8,
    *,
    durations: Any = None,
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
    programs, [`jaxcell.optimize.minimum_commute_sweep`][], take the same steps, but seconds before
    the first one on each graph, and do not close the gap for a share of almost 1; the rows `walk
    with the least commute time` of the benchmarks are of this function.

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
    - `tolerance`: of the relative gap; on more than 2,000 vertices at least 0.01.
    - `throw`: whether to raise when the answer is not good enough.

    **Returns:** [`MinimumCommute`][]. The residual of its certificate is the relative duality gap:
    no weights bring the average commute time below `(1 - residual) commute_time`. This is an
    A-optimal design, in which for any weights `u`, `C(u) >= C(w) tr X / sum_e u_e |X b_e|^2` with
    `b_e` the difference of the ends of edge `e` (Ghosh, Boyd and Saberi 2008).

    **Raises:** `ValueError` for a graph that is not connected, naming a vertex of each part; for an
    emphasis that is not two or more different vertices of the graph; for durations that are not
    positive; for a share that is not 0 to
    1, or that leaves nothing but rounding to vertices that are not on the tour.
    `RuntimeError` if the gap does not close.

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
    times = _durations(graph, durations)[allowed]
    if graph.vertices > MAX_VERTICES:
        tolerance, bound = max(tolerance, _COARSE), 0.0 if on_tour.all() else share
        found, resistance, gap, iterations = least_resistance(
            graph.vertices, edges, times, on_tour, bound, tolerance, _INVERSIONS
        )
    else:
        problem = _Problem(graph.vertices, edges, times, [(np.ones_like(on_tour), 1.0)])
        with one_blas_thread() if len(edges) <= _LARGE else contextlib.nullcontext():
            if on_tour.all() or share <= _NOTHING:
                found, design, iterations = _interior_point(problem, tolerance)
                gap = _gap(design, problem.blocks)
            else:
                found, design, gap, iterations = _with_bound(problem, on_tour, share, tolerance)
        resistance = design.resistance
    weights = np.zeros(len(graph.edges))
    weights[allowed] = found / times / (found / times).sum()
    certificate = Certificate(iterations, gap, tolerance)
    certificate.check("minimum_commute", throw)
    return MinimumCommute(weights, 4 * resistance / (graph.vertices - 1), tour, certificate)


def _durations(graph: Graph, given: Any) -> Float[np.ndarray, "edges"]:
    times = np.ones(len(graph.edges)) if given is None else np.array(given, np.float64)
    if times.shape != (len(graph.edges),):
        raise ValueError(
            f"durations: expected {len(graph.edges)} numbers, one an edge, got {list(times.shape)}"
        )
    wrong = np.flatnonzero(~((times > 0) & np.isfinite(times)))
    if wrong.size:
        raise ValueError(
            f"durations[{wrong[0]}] is {times[wrong[0]]}; expected a positive finite number"
        )
    return times


@dataclasses.dataclass(frozen=True, eq=False)
class _Problem:
    """The least resistance with given sums of the weights on disjoint blocks of edges."""

    vertices: int
    edges: Int[np.ndarray, "edges 2"]
    durations: Float[np.ndarray, "edges"]
    blocks: list[tuple[Bool[np.ndarray, "edges"], float]]

    def scaled(self, weights: Float[np.ndarray, "edges"]) -> Float[np.ndarray, "edges"]:
        """The weights with the right sums."""
        weights = weights.copy()
        for block, total in self.blocks:
            weights[block] *= total / weights[block].sum()
        return weights

    def start(self) -> Float[np.ndarray, "edges"]:
        """Weights from which to start: even, then moved in proportion to the root of the gain.

        In a tree, one move is enough.
        """
        weights = self.scaled(np.ones(len(self.edges)))
        for _ in range(2):
            weights = self.scaled(weights * np.sqrt(_Design(self, weights).gain))
        return weights


class _Design:
    """The sum of the reciprocal eigenvalues of the Laplacian, and its derivatives."""

    def __init__(self, problem: _Problem, weights: Float[np.ndarray, "edges"]) -> None:
        self.tail, self.head = problem.edges.T
        self.root = np.sqrt(problem.durations)[:, None]
        inverse = pseudo_inverse(problem.vertices, problem.edges, weights / problem.durations)
        self.resistance = float(np.trace(inverse))
        self.columns = (inverse[self.tail] - inverse[self.head]) / self.root
        self.gain = np.einsum("en,en->e", self.columns, self.columns)

    def hessian(self, kind: type[np.floating]) -> Float[np.ndarray, "edges edges"]:
        columns = self.columns.astype(kind)
        rows = np.ascontiguousarray(columns.T)
        matrix = rows[self.tail]
        matrix -= rows[self.head]
        matrix /= self.root.astype(kind)
        matrix *= columns @ columns.T
        matrix *= kind(2)
        return matrix


def _with_bound(
    free: _Problem, on_tour: Bool[np.ndarray, "edges"], share: float, tolerance: float
) -> tuple[Float[np.ndarray, "edges"], _Design, float, int]:
    """Where the bound on the share matters it is tight, because the problem is convex.

    **Returns:** the weights, their design, the gap, and the number of steps taken.
    """
    everything = np.ones_like(on_tour)
    tight = dataclasses.replace(free, blocks=[(on_tour, share), (~on_tour, 1 - share)])
    try:
        found, design, steps = _interior_point(tight, tolerance)
    except np.linalg.LinAlgError:
        gap, steps = math.inf, 0
    else:
        gap = _gap(design, [(on_tour, share), (everything, 1 - share)])
        if gap <= tolerance:
            return found, design, gap, steps
    unbound, without, more = _interior_point(free, tolerance)
    if unbound[on_tour].sum() >= share:
        return unbound, without, _gap(without, free.blocks), steps + more
    if gap == math.inf:
        raise ValueError(
            f"share is {share!r}: what it leaves to other edges is lost in rounding; expected less"
        )
    return found, design, gap, steps + more


def _gap(design: _Design, bound: list[tuple[Bool[np.ndarray, "edges"], float]]) -> float:
    """By how much of itself the resistance can be above the least one.

    The resistance is convex and homogeneous of degree -1, so its reciprocal is concave, and the
    tangent of that at the design bounds it everywhere. The tangent is largest where each share of
    the weight is on the edge that gains most, of those that it may be on.
    """
    most = sum(share * float(design.gain[among].max()) for among, share in bound)
    return max(0.0, 1 - design.resistance / most)


def _interior_point(
    problem: _Problem, tolerance: float
) -> tuple[Float[np.ndarray, "edges"], _Design, int]:
    """Follow the central path with Mehrotra's predictor and corrector.

    **Returns:** the weights with the smallest gap, their design, and the number of steps taken.
    """
    weights = problem.start()
    design = _Design(problem, weights)
    unit = design.resistance
    # Pressures that keep weights positive, with which the design is stationary from the start.
    prices = np.array([1.2 * design.gain[block].max() / unit for block, _ in problem.blocks])
    sums = np.stack([block for block, _ in problem.blocks], axis=1).astype(np.float64)
    totals = np.array([total for _, total in problem.blocks])
    live = np.ones(len(weights), bool)
    pressure = sums @ prices - design.gain / unit
    best, gap = (weights, design), _gap(design, problem.blocks)
    steps = 0
    while gap > tolerance / 2 and steps < _STEPS and weights @ pressure > _ROUNDING:
        try:
            inverse, point = _inverse(design, unit, pressure / weights), (weights, pressure, prices)
            weights, pressure, prices = predictor_corrector(
                inverse, design.gain / unit, sums, totals, live, point
            )
            weights = problem.scaled(weights)
            design = _Design(problem, weights)
        except np.linalg.LinAlgError:
            break
        steps += 1
        found = _gap(design, problem.blocks)
        if found < gap:
            best, gap = (weights, design), found
    return *best, steps


def _inverse(
    design: _Design, unit: float, stiffness: Float[np.ndarray, "edges"]
) -> Callable[[Float[np.ndarray, "edges *sides"]], Float[np.ndarray, "edges *sides"]]:
    """Divide by the Hessian with a stiffness on its diagonal.

    A large one is factorised in 32 bits, in half the time and memory: a step that is off by a part
    in a thousand is as good, because the next one starts from residuals in 64 bits.

    **Raises:** `numpy.linalg.LinAlgError` if it is singular to rounding.
    """
    kinds: list[type[np.floating]] = [np.float32, np.float64]
    for kind in kinds if stiffness.size > _LARGE else kinds[1:]:
        potrf, potrs = scipy.linalg.get_lapack_funcs(("potrf", "potrs"), dtype=kind)
        matrix = design.hessian(kind)
        matrix /= kind(unit)
        matrix[np.diag_indices_from(matrix)] += stiffness.astype(kind)
        # The transpose of a symmetric matrix is in the order that LAPACK overwrites.
        factor, info = potrf(matrix.T, lower=1, clean=0, overwrite_a=1)
        if info == 0:
            return lambda sides: potrs(factor, sides.astype(kind), lower=1)[0].astype(np.float64)
    raise np.linalg.LinAlgError("the Hessian is singular to rounding")
