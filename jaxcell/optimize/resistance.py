"""Least sum of resistances between the vertices of a graph, by an interior-point method.

**The problem.** With `X` the pseudo-inverse of the weighted Laplacian `sum_e w_e b_e b_e' / t_e` of
edges with weights `w` and durations `t`, `b_e` the difference of the ends of edge `e`:

    minimise R(w) = tr X     over numbers x >= 0 with sums' x = totals,

where `x` are the weights, which sum to 1, followed by the slack of inequalities. With `c_e = X b_e
/ sqrt(t_e)` the derivatives are

    -dR/dw_e = |c_e|^2, the gain of an edge,     d2R/dw_e dw_f = 2 (c_e' c_f)(c_e' b_f) / sqrt(t_f).

**The method.** At the optimum there are prices with `gain + pressure = sums prices`, where the
pressure is not negative, and 0 at each positive number. Mehrotra's predictor-corrector steps
approach it from the interior, with one Cholesky factor of the Hessian each.

**The bound.** `R` is convex and homogeneous of degree -1, so its reciprocal is concave, and the
tangent at `w` bounds it everywhere: no weights have a sum below `R(w)^2 / most`, with `most` the
largest `gain @ u` over all weights `u`. This is the certificate, and ends the steps.

Formulas and steps work on arrays of NumPy or of JAX: [`interior_point`][] runs on the host,
[`jaxcell.optimize.commute_weights`][] in compiled programs.
"""

import contextlib
import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import scipy.linalg
from jaxtyping import Float, Int

from ..base.threads import one_blas_thread
from .constraints import Room
from .laplacian import pseudo_inverse


_STEPS = 100
# Above this number of edges, steps are computed in 32 bits and on all cores.
_LARGE = 2000
# Number of rows of the Hessian that are computed at once, within the cache.
_ROWS = 64
# Below this, the distance from the central path is rounding.
_ROUNDING = 1e-16
# Share of the distance to the nearest bound that a step takes, so that numbers stay positive.
_SHORT_OF_THE_BOUND = 0.99
# Share of the weights beyond the emphasis that the tour has in addition at the start.
_SPARE = 0.1


class Emphasis(NamedTuple):
    """The set of weights with at least a share on the edges of a tour.

    The excess of the tour over its share is one more number, so that steps find whether the bound
    is tight. The two sums are the sum of all weights, and the sum of the weights elsewhere and the
    excess: the sum on the tour would lose the small rest that a share of almost 1 leaves.
    """

    on_tour: Any
    "Boolean array `[edges]`: the emphasised edges; all edges, with share 0, for no emphasis."
    share: Any
    allowed: Any
    "Boolean array `[edges]`: the edges that may have weight."

    @property
    def sums(self) -> Any:
        xp = self.on_tour.__array_namespace__()
        every = xp.where(self.allowed, 1.0, 0.0)
        elsewhere = xp.where(self.on_tour, 0.0, every)
        return xp.stack([xp.append(every, 0.0), xp.append(elsewhere, 1.0)], axis=1)

    @property
    def totals(self) -> Any:
        return self.on_tour.__array_namespace__().stack([1.0, 1 - self.share])

    @property
    def live(self) -> Any:
        return self.on_tour.__array_namespace__().append(self.allowed, True)

    def first_prices(self, gain: Any, numbers: Any) -> Any:
        """Return prices that leave a positive pressure on each number."""
        xp = gain.__array_namespace__()
        on_tour = 1.2 * xp.max(xp.where(self.on_tour, gain, 0.0))
        return xp.stack([on_tour, 1.4 * xp.max(gain) - on_tour])

    def most(self, gain: Any, prices: Any = None) -> Any:
        """Return the largest `gain @ weights`, on the edges that gain most; prices are ignored."""
        xp = gain.__array_namespace__()
        on_tour = xp.max(xp.where(self.on_tour, gain, 0.0))
        return self.share * on_tour + (1 - self.share) * xp.max(gain)

    def scaled(self, weights: Any, spare: float = 0.0) -> Any:
        """Scale weights to sum 1, with at least the share, and some to spare, on the tour."""
        xp = weights.__array_namespace__()
        weights = weights / xp.sum(weights)
        there = xp.sum(xp.where(self.on_tour, weights, 0.0))
        elsewhere = xp.sum(xp.where(self.on_tour, 0.0, weights))
        most = (1 - spare) * (1 - self.share)
        more, less = xp.maximum(there, 1 - most) / there, most / xp.maximum(elsewhere, most)
        return weights * xp.where(self.on_tour, more, less)

    def start(self, design: Callable[[Any], "Design"]) -> Any:
        """Return even weights, moved twice in proportion to the root of the gain.

        In trees without an emphasis, these are optimal.
        """
        xp = self.on_tour.__array_namespace__()
        weights = self.scaled(xp.where(self.allowed, 1.0, 0.0), _SPARE)
        for _ in range(2):
            weights = self.scaled(weights * xp.sqrt(design(weights).gain), _SPARE)
        elsewhere = xp.sum(xp.where(self.on_tour, 0.0, weights))
        return xp.append(weights, 1 - self.share - elsewhere)


class Design(NamedTuple):
    """The sum of resistances, and the parts of its derivatives."""

    resistance: Any
    gain: Any
    "Array `[edges]`, the decrease of the sum per unit of each weight."
    columns: Any
    "Array `[edges, vertices]`, the `c_e`."


class Iterate(NamedTuple):
    """Numbers, with their prices, sum of resistances and gap."""

    numbers: Any
    prices: Any
    "The prices of the sums, or `None` if a method has none."
    resistance: Any
    gap: Any
    "A bound on the relative excess of the sum of resistances over the least sum."


class State(NamedTuple):
    """A point of the central path, and the best point so far."""

    numbers: Any
    pressure: Any
    "The pressure on each number, in units of the first sum."
    prices: Any
    "The prices of the sums, in the same unit."
    design: Design
    best: Iterate
    steps: Any


def follow(
    problem: Emphasis | Room,
    design: Callable[[Any], Design],
    divide: Callable[[Design, Any, Any], Callable[[Any], Any]],
    tolerance: Any,
    loop: Callable[[Callable[[State], Any], Callable[[State], State], State], State],
) -> tuple[Iterate, Any]:
    """Follow the central path until the relative gap is within half of a tolerance.

    **Arguments:**

    - `problem`: the set of allowed weights.
    - `design`: a function of numbers that returns their design.
    - `divide`: a function of a design, the unit of its sum, and a diagonal; it returns a function
        that divides by the Hessian plus that diagonal.
    - `tolerance`: tolerance of the relative gap.
    - `loop`: a loop such as `jax.lax.while_loop`.

    **Returns:** [`Iterate`][], and the number of steps. A sum that is not a number ends them.
    """
    start = problem.start(design)
    xp = start.__array_namespace__()
    sums, totals, live = problem.sums, problem.totals, problem.live
    first = design(start)
    unit = first.resistance
    beside = xp.zeros(start.shape[0] - first.gain.shape[0])

    def gain(design: Design) -> Any:
        return xp.append(design.gain, beside) / unit

    def measured(numbers: Any, prices: Any, design: Design) -> Iterate:
        paid = unit * prices
        gap = xp.maximum(0.0, 1 - design.resistance / problem.most(design.gain, paid))
        return Iterate(numbers, paid, design.resistance, gap)

    def goes_on(state: State) -> Any:
        far = (state.best.gap > tolerance / 2) & (state.numbers @ state.pressure > _ROUNDING)
        return far & (state.steps < _STEPS) & xp.isfinite(state.design.resistance)

    def step(state: State) -> State:
        stiffness = xp.where(live, state.pressure / xp.where(live, state.numbers, 1.0), 1.0)
        inverse = divide(state.design, unit, stiffness)
        point = state.numbers, state.pressure, state.prices
        point = _predictor_corrector(inverse, gain(state.design), sums, totals, live, point)
        here = design(point[0])
        now = measured(point[0], point[2], here)
        nearer = now.gap < state.best.gap
        best = Iterate(*(xp.where(nearer, *pair) for pair in zip(now, state.best, strict=True)))
        return State(*point, here, best, state.steps + 1)

    prices = problem.first_prices(first.gain / unit, start)
    pressure = xp.where(live, sums @ prices - gain(first), 0.0)
    best, steps = measured(start, prices, first), xp.zeros((), xp.int32)
    last = loop(goes_on, step, State(start, pressure, prices, first, best, steps))
    return last.best, last.steps


def _predictor_corrector(
    inverse: Callable[[Any], Any],
    gain: Any,
    sums: Any,
    totals: Any,
    live: Any,
    point: tuple[Any, Any, Any],
) -> tuple[Any, Any, Any]:
    """Take one step after which numbers and pressures are still positive.

    **Arguments:**

    - `inverse`: a function that divides by the Hessian with `pressure / numbers` on its diagonal.
    - `gain`: array `[numbers]`, the decrease of the sum per unit of each number.
    - `sums`, `totals`, `live`: as in the problem.
    - `point`: the numbers, their pressures, and the prices.

    **Returns:** the next point.
    """
    numbers, pressure, prices = point
    xp = numbers.__array_namespace__()
    safe = xp.where(live, numbers, 1.0)
    residual = xp.where(live, sums @ prices - gain - pressure, 0.0)
    missing = totals - sums.T @ numbers
    moved = inverse(sums)
    small = sums.T @ moved

    def solve(aim: Any) -> tuple[Any, Any, Any]:
        along = inverse(aim / safe - residual)
        d_prices = xp.linalg.solve(small, sums.T @ along - missing)
        d_numbers = along - moved @ d_prices
        return d_numbers, (aim - pressure * d_numbers) / safe, d_prices

    def length(d_numbers: Any, d_pressure: Any) -> Any:
        """Return the longest step, of at most 1, after which no number is negative."""
        shrink = xp.where(live, xp.maximum(-d_numbers / safe, -d_pressure / pressure), 0.0)
        return 1 / xp.maximum(1.0, xp.max(shrink))

    product = numbers * pressure
    count = xp.sum(live, dtype=float)
    mean = xp.sum(product) / count
    d_numbers, d_pressure, _ = solve(-product)
    ahead = length(d_numbers, d_pressure)
    after = (numbers + ahead * d_numbers) @ (pressure + ahead * d_pressure) / count
    centre = (after / mean) ** 3 * mean
    aim = xp.where(live, centre - product - d_numbers * d_pressure, 0.0)
    d_numbers, d_pressure, d_prices = solve(aim)
    ahead = _SHORT_OF_THE_BOUND * length(d_numbers, d_pressure)
    return numbers + ahead * d_numbers, pressure + ahead * d_pressure, prices + ahead * d_prices


@dataclasses.dataclass(frozen=True, eq=False)
class HostLaplacian:
    """The Laplacian of a graph with durations of edges, by LAPACK."""

    vertices: int
    edges: Int[np.ndarray, "edges 2"]
    durations: Float[np.ndarray, "edges"]

    def design(self, numbers: Float[np.ndarray, "numbers"]) -> Design:
        """**Raises:** `numpy.linalg.LinAlgError` for separate parts, up to rounding."""
        tail, head = self.edges.T
        weights = numbers[: tail.size] / self.durations
        inverse = pseudo_inverse(self.vertices, self.edges, weights)
        columns = inverse[tail] - inverse[head]
        columns /= np.sqrt(self.durations)[:, None]
        return Design(np.trace(inverse), np.einsum("en,en->e", columns, columns), columns)

    def divide(
        self, design: Design, unit: float, diagonal: Float[np.ndarray, "numbers"]
    ) -> Callable[[Float[np.ndarray, "numbers *sides"]], Float[np.ndarray, "numbers *sides"]]:
        """Return a function that divides by the Hessian of the edges plus a diagonal.

        A large Hessian is factorised in 32 bits, in half the time and memory: a step with an error
        of one in a thousand is as good, because the next step starts from residuals in 64 bits.

        **Raises:** `numpy.linalg.LinAlgError` if the matrix is singular up to rounding.
        """
        edges = len(self.edges)
        kinds: list[type[np.floating]] = [np.float32, np.float64]
        for kind in kinds if edges > _LARGE else kinds[1:]:
            potrf, potrs = scipy.linalg.get_lapack_funcs(("potrf", "potrs"), dtype=kind)
            matrix = self._hessian(design.columns.astype(kind), kind(2 / unit))
            matrix.flat[:: edges + 1] += diagonal[:edges].astype(kind)
            # LAPACK overwrites the order of the transpose, which is the same matrix.
            factor, info = potrf(matrix.T, lower=1, clean=0, overwrite_a=1)
            if info == 0:
                break
        else:
            raise np.linalg.LinAlgError("the Hessian is singular to rounding")

        def inverse(sides: Any) -> Any:
            on_edges = potrs(factor, sides[:edges].astype(kind, copy=False), lower=1)[0]
            beside = (sides[edges:].T / diagonal[edges:]).T
            return np.concatenate([on_edges, beside], dtype=np.float64)

        return inverse

    def _hessian(
        self, columns: Float[np.ndarray, "edges vertices"], factor: np.floating
    ) -> Float[np.ndarray, "edges edges"]:
        """Compute the entries above the diagonal, and blocks on it; LAPACK reads no more."""
        edges = len(self.edges)
        tail, head = self.edges.T
        scaled = columns * (factor / np.sqrt(self.durations)).astype(columns.dtype)[:, None]
        rows = np.ascontiguousarray(columns.T)
        hessian = np.empty((edges, edges), columns.dtype)
        for first in range(0, edges, _ROWS):
            block_rows = slice(first, first + _ROWS)
            block = scaled[block_rows] @ columns[first:].T
            block *= (rows[tail[block_rows]] - rows[head[block_rows]])[:, first:]
            hessian[block_rows, first:] = block
        return hessian


def interior_point(
    laplacian: HostLaplacian, problem: Emphasis | Room, tolerance: float
) -> tuple[Iterate, Any]:
    """Follow the central path on the host, as far as the rounding of factors permits.

    **Raises:** `numpy.linalg.LinAlgError` if rounding prevents the first factor.
    """
    large = len(laplacian.edges) > _LARGE
    with contextlib.nullcontext() if large else one_blas_thread():
        best, steps = follow(problem, laplacian.design, laplacian.divide, tolerance, _loop)
        if isinstance(problem, Emphasis) and problem.share:
            best = _on_the_bound(laplacian, problem, best)
    return best, steps


def _on_the_bound(laplacian: HostLaplacian, problem: Emphasis, best: Iterate) -> Iterate:
    """Reduce the tour to its share if a larger one costs; steps end just within the bound."""
    on_tour, weights, beyond = problem.on_tour, best.numbers[:-1], best.numbers[-1]
    if beyond > best.prices[1] / best.resistance:
        return best
    exact = problem.share / weights[on_tour].sum(), (1 - problem.share) / weights[~on_tour].sum()
    numbers = np.append(weights * np.where(on_tour, *exact), 0.0)
    design = laplacian.design(numbers)
    gap = max(0.0, 1 - design.resistance / problem.most(design.gain))
    return Iterate(numbers, best.prices, design.resistance, gap) if gap < best.gap else best


def _loop(goes_on: Callable[[State], Any], step: Callable[[State], State], state: State) -> State:
    with contextlib.suppress(np.linalg.LinAlgError):
        while goes_on(state):
            state = step(state)
    return state
