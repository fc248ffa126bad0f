"""The least sum of resistances between vertices, by an interior-point method on the host."""

import contextlib
import dataclasses
from collections.abc import Callable

import numpy as np
import scipy.linalg
from jaxtyping import Bool, Float, Int

from ..base.threads import one_blas_thread
from .constraints import Room
from .graph import Graph
from .interior_point import predictor_corrector
from .laplacian import pseudo_inverse


_STEPS = 100
# With more edges, steps are computed in 32 bits, and by all cores.
_LARGE = 2000
# Below this, the distance from the central path is rounding.
_ROUNDING = 1e-16


@dataclasses.dataclass(frozen=True, eq=False)
class Found:
    """Where the interior point has the smallest gap."""

    numbers: Float[np.ndarray, "numbers"]
    "The weights, and what inequalities have to spare."
    prices: Float[np.ndarray, "prices"]
    design: "Design"
    gap: float
    steps: int

    def commute_time(self, graph: Graph) -> float:
        return 4 * self.design.resistance / (graph.vertices - 1)


@dataclasses.dataclass(frozen=True, eq=False)
class Blocks:
    """The least resistance with given sums of the weights on disjoint blocks of edges."""

    vertices: int
    edges: Int[np.ndarray, "edges 2"]
    blocks: list[tuple[Bool[np.ndarray, "edges"], float]]
    durations: Float[np.ndarray, "edges"]
    "How long each edge takes; weights are shares of time."

    @property
    def sums(self) -> Float[np.ndarray, "edges prices"]:
        return np.stack([block for block, _ in self.blocks], axis=1).astype(np.float64)

    @property
    def totals(self) -> Float[np.ndarray, "prices"]:
        return np.array([total for _, total in self.blocks])

    def prices(
        self, gain: Float[np.ndarray, "edges"], weights: Float[np.ndarray, "edges"]
    ) -> Float[np.ndarray, "prices"]:
        """Prices that leave a pressure on each weight that keeps it positive."""
        return np.array([1.2 * gain[block].max() for block, _ in self.blocks])

    def gap(self, design: "Design", prices: Float[np.ndarray, "prices"]) -> float:
        return block_gap(design, self.blocks)

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
            weights = self.scaled(weights * np.sqrt(Design(self, weights).gain))
        return weights


@dataclasses.dataclass(frozen=True, eq=False)
class Bounded:
    """The least resistance in the room that constraints leave."""

    vertices: int
    edges: Int[np.ndarray, "edges 2"]
    room: Room

    @property
    def durations(self) -> Float[np.ndarray, "edges"]:
        return np.ones(len(self.edges))

    @property
    def sums(self) -> Float[np.ndarray, "numbers prices"]:
        return self.room.sums

    @property
    def totals(self) -> Float[np.ndarray, "prices"]:
        return self.room.totals

    def start(self) -> Float[np.ndarray, "numbers"]:
        return self.room.inside

    def scaled(self, numbers: Float[np.ndarray, "numbers"]) -> Float[np.ndarray, "numbers"]:
        return numbers

    def prices(
        self, gain: Float[np.ndarray, "numbers"], numbers: Float[np.ndarray, "numbers"]
    ) -> Float[np.ndarray, "prices"]:
        """Prices that leave a pressure on each number that keeps it positive."""
        edges, prices = self.room.edges, np.zeros(self.totals.size)
        spare = self.room.signs != 0
        prices[spare] = -self.room.signs[spare] / (edges * numbers[edges:])
        prices[0] = 1.2 * np.abs(gain[:edges] - self.sums[:edges] @ prices).max()
        return prices

    def gap(self, design: "Design", prices: Float[np.ndarray, "prices"]) -> float:
        return max(0.0, 1 - design.resistance / self.room.most(design.gain, prices))


class Design:
    """The sum of the reciprocal eigenvalues of the Laplacian, and its derivatives."""

    def __init__(self, problem: Blocks | Bounded, weights: Float[np.ndarray, "edges"]) -> None:
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


def block_gap(design: Design, bound: list[tuple[Bool[np.ndarray, "edges"], float]]) -> float:
    """By how much of itself the resistance can be above the least one.

    The resistance is convex and homogeneous of degree -1, so its reciprocal is concave, and the
    tangent of that at the design bounds it everywhere. The tangent is largest where each share of
    the weight is on the edge that gains most, of those that it may be on.
    """
    most = sum(share * float(design.gain[among].max()) for among, share in bound)
    return max(0.0, 1 - design.resistance / most)


def interior_point(problem: Blocks | Bounded, tolerance: float) -> Found:
    """Follow the central path with Mehrotra's predictor and corrector."""
    with one_blas_thread() if len(problem.edges) <= _LARGE else contextlib.nullcontext():
        return _follow(problem, tolerance)


def _follow(problem: Blocks | Bounded, tolerance: float) -> Found:
    numbers = problem.start()
    edges = len(problem.edges)
    design = Design(problem, numbers[:edges])
    unit = design.resistance

    def gain(design: Design) -> Float[np.ndarray, "numbers"]:
        return np.append(design.gain / unit, np.zeros(numbers.size - edges))

    # Pressures that keep numbers positive, with which the design is stationary from the start.
    prices = problem.prices(gain(design), numbers)
    sums, totals, live = problem.sums, problem.totals, np.ones(numbers.size, bool)
    pressure = sums @ prices - gain(design)
    best = Found(numbers, unit * prices, design, problem.gap(design, unit * prices), 0)
    for steps in range(1, _STEPS + 1):
        if best.gap <= tolerance / 2 or numbers @ pressure <= _ROUNDING:
            break
        try:
            inverse, point = _inverse(design, unit, pressure / numbers), (numbers, pressure, prices)
            numbers, pressure, prices = predictor_corrector(
                inverse, gain(design), sums, totals, live, point
            )
            numbers = problem.scaled(numbers)
            design = Design(problem, numbers[:edges])
        except np.linalg.LinAlgError:
            break
        gap = problem.gap(design, unit * prices)
        best = dataclasses.replace(best, steps=steps)
        if gap < best.gap:
            best = Found(numbers, unit * prices, design, gap, steps)
    return best


def _inverse(
    design: Design, unit: float, stiffness: Float[np.ndarray, "numbers"]
) -> Callable[[Float[np.ndarray, "numbers *sides"]], Float[np.ndarray, "numbers *sides"]]:
    """Divide by the Hessian with a stiffness on its diagonal, which is all there is off the edges.

    A large one is factorised in 32 bits, in half the time and memory: a step that is off by a part
    in a thousand is as good, because the next one starts from residuals in 64 bits.

    **Raises:** `numpy.linalg.LinAlgError` if it is singular to rounding.
    """
    edges = design.gain.size
    kinds: list[type[np.floating]] = [np.float32, np.float64]
    for kind in kinds if edges > _LARGE else kinds[1:]:
        potrf, potrs = scipy.linalg.get_lapack_funcs(("potrf", "potrs"), dtype=kind)
        matrix = design.hessian(kind)
        matrix /= kind(unit)
        matrix[np.diag_indices_from(matrix)] += stiffness[:edges].astype(kind)
        # The transpose of a symmetric matrix is in the order that LAPACK overwrites.
        factor, info = potrf(matrix.T, lower=1, clean=0, overwrite_a=1)
        if info == 0:
            break
    else:
        raise np.linalg.LinAlgError("the Hessian is singular to rounding")

    def divide(sides: Float[np.ndarray, "numbers *sides"]) -> Float[np.ndarray, "numbers *sides"]:
        on_edges = potrs(factor, sides[:edges].astype(factor.dtype), lower=1)[0]
        beside = (sides[edges:].T / stiffness[edges:]).T
        return np.concatenate([on_edges.astype(np.float64), beside])

    return divide
