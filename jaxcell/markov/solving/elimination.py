import dataclasses

import numpy as np
import scipy.linalg
import scipy.sparse
from jaxtyping import Float, Int
from scipy.sparse import csgraph

from ...base.threads import one_blas_thread


# States that are taken out together, by one product of matrices.
_BLOCK = 16
# At most this many states are on one level: each level costs as much as many states.
_FEW = 400


@dataclasses.dataclass(frozen=True, eq=False)
class Levels:
    """States by their distance from one of them: steps lead to the same level or the next ones.

    So states of one level can be taken out with a look at the level before it only.
    """

    order: Int[np.ndarray, "rows"]
    "The states, level by level."
    bounds: Int[np.ndarray, "bounds"]
    "Where each level begins in them."

    @classmethod
    def of(cls, step: scipy.sparse.csr_array) -> "Levels":
        """The levels of a matrix, from a state that is far from others."""
        if step.shape[0] <= _FEW:
            return cls(np.arange(step.shape[0]), np.array([0, step.shape[0]]))
        graph = ((step + step.T) != 0).astype(np.int8).tocsr()
        _, part = csgraph.connected_components(graph, directed=False)
        level = np.zeros(step.shape[0])
        for _ in range(2):
            # In each connected part, from the state that is farthest from another.
            order = np.lexsort((-level, part))
            roots = order[np.unique(part[order], return_index=True)[1]]
            level = csgraph.dijkstra(graph, unweighted=True, indices=roots, min_only=True)
        bounds = np.cumsum([0, *np.bincount(level.astype(int))])
        return cls(np.argsort(level, kind="stable"), bounds)

    @property
    def work(self) -> float:
        """About how many multiplications an elimination takes."""
        size = np.diff(self.bounds).astype(float)
        before = np.concatenate([[0.0], size[:-1]])
        return float((size * (size + before) ** 2).sum())


@one_blas_thread()
def eliminate(
    step: scipy.sparse.csr_array,
    leaving: Float[np.ndarray, "rows"],
    right: Float[np.ndarray, "rows columns"],
    levels: Levels | None = None,
    *,
    adjoint: bool = False,
) -> Float[np.ndarray, "rows columns"]:
    """Solve `x = right + Q x`, or `x = right + Q' x`, without a subtraction.

    States are taken out one after the other, as Grassmann, Taksar and Heyman (1985) do: what a
    state does not keep is summed from where it goes, not subtracted from 1. So every number has
    nearly all its digits, even for a chain that leaves its cells once in 10^20 steps, where other
    factorisations give noise. It goes level by level, the last first, in dense blocks: among the
    cells of a plane, with their number times the square of the width of the plane in cells.

    **Arguments:**

    - `step`: the matrix Q, with nothing negative.
    - `leaving`: the probability of leaving from each row, which 1 less its sum would give without
        its digits.
    - `right`: what is added, not negative.
    - `levels`: those of the matrix, where they are known.
    - `adjoint`: whether to solve with the transposed matrix.
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
            # The level itself, with what goes by way of the levels that are taken out.
            front[keep:, keep:] = inner
        on = _take_out(front, leaving[before:last], keep)
        factors.append(_Factor.of(slice(before, first), slice(first, last), front, on))
        inner = front[:keep, :keep].copy()
    for factor in factors:
        factor.inward(x, adjoint)
    for factor in reversed(factors):
        factor.outward(x, adjoint)
    found = np.empty_like(x)
    found[order] = x
    return found


@dataclasses.dataclass(frozen=True, eq=False)
class _Factor:
    """A level that is taken out: there `I - Q` is an upper triangle times a lower one."""

    before: slice
    here: slice
    triangles: Float[np.ndarray, "level level"]
    "Both of them; the upper one has ones on its diagonal, which are left out."
    into: Float[np.ndarray, "before level"]
    back: Float[np.ndarray, "level before"]

    @classmethod
    def of(cls, before: slice, here: slice, front: np.ndarray, on: np.ndarray) -> "_Factor":
        keep = len(front) - on.size
        inside = front[keep:, keep:]
        triangles = -np.where(np.tri(on.size, dtype=bool), inside, inside / on)
        np.fill_diagonal(triangles, on)
        return cls(before, here, triangles, front[:keep, keep:] / on, front[keep:, :keep].copy())

    def inward(self, x: Float[np.ndarray, "rows columns"], adjoint: bool) -> None:
        x[self.here] = self._solve(x[self.here], lower=adjoint, adjoint=adjoint)
        x[self.before] += (self.back.T if adjoint else self.into) @ x[self.here]

    def outward(self, x: Float[np.ndarray, "rows columns"], adjoint: bool) -> None:
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
    """Take all states but the first out of a matrix, in place, the last one first."""
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
        # What goes on to the others by way of the block.
        step[:low, :low] += (step[:low, low:top] / on[low:top]) @ step[low:top, :low]
    return on[keep:]
