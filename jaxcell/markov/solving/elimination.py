import dataclasses
from typing import TypeAlias

import numpy as np
import scipy.linalg
import scipy.sparse
from jaxtyping import Float, Int
from scipy.sparse import csgraph

from ...base.process import one_blas_thread


Columns: TypeAlias = Float[np.ndarray, "rows columns"]
"""Right-hand sides or solutions of several systems with one matrix."""

# Number of states that are eliminated together, by one product of matrices.
_BLOCK = 16
# At most this many states are one level, because levels are expensive to find.
_FEW = 400


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
def eliminate(
    step: scipy.sparse.csr_array,
    leaving: Float[np.ndarray, "rows"],
    right: Columns,
    levels: Levels | None = None,
    *,
    adjoint: bool = False,
) -> Columns:
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
    """
    levels = Levels.of(step) if levels is None else levels
    order, bounds = levels.order, levels.bounds.tolist()
    step = step.tocsr()[order][:, order].tocsr()
    leaving, x = leaving[order], right[order]
    factors: list[_Factor] = []
    inner = None
    for m in range(len(bounds) - 2, -1, -1):
        before, first, last = bounds[max(0, m - 1)], bounds[m], bounds[m + 1]
        keep = first - before
        front = step[before:last, before:last].toarray()
        if inner is not None:
            # The steps within the level include those by way of the eliminated levels.
            front[keep:, keep:] = inner
        on = _take_out(front, leaving[before:last], keep)
        factors.append(_Factor.of(slice(before, first), slice(first, last), front, on))
        inner = front[:keep, :keep].copy()
    for factor in factors:
        factor.inward(x, adjoint)
    for factor in reversed(factors):
        factor.outward(x, adjoint)
    solution = np.empty_like(x)
    solution[order] = x
    return solution


@dataclasses.dataclass(frozen=True, eq=False)
class _Factor:
    """An eliminated level, whose block of `I - Q` is the product of two triangular matrices."""

    before: slice
    here: slice
    triangles: Float[np.ndarray, "level level"]
    "Both triangles in one matrix, without the diagonal of the upper one, which is 1."
    into: Float[np.ndarray, "before level"]
    back: Float[np.ndarray, "level before"]

    @classmethod
    def of(cls, before: slice, here: slice, front: np.ndarray, on: np.ndarray) -> "_Factor":
        keep = len(front) - on.size
        inside = front[keep:, keep:]
        triangles = -np.where(np.tri(on.size, dtype=bool), inside, inside / on)
        np.fill_diagonal(triangles, on)
        return cls(before, here, triangles, front[:keep, keep:] / on, front[keep:, :keep].copy())

    def inward(self, x: Columns, adjoint: bool) -> None:
        x[self.here] = self._solve(x[self.here], lower=adjoint, adjoint=adjoint)
        x[self.before] += (self.back.T if adjoint else self.into) @ x[self.here]

    def outward(self, x: Columns, adjoint: bool) -> None:
        right = x[self.here] + (self.into.T if adjoint else self.back) @ x[self.before]
        x[self.here] = self._solve(right, lower=not adjoint, adjoint=adjoint)

    def _solve(self, right: np.ndarray, *, lower: bool, adjoint: bool) -> np.ndarray:
        # Substitution in either triangle only adds.
        return scipy.linalg.solve_triangular(
            self.triangles, right, lower=lower, unit_diagonal=not lower, trans=int(adjoint)
        )


def _take_out(
    step: Float[np.ndarray, "rows rows"], leaving: Float[np.ndarray, "rows"], keep: int
) -> Float[np.ndarray, "level"]:
    """Eliminate all states except the first `keep` from a matrix, in place, the last state first.

    Returns, for each eliminated state, the probability of leaving it when it is eliminated.
    """
    size = len(step)
    on = np.empty(size)
    for top in range(size, keep, -_BLOCK):
        low = max(keep, top - _BLOCK)
        for k in range(top - 1, low - 1, -1):
            on[k] = leaving[k] + step[k, :k].sum()
            share = step[:k, k] / on[k]
            step[low:k, :k] += share[low:, None] * step[k, :k]
            step[:low, low:k] += share[:low, None] * step[k, low:k]
            leaving[:k] += share * leaving[k]
        # Steps to the other states by way of the block.
        step[:low, :low] += (step[:low, low:top] / on[low:top]) @ step[low:top, :low]
    return on[keep:]
