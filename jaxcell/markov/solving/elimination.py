import dataclasses
import math
from typing import TypeAlias

import numpy as np
import scipy.linalg
import scipy.sparse
from jaxtyping import Float, Int
from scipy.sparse import csgraph

from ...base.process import one_blas_thread
from .scaled import Scaled


Columns: TypeAlias = Float[np.ndarray, "rows columns"]
"""Right-hand sides or solutions of several systems with one matrix."""

# Number of states that are eliminated together, by one product of matrices.
_BLOCK = 16
# At most this many states are one level, because levels are expensive to find.
_FEW = 400
# Bound on the relative change of probabilities by the elimination of a state, for a solution with
# twice as many probabilities per state: 64 roundings.
_PER_STATE = 2.0**-47
# Below this number products of probabilities lose digits.
_TINY = 1e-280
# Largest number of multiplications of an elimination in numbers of any size.
_SCALED = 1e8


@dataclasses.dataclass(frozen=True, eq=False)
class Levels:
    """States grouped by distance from a first state: a step changes the level by at most 1."""

    order: Int[np.ndarray, "rows"]
    "The states, level by level."
    bounds: Int[np.ndarray, "bounds"]
    "The index in `order` of the first state of each level; the last entry is the number of states."

    @classmethod
    def of(cls, step: scipy.sparse.csr_array) -> "Levels":
        """Group the states of a matrix by distance from a state that is far from other states."""
        if step.shape[0] <= _FEW:
            return cls(np.arange(step.shape[0]), np.array([0, step.shape[0]]))
        graph = ((step + step.T) != 0).astype(np.int8).tocsr()
        _, part = csgraph.connected_components(graph, directed=False)
        level = np.zeros(step.shape[0])
        for _ in range(2):
            # In each connected part, begin at a state that is farthest from the previous begin.
            order = np.lexsort((-level, part))
            roots = order[np.unique(part[order], return_index=True)[1]]
            level = csgraph.dijkstra(graph, unweighted=True, indices=roots, min_only=True)
        bounds = np.cumsum([0, *np.bincount(level.astype(int))])
        return cls(np.argsort(level, kind="stable"), bounds)

    @property
    def work(self) -> float:
        """The approximate number of multiplications of an elimination."""
        size = np.diff(self.bounds).astype(float)
        before = np.concatenate([[0.0], size[:-1]])
        return float((size * (size + before) ** 2).sum())


@one_blas_thread()
@np.errstate(all="ignore")
def eliminate(
    step: scipy.sparse.csr_array,
    leaving: Float[np.ndarray, "rows"],
    right: Columns,
    levels: Levels | None = None,
    *,
    adjoint: bool = False,
) -> tuple[Columns, float]:
    """Solve `x = right + Q x`, or `x = right + Q' x` if `adjoint`, without subtractions.

    States are eliminated one by one (Grassmann, Taksar and Heyman 1985). The probability of leaving
    a state is the sum of the probabilities of the steps from it, not 1 minus the probability of
    staying. So every number has nearly all its digits, even if the chain leaves its cells once in
    10^20 steps; other factorisations then return only rounding errors. Levels are eliminated from
    the last to the first, in dense blocks. On a plane, the time is proportional to the number of
    cells times the square of the width in cells.

    **Arguments:**

    - `step`: the matrix `Q`, not negative.
    - `leaving`: for each state, the probability of a step out of all states, with all its digits.
    - `right`: the right-hand side, not negative.
    - `levels`: the levels of the matrix, if they are known.

    **Returns:** the solution, and a bound on the relative error of every entry that is not far
    below the largest one (see [`Transient.expect`][]). It is `inf` if numbers are too small or too
    large for 64 bits.

    The bound needs no residual. A rounding changes a probability by a part of itself. A solution is
    a quotient of two sums of products with one probability from each row (the matrix-tree theorem).
    So if a state is eliminated from `m` states, and changes their rows by 64 roundings, a solution
    changes by at most `2 m` times as much (O'Cinneide 1993).
    """
    levels = Levels.of(step) if levels is None else levels
    order, bounds = levels.order, levels.bounds.tolist()
    among = step.tocsr()[order][:, order].tocsr()
    ends, x = leaving[order], right[order]
    factors: list[Factor] = []
    inner, error = None, 0.0
    for m in range(len(bounds) - 2, -1, -1):
        before, first, last = bounds[max(0, m - 1)], bounds[m], bounds[m + 1]
        keep = first - before
        front = among[before:last, before:last].toarray()
        if inner is not None:
            # The steps within the level include those by way of the eliminated levels.
            front[keep:, keep:] = inner
        factor = take_out(front, ends[before:last], keep, before)
        error += factor.error
        factors.append(factor)
        inner = front[:keep, :keep].copy()
    for factor in factors:
        factor.inward(x, adjoint)
    for factor in reversed(factors):
        factor.outward(x, adjoint)
    solution = np.empty_like(x)
    solution[order] = x
    if not math.isfinite(error):
        scaled = eliminate_scaled(step, leaving, right, levels, adjoint=adjoint)
        if scaled is not None:
            solution, error = scaled[0].numbers, scaled[1]
    return solution, error if np.isfinite(solution).all() else math.inf


@np.errstate(all="ignore")
def eliminate_scaled(
    step: scipy.sparse.csr_array,
    leaving: Float[np.ndarray, "rows"],
    right: Columns,
    levels: Levels | None = None,
    *,
    adjoint: bool = False,
) -> tuple[Scaled, float] | None:
    """Solve the equation of [`eliminate`][] in numbers of any size, with the same arguments.

    Products of rare steps may be smaller than 1e-308, although their quotients, the expected times
    and odds, are ordinary numbers. It takes about 50 times as long.

    **Returns:** the solution, and a bound on the relative error of every entry; `None` if it would
    take too many multiplications.
    """
    levels = Levels.of(step) if levels is None else levels
    if levels.work > _SCALED:
        return None
    order, bounds = levels.order, levels.bounds.tolist()
    step = step.tocsr()[order][:, order].tocsr()
    leaves, x = Scaled.of(leaving[order]), Scaled.of(right[order])
    eliminated: list[tuple[slice, slice, Scaled]] = []
    inner, error = None, 0.0
    for m in range(len(bounds) - 2, -1, -1):
        before, first, last = bounds[max(0, m - 1)], bounds[m], bounds[m + 1]
        keep, size = first - before, last - before
        front = Scaled.of(step[before:last, before:last].toarray())
        if inner is not None:
            front[keep:, keep:] = inner
        for k in range(size - 1, keep - 1, -1):
            here, others = slice(before + k, before + k + 1), slice(before, before + k)
            on = front[k : k + 1, :k].sum(axis=1) + leaves[here]
            share, back = front[:k, k] / on, front[k, :k] / on
            front[:k, :k] = front[:k, :k] + share[:, None] * front[k, :k]
            leaves[others] = leaves[others] + share * leaves[here]
            inward, outward = (back, share) if adjoint else (share, back)
            x[others] = x[others] + inward[:, None] * x[here]
            x[here] = x[here] / on[:, None]
            eliminated.append((here, others, outward))
        inner = front[:keep, :keep]
        error += _PER_STATE * (size**2 - keep**2)
    for here, others, outward in reversed(eliminated):
        x[here] = x[here] + (outward[:, None] * x[others]).sum(axis=0)
    solution = Scaled(np.empty_like(x.part), np.empty_like(x.power))
    solution[order] = x
    return solution, error


@dataclasses.dataclass(frozen=True, eq=False)
class Factor:
    """An eliminated level, whose block of `I - Q` is the product of two triangular matrices."""

    before: slice
    here: slice
    triangles: Float[np.ndarray, "level level"]
    "Both triangles in one matrix, without the diagonal of the upper one, which is 1."
    into: Float[np.ndarray, "before level"]
    back: Float[np.ndarray, "level before"]
    error: float
    "A bound on the relative error of solutions that is due to this level."

    def inward(self, x: Columns, adjoint: bool) -> None:
        x[self.here] = self._solve(x[self.here], lower=adjoint, adjoint=adjoint)
        x[self.before] += (self.back.T if adjoint else self.into) @ x[self.here]

    def outward(self, x: Columns, adjoint: bool) -> None:
        right = x[self.here] + (self.into.T if adjoint else self.back) @ x[self.before]
        x[self.here] = self._solve(right, lower=not adjoint, adjoint=adjoint)

    def _solve(self, right: np.ndarray, *, lower: bool, adjoint: bool) -> np.ndarray:
        # Substitution in either triangle only adds.
        return scipy.linalg.solve_triangular(
            self.triangles,
            right,
            lower=lower,
            unit_diagonal=not lower,
            trans=int(adjoint),
            check_finite=False,
        )


def take_out(
    step: Float[np.ndarray, "rows rows"],
    leaving: Float[np.ndarray, "rows"],
    keep: int,
    first: int = 0,
) -> Factor:
    """Eliminate all states except the first `keep` from a matrix, in place, the last state first.

    `first` is the index of the first state of the matrix among all states of a solution.
    """
    size = len(step)
    on = np.empty(size)
    for top in range(size, keep, -_BLOCK):
        low = max(keep, top - _BLOCK)
        for k in range(top - 1, low - 1, -1):
            # If a probability is too small for 64 bits, so are the results.
            on[k] = leaving[k] + step[k, :k].sum() or np.nan
            share = step[:k, k] / on[k]
            step[low:k, :k] += share[low:, None] * step[k, :k]
            step[:low, low:k] += share[:low, None] * step[k, low:k]
            leaving[:k] += share * leaving[k]
        # Steps to the other states by way of the block.
        step[:low, :low] += (step[:low, low:top] / on[low:top]) @ step[low:top, :low]
    on = on[keep:]
    inside = step[keep:, keep:]
    triangles = -np.where(np.tri(on.size, dtype=bool), inside, inside / on)
    np.fill_diagonal(triangles, on)
    error = _PER_STATE * (size**2 - keep**2) if (on > _TINY).all() else math.inf
    before, here = slice(first, first + keep), slice(first + keep, first + size)
    into, back = step[:keep, keep:] / on, step[keep:, :keep].copy()
    return Factor(before, here, triangles, into, back, error)
