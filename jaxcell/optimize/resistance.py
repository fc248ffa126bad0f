"""The least sum of resistances between the vertices of a graph, by an interior-point method.

**The problem.** With `X` the pseudo-inverse of the weighted Laplacian `sum_e w_e b_e b_e' / t_e` of
edges with weights `w` and durations `t`, `b_e` the difference of the ends of edge `e`:

    minimise R(w) = tr X     over numbers x >= 0 with sums' x = totals,

where `x` are the weights, which sum to 1, and after them what inequalities have to spare. With
`c_e = X b_e / sqrt(t_e)` the derivatives are

    -dR/dw_e = |c_e|^2, the gain of an edge,     d2R/dw_e dw_f = 2 (c_e' c_f)(c_e' b_f) / sqrt(t_f).

**The method.** At the optimum there are prices with `gain + pressure = sums prices`, where a
pressure that is not negative is 0 at each number that is not. Steps of Mehrotra's predictor and
corrector lead there from within, with one Cholesky factor of the Hessian each.

**The bound.** `R` is convex and homogeneous of degree -1, so its reciprocal is concave, and the
tangent of that at `w` bounds it everywhere: no weights have a sum below `R(w)^2 / most`, with
`most` the largest `gain @ u` of all weights `u`. It is the certificate, and ends the steps.

Formulas and steps are for arrays of NumPy or of JAX: [`interior_point`][] takes them on the host,
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
# With more edges, steps are computed in 32 bits, and by all cores.
_LARGE = 2000
# Rows of the Hessian that are made at once, in the cache.
_ROWS = 64
# Below this, the distance from the central path is rounding.
_ROUNDING = 1e-16
# Of the way to the nearest bound, so that numbers stay positive.
_SHORT_OF_THE_BOUND = 0.99
# Of what a share leaves to all edges, the tour has so much more at the start.
_SPARE = 0.1


class Emphasis(NamedTuple):
    """Weights with at least a share on the edges of a tour.

    What the tour has beyond its share is one more number, so that steps find whether the bound is
    tight. The two sums are that of all weights, and that of what is elsewhere and what is beyond:
    with the sum on the tour, what a share of almost 1 leaves would be lost in rounding.
    """

    on_tour: Any
    "Boolean array `[edges]`: all of them, with share 0, for no emphasis."
    share: Any
    allowed: Any
    "Boolean array `[edges]`: those that may have weight."

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
        """Prices that leave a pressure on each number that keeps it positive."""
        xp = gain.__array_namespace__()
        on_tour = 1.2 * xp.max(xp.where(self.on_tour, gain, 0.0))
        return xp.stack([on_tour, 1.4 * xp.max(gain) - on_tour])

    def most(self, gain: Any, prices: Any = None) -> Any:
        """The largest `gain @ weights`, on the edges that gain most; prices do not matter."""
        xp = gain.__array_namespace__()
        on_tour = xp.max(xp.where(self.on_tour, gain, 0.0))
        return self.share * on_tour + (1 - self.share) * xp.max(gain)

    def scaled(self, weights: Any, spare: float = 0.0) -> Any:
        """The weights with the sum 1, and at least the share and something to spare on the tour."""
        xp = weights.__array_namespace__()
        weights = weights / xp.sum(weights)
        there = xp.sum(xp.where(self.on_tour, weights, 0.0))
        elsewhere = xp.sum(xp.where(self.on_tour, 0.0, weights))
        most = (1 - spare) * (1 - self.share)
        more, less = xp.maximum(there, 1 - most) / there, most / xp.maximum(elsewhere, most)
        return weights * xp.where(self.on_tour, more, less)

    def start(self, design: Callable[[Any], "Design"]) -> Any:
        """Even weights, then moved in proportion to the root of the gain.

        In trees without an emphasis, that is all.
        """
        xp = self.on_tour.__array_namespace__()
        weights = self.scaled(xp.where(self.allowed, 1.0, 0.0), _SPARE)
        for _ in range(2):
            weights = self.scaled(weights * xp.sqrt(design(weights).gain), _SPARE)
        elsewhere = xp.sum(xp.where(self.on_tour, 0.0, weights))
        return xp.append(weights, 1 - self.share - elsewhere)


class Design(NamedTuple):
    """The sum of resistances, and what its derivatives are made of."""

    resistance: Any
    gain: Any
    "Array `[edges]`, by how much each weight lowers the sum."
    columns: Any
    "Array `[edges, vertices]`, the `c_e`."


class Found(NamedTuple):
    """Numbers, and how good they are."""

    numbers: Any
    prices: Any
    "Of the sums; none where a method finds none."
    resistance: Any
    gap: Any
    "By how much of itself the sum of resistances can be above the least."


class State(NamedTuple):
    """A point on the way, and the best one so far."""

    numbers: Any
    pressure: Any
    "Of each number, in units of the first sum."
    prices: Any
    "In that unit too."
    design: Design
    best: Found
    steps: Any


def follow(
    problem: Emphasis | Room,
    design: Callable[[Any], Design],
    divide: Callable[[Design, Any, Any], Callable[[Any], Any]],
    tolerance: Any,
    loop: Callable[[Callable[[State], Any], Callable[[State], State], State], State],
) -> tuple[Found, Any]:
    """Follow the central path until the relative gap is within half of a tolerance.

    **Arguments:**

    - `problem`: what weights may be.
    - `design`: of numbers.
    - `divide`: of a design, the unit of its sum, and what the diagonal has beyond the Hessian: a
        function that divides by both.
    - `tolerance`: of the relative gap.
    - `loop`: as `jax.lax.while_loop`.

    **Returns:** [`Found`][], and the number of steps. A sum that is not a number ends them.
    """
    start = problem.start(design)
    xp = start.__array_namespace__()
    sums, totals, live = problem.sums, problem.totals, problem.live
    first = design(start)
    unit = first.resistance
    beside = xp.zeros(start.shape[0] - first.gain.shape[0])

    def gain(design: Design) -> Any:
        return xp.append(design.gain, beside) / unit

    def found(numbers: Any, prices: Any, design: Design) -> Found:
        paid = unit * prices
        gap = xp.maximum(0.0, 1 - design.resistance / problem.most(design.gain, paid))
        return Found(numbers, paid, design.resistance, gap)

    def goes_on(state: State) -> Any:
        far = (state.best.gap > tolerance / 2) & (state.numbers @ state.pressure > _ROUNDING)
        return far & (state.steps < _STEPS) & xp.isfinite(state.design.resistance)

    def step(state: State) -> State:
        stiffness = xp.where(live, state.pressure / xp.where(live, state.numbers, 1.0), 1.0)
        inverse = divide(state.design, unit, stiffness)
        point = state.numbers, state.pressure, state.prices
        point = _predictor_corrector(inverse, gain(state.design), sums, totals, live, point)
        here = design(point[0])
        now = found(point[0], point[2], here)
        nearer = now.gap < state.best.gap
        best = Found(*(xp.where(nearer, *pair) for pair in zip(now, state.best, strict=True)))
        return State(*point, here, best, state.steps + 1)

    prices = problem.first_prices(first.gain / unit, start)
    pressure = xp.where(live, sums @ prices - gain(first), 0.0)
    best, steps = found(start, prices, first), xp.zeros((), xp.int32)
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
    """One step, after which numbers and pressures are positive still.

    **Arguments:**

    - `inverse`: divides by the Hessian with `pressure / numbers` on its diagonal.
    - `gain`: array `[numbers]`, by how much each number lowers the sum.
    - `sums`, `totals`, `live`: of the problem.
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
        """The longest step, of at most 1, after which nothing is negative."""
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
    """The Laplacian of a graph whose edges take time, by LAPACK."""

    vertices: int
    edges: Int[np.ndarray, "edges 2"]
    durations: Float[np.ndarray, "edges"]

    def design(self, numbers: Float[np.ndarray, "numbers"]) -> Design:
        """**Raises:** `numpy.linalg.LinAlgError` if parts are separate to rounding."""
        tail, head = self.edges.T
        weights = numbers[: tail.size] / self.durations
        inverse = pseudo_inverse(self.vertices, self.edges, weights)
        columns = inverse[tail] - inverse[head]
        columns /= np.sqrt(self.durations)[:, None]
        return Design(np.trace(inverse), np.einsum("en,en->e", columns, columns), columns)

    def divide(
        self, design: Design, unit: float, diagonal: Float[np.ndarray, "numbers"]
    ) -> Callable[[Float[np.ndarray, "numbers *sides"]], Float[np.ndarray, "numbers *sides"]]:
        """Divide by the Hessian and a diagonal, which is all there is off the edges.

        A large one is factorised in 32 bits, in half the time and memory: a step that is off by a
        part in a thousand is as good, because the next one starts from residuals in 64 bits.

        **Raises:** `numpy.linalg.LinAlgError` if it is singular to rounding.
        """
        edges = len(self.edges)
        kinds: list[type[np.floating]] = [np.float32, np.float64]
        for kind in kinds if edges > _LARGE else kinds[1:]:
            potrf, potrs = scipy.linalg.get_lapack_funcs(("potrf", "potrs"), dtype=kind)
            matrix = self._hessian(design.columns.astype(kind), kind(2 / unit))
            matrix.flat[:: edges + 1] += diagonal[:edges].astype(kind)
            # The transpose of a symmetric matrix is in the order that LAPACK overwrites.
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
        """What is above the diagonal, and blocks on it; LAPACK reads no more."""
        edges = len(self.edges)
        tail, head = self.edges.T
        scaled = columns * (factor / np.sqrt(self.durations)).astype(columns.dtype)[:, None]
        rows = np.ascontiguousarray(columns.T)
        hessian = np.empty((edges, edges), columns.dtype)
        for first in range(0, edges, _ROWS):
            some = slice(first, first + _ROWS)
            block = scaled[some] @ columns[first:].T
            block *= (rows[tail[some]] - rows[head[some]])[:, first:]
            hessian[some, first:] = block
        return hessian


def interior_point(
    laplacian: HostLaplacian, problem: Emphasis | Room, tolerance: float
) -> tuple[Found, Any]:
    """Follow the central path on the host, as far as rounding lets factors exist.

    **Raises:** `numpy.linalg.LinAlgError` if rounding leaves none at the start.
    """
    large = len(laplacian.edges) > _LARGE
    with contextlib.nullcontext() if large else one_blas_thread():
        found, steps = follow(problem, laplacian.design, laplacian.divide, tolerance, _loop)
        if isinstance(problem, Emphasis) and problem.share:
            found = _on_the_bound(laplacian, problem, found)
    return found, steps


def _on_the_bound(laplacian: HostLaplacian, problem: Emphasis, found: Found) -> Found:
    """With no more on the tour than its share, where that is dear; steps end just within."""
    on_tour, weights, beyond = problem.on_tour, found.numbers[:-1], found.numbers[-1]
    if beyond > found.prices[1] / found.resistance:
        return found
    exact = problem.share / weights[on_tour].sum(), (1 - problem.share) / weights[~on_tour].sum()
    numbers = np.append(weights * np.where(on_tour, *exact), 0.0)
    design = laplacian.design(numbers)
    gap = max(0.0, 1 - design.resistance / problem.most(design.gain))
    return Found(numbers, found.prices, design.resistance, gap) if gap < found.gap else found


def _loop(goes_on: Callable[[State], Any], step: Callable[[State], State], state: State) -> State:
    with contextlib.suppress(np.linalg.LinAlgError):
        while goes_on(state):
            state = step(state)
    return state
