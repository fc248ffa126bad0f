"""Least sum of resistances between the vertices of a graph, from an interior-point method.

**The problem.** With `X` the pseudo-inverse of the weighted Laplacian `sum_e w_e b_e b_e' / t_e` of
edges with weights `w` and durations `t`, where `b_e = e_i - e_j` for an edge `e` from `i` to `j`:

    minimise R(w) = tr X     over numbers x >= 0 with sums' x = totals,

where `x` are the weights, followed by the slacks of inequalities. Each column of `sums` is an
equation; the first is that the weights sum to 1. With `c_e = X b_e / sqrt(t_e)` the derivatives are

    -dR/dw_e = |c_e|^2, the gain of an edge,     d2R/dw_e dw_f = 2 (c_e' c_f)(c_e' b_f) / sqrt(t_f).

**The method.** At the optimum there are prices with `gain + pressure = sums prices`, where the
pressure (the dual slack) of an entry of `x` is not negative, and 0 if the entry is positive.
Mehrotra's predictor-corrector steps approach it, each with one Cholesky factorisation.

**The bound.** `R` is convex and homogeneous of degree -1, so its reciprocal is concave, and the
tangent at `w` bounds it everywhere: `R(u) >= R(w)^2 / most` for all weights `u`, with `most` the
largest `gain @ u`. The steps end when the relative gap, the residual of the certificate, is small.
"""

import contextlib
import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import scipy.linalg
from jaxtyping import Bool, Float, Int

from ..base.process import one_blas_thread
from .constraints import Room


_STEPS = 100
# Number of rows of the Hessian that are computed at once, so that they fit in the cache.
_ROWS = 64
# A smaller duality measure is due to rounding.
_ROUNDING = 1e-16
# Share of the way to the nearest bound that a step goes, so that numbers stay positive.
_SHORT_OF_THE_BOUND = 0.99
# At the start, the tour has its share and this part of the remaining weight.
_SPARE = 0.1


_Weights: TypeAlias = Float[np.ndarray, "edges"]
_Numbers: TypeAlias = Float[np.ndarray, "numbers"]
_Prices: TypeAlias = Float[np.ndarray, "prices"]


class Emphasis(NamedTuple):
    """The set of weights with at least a given share on the edges of a tour.

    The unknowns are the weights, and the excess of the weight on the tour over the share. There are
    two equations: one for the sum of all weights, one for the sum of the excess and the weights off
    the tour. An equation for the weight on the tour would be inaccurate if the share is almost 1.
    """

    on_tour: Bool[np.ndarray, "edges"]
    "The emphasised edges; if there is no emphasis, all edges, and the share is 0."
    share: float

    @property
    def sums(self) -> Float[np.ndarray, "numbers 2"]:
        return np.stack([[*np.ones(self.on_tour.size), 0.0], [*~self.on_tour, 1.0]], axis=1)

    @property
    def totals(self) -> Float[np.ndarray, "2"]:
        return np.array([1.0, 1 - self.share])

    def first_prices(self, gain: _Weights, numbers: _Numbers) -> Float[np.ndarray, "2"]:
        """Return initial prices for the interior-point method, with positive dual slacks."""
        on_tour = 1.2 * gain[self.on_tour].max()
        return np.array([on_tour, 1.4 * gain.max() - on_tour])

    def most(self, gain: _Weights, prices: Any = None) -> float:
        """Return the largest `gain @ weights` over all allowed weights.

        At most two edges have weight at the maximum. `prices` is used only by `Room.most`.
        """
        return float(self.share * gain[self.on_tour].max() + (1 - self.share) * gain.max())

    def scaled(self, weights: _Weights, spare: float = 0.0) -> _Weights:
        """Scale weights to a sum of 1, with at least `share + spare * (1 - share)` on the tour."""
        weights = weights / weights.sum()
        there, elsewhere = weights[self.on_tour].sum(), weights[~self.on_tour].sum()
        most = (1 - spare) * (1 - self.share)
        more, less = max(there, 1 - most) / there, most / max(elsewhere, most)
        return weights * np.where(self.on_tour, more, less)

    def start(self, design: "Callable[[Float[np.ndarray, 'edges']], Design]") -> _Numbers:
        """Return initial numbers: equal weights, multiplied twice by the roots of their gains.

        In trees without an emphasis, these weights are optimal.
        """
        weights = self.scaled(np.ones(self.on_tour.size), _SPARE)
        for _ in range(2):
            weights = self.scaled(weights * np.sqrt(design(weights).gain), _SPARE)
        return np.append(weights, 1 - self.share - weights[~self.on_tour].sum())


class Design(NamedTuple):
    """The sum of resistances for some weights, and the terms of its first two derivatives."""

    resistance: float
    gain: _Weights
    "The decrease of the sum of resistances per unit of the weight of each edge."
    columns: Float[np.ndarray, "edges vertices"]
    "The vectors `c_e = X b_e / sqrt(t_e)`, one per edge."


class Iterate(NamedTuple):
    """An iterate: weights and slacks, with their prices, sum of resistances and gap."""

    numbers: _Numbers
    prices: _Prices | None
    "The shadow prices of the equations, or `None` if a method does not compute them."
    resistance: float
    gap: float
    "A bound on the relative excess of the sum of resistances over the least sum."


@dataclasses.dataclass(frozen=True, eq=False)
class Laplacian:
    """The Laplacian of a graph, with the weight of each edge divided by its duration."""

    vertices: int
    edges: Int[np.ndarray, "edges 2"]
    durations: _Weights
    many: int = 2000
    "Above this number of edges, steps are computed in 32 bits and on all cores."

    def design(self, numbers: _Numbers) -> Design:
        """Compute the sum of resistances and its derivatives.

        **Raises:** `numpy.linalg.LinAlgError` if edges with weight 0 separate vertices.
        """
        tail, head = self.edges.T
        weights = numbers[: tail.size] / self.durations
        inverse = pseudo_inverse(self.vertices, self.edges, weights)
        columns = inverse[tail] - inverse[head]
        columns /= np.sqrt(self.durations)[:, None]
        return Design(float(np.trace(inverse)), np.einsum("en,en->e", columns, columns), columns)

    def divide(
        self, design: Design, unit: float, diagonal: _Numbers
    ) -> Callable[[Float[np.ndarray, "numbers *sides"]], Float[np.ndarray, "numbers *sides"]]:
        """Return a function that multiplies by the inverse of `Hessian / unit + diag(diagonal)`.

        A large Hessian is factorised in 32 bits, in half the time and memory. A relative error of
        0.001 in a step does no harm, because the next step starts from residuals in 64 bits.

        **Raises:** `numpy.linalg.LinAlgError` if the matrix is singular up to rounding.
        """
        edges = len(self.edges)
        kinds: list[type[np.floating]] = [np.float32, np.float64]
        for kind in kinds if edges > self.many else kinds[1:]:
            potrf, potrs = scipy.linalg.get_lapack_funcs(("potrf", "potrs"), dtype=kind)
            matrix = self._hessian(design.columns.astype(kind), kind(2 / unit))
            matrix.flat[:: edges + 1] += diagonal[:edges].astype(kind)
            # LAPACK overwrites arrays in Fortran order: the transpose, which is the same matrix.
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
        """Compute the Hessian on and above the diagonal, in blocks; LAPACK reads nothing else."""
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


def pseudo_inverse(
    vertices: int, edges: Int[np.ndarray, "edges 2"], weights: _Weights
) -> Float[np.ndarray, "vertices vertices"]:
    """Compute the pseudo-inverse of `sum_e w_e b_e b_e'`, the weighted Laplacian.

    For an edge `e` from `i` to `j`, `b_e = e_i - e_j`. **Raises:** `numpy.linalg.LinAlgError` if
    edges with weight 0 separate vertices, up to rounding.
    """
    tail, head = edges.T
    laplacian = np.zeros((vertices, vertices))
    laplacian[tail, head] = laplacian[head, tail] = -weights
    degree = -laplacian.sum(axis=0)
    laplacian.flat[:: vertices + 1] = degree
    # Adding a constant moves the eigenvalue 0 into the range of the other eigenvalues.
    shift = degree.mean()
    laplacian += shift / vertices
    # LAPACK overwrites arrays in Fortran order: the transpose, which is the same matrix.
    factor, info = scipy.linalg.lapack.dpotrf(laplacian.T, lower=1, overwrite_a=1)
    if info == 0:
        factor, info = scipy.linalg.lapack.dpotri(factor, lower=1, overwrite_c=1)
    if info:
        raise np.linalg.LinAlgError("the Laplacian is singular to rounding")
    # LAPACK does not fill the entries above the diagonal, which are 0.
    inverse = factor + factor.T
    inverse.flat[:: vertices + 1] /= 2
    inverse -= 1 / (shift * vertices)
    return inverse


def interior_point(
    laplacian: Laplacian, problem: Emphasis | Room, tolerance: float
) -> tuple[Iterate, int]:
    """Follow the central path until the relative gap is at most half of a tolerance.

    **Returns:** the iterate with the smallest gap, and the number of steps. The steps end sooner if
    rounding errors make a factorisation fail.

    **Raises:** `numpy.linalg.LinAlgError` if rounding makes the Laplacian of the start singular.
    """
    many = len(laplacian.edges) > laplacian.many
    with contextlib.nullcontext() if many else one_blas_thread():
        best, steps = _follow(laplacian, problem, tolerance)
        if isinstance(problem, Emphasis) and problem.share:
            best = _on_the_bound(laplacian, problem, best)
    return best, steps


def _follow(
    laplacian: Laplacian, problem: Emphasis | Room, tolerance: float
) -> tuple[Iterate, int]:
    numbers = problem.start(laplacian.design)
    design = laplacian.design(numbers)
    # Pressures and prices are in units of the first sum.
    unit = design.resistance
    sums, totals = problem.sums, problem.totals
    beside = np.zeros(numbers.size - design.gain.size)
    prices = problem.first_prices(design.gain / unit, numbers)
    pressure = sums @ prices - np.append(design.gain, beside) / unit
    best, steps = _measured(problem, numbers, unit * prices, design), 0
    with contextlib.suppress(np.linalg.LinAlgError):
        while (
            best.gap > tolerance / 2
            and numbers @ pressure > _ROUNDING
            and steps < _STEPS
            and np.isfinite(design.resistance)
        ):
            inverse = laplacian.divide(design, unit, pressure / numbers)
            gain = np.append(design.gain, beside) / unit
            point = _predictor_corrector(inverse, gain, sums, totals, (numbers, pressure, prices))
            numbers, pressure, prices = point
            design = laplacian.design(numbers)
            steps += 1
            now = _measured(problem, numbers, unit * prices, design)
            best = now if now.gap < best.gap else best
    return best, steps


def _measured(
    problem: Emphasis | Room, numbers: _Numbers, prices: _Prices | None, design: Design
) -> Iterate:
    gap = max(0.0, 1 - design.resistance / problem.most(design.gain, prices))
    return Iterate(numbers, prices, design.resistance, gap)


def _predictor_corrector(
    inverse: Callable[[Float[np.ndarray, "numbers *sides"]], Float[np.ndarray, "numbers *sides"]],
    gain: _Numbers,
    sums: Float[np.ndarray, "numbers prices"],
    totals: _Prices,
    point: tuple[Any, Any, Any],
) -> tuple[Any, Any, Any]:
    """Take one step from a point (numbers, pressures, prices). Numbers and pressures stay positive.

    `inverse` multiplies by the inverse of the Hessian plus the diagonal `pressure / numbers`.
    """
    numbers, pressure, prices = point
    residual = sums @ prices - gain - pressure
    missing = totals - sums.T @ numbers
    moved = inverse(sums)
    small = sums.T @ moved

    def solve(aim: Any) -> tuple[Any, Any, Any]:
        along = inverse(aim / numbers - residual)
        d_prices = np.linalg.solve(small, sums.T @ along - missing)
        d_numbers = along - moved @ d_prices
        return d_numbers, (aim - pressure * d_numbers) / numbers, d_prices

    def length(d_numbers: Any, d_pressure: Any) -> float:
        shrink = np.maximum(-d_numbers / numbers, -d_pressure / pressure)
        return 1 / max(1.0, float(shrink.max()))

    product = numbers * pressure
    d_numbers, d_pressure, _ = solve(-product)
    ahead = length(d_numbers, d_pressure)
    after = ((numbers + ahead * d_numbers) @ (pressure + ahead * d_pressure)) / numbers.size
    centre = (after / product.mean()) ** 3 * product.mean()
    d_numbers, d_pressure, d_prices = solve(centre - product - d_numbers * d_pressure)
    ahead = _SHORT_OF_THE_BOUND * length(d_numbers, d_pressure)
    return numbers + ahead * d_numbers, pressure + ahead * d_pressure, prices + ahead * d_prices


def _on_the_bound(laplacian: Laplacian, problem: Emphasis, best: Iterate) -> Iterate:
    """Reduce the weight on the tour to exactly `share`, if this lower bound is tight."""
    on_tour, weights, beyond = problem.on_tour, best.numbers[:-1], best.numbers[-1]
    if best.prices is None or beyond > best.prices[1] / best.resistance:
        return best
    exact = problem.share / weights[on_tour].sum(), (1 - problem.share) / weights[~on_tour].sum()
    numbers = np.append(weights * np.where(on_tour, *exact), 0.0)
    reduced = _measured(problem, numbers, best.prices, laplacian.design(numbers))
    return reduced if reduced.gap < best.gap else best
