import dataclasses
import functools
import itertools

import numpy as np
import scipy.sparse
from jaxtyping import Float, Int
from scipy.sparse import linalg

from ...base.process import one_blas_thread
from .two_level import aggregates


# Largest number of blocks of a cycle, and largest share of the steps that begin a new round.
_MAX_BLOCKS, _MAX_BACK = 10_000, 0.4
# Number of directions that GMRES keeps, largest number of their bytes, and number of restarts.
_DIRECTIONS, _MAX_BYTES, _ROUNDS = 300, 2**30, 4
# Mean number of states per aggregate.
_SIZE = 8
# If a matrix has on average more probabilities per row than the first number, those below the
# second number, as a share of their row, are dropped.
_MOST, _DROP = 64, 1e-2


@dataclasses.dataclass(frozen=True, eq=False)
class Cycle:
    """A chain whose states form blocks that it visits in a fixed order, again and again.

    Every step leads to a later block, except the steps that begin a new *round* through the blocks.
    One backward sweep through the blocks computes the values of all states from the values of the
    states that begin a round, which are the unknowns of GMRES.

    A sweep evens out the errors of neighbouring states, but hardly reduces their mean if the chain
    stays among them for many rounds, like a drifter in a closed eddy. So states that begin a round
    are joined in *aggregates* if their next steps lead to the same states. The preconditioner of
    GMRES factors a smaller chain, whose states are the aggregates and whose steps are rounds.
    """

    order: Int[np.ndarray, "rows"]
    "The states, block by block."
    bounds: Int[np.ndarray, "bounds"]
    "The index in `order` of the first state of each block; the last entry is the number of states."
    rows: list[scipy.sparse.csr_array]
    "For each block, the matrix of steps from its states to all states, both ordered as in `order`."
    again: Int[np.ndarray, "first"]
    "The indices in `order` of the states that begin a new round."

    @classmethod
    def of(cls, matrix: scipy.sparse.csr_array) -> "Cycle | None":
        """Find the blocks if states are sorted by block, forwards or backwards; else `None`."""
        count = matrix.shape[0]
        tail = np.repeat(np.arange(count), np.diff(matrix.indptr))
        later, sooner = (np.count_nonzero(f(matrix.indices, tail)) for f in (np.greater, np.less))
        for order, on in ((np.arange(count), later), (np.arange(count)[::-1], sooner)):
            if matrix.nnz - on > _MAX_BACK * matrix.nnz:
                continue
            turned = matrix[order][:, order].tocsr()
            row = np.repeat(np.arange(count), np.diff(turned.indptr))
            back = turned.indices <= row
            after = np.full(count, count)
            np.minimum.at(after, row[~back], turned.indices[~back])
            bounds = _bounds(after)
            if bounds.size > _MAX_BLOCKS:
                continue
            rows = [turned[a:b] for a, b in itertools.pairwise(bounds)]
            return cls(order, bounds, rows, np.unique(turned.indices[back]))
        return None

    def __call__(self, right: Float[np.ndarray, "rows"]) -> tuple[Float[np.ndarray, "rows"], int]:
        """Solve `x = right + matrix x` with GMRES.

        Returns the solution and the number of matrix products. GMRES takes about half as many of
        them as BiCGSTAB, and they are expensive here.

        **Raises:** `RuntimeError` if the chain between aggregates is singular up to rounding.
        """
        wanted, none = right[self.order], np.zeros(right.size)
        products = 0

        def left(value: Float[np.ndarray, "first"]) -> Float[np.ndarray, "first"]:
            nonlocal products
            products += 1
            return value - self._round(value, none)[self.again]

        def inverse(value: Float[np.ndarray, "first"]) -> Float[np.ndarray, "first"]:
            # Solve for the aggregates, and follow them for a round.
            aggregate, after, coarse = self._between
            return value + after @ coarse.solve(aggregate.T @ value)

        system, roughly = (
            linalg.LinearOperator((self.again.size,) * 2, f, dtype=np.float64)
            for f in (left, inverse)
        )
        begin = self._round(np.zeros(self.again.size), wanted)[self.again]
        kept = min(_DIRECTIONS, _MAX_BYTES // (8 * max(1, self.again.size)), self.again.size)
        with one_blas_thread():
            # If GMRES keeps a direction for each unknown, it needs no preconditioner.
            inner = roughly if self.again.size > kept else None
            value, _ = linalg.gmres(
                system, begin, rtol=1e-8, restart=kept, maxiter=_ROUNDS, M=inner
            )
        x = np.empty_like(right)
        x[self.order] = self._round(value, wanted)
        return x, products

    @functools.cached_property
    def _between(self) -> tuple[scipy.sparse.csr_array, scipy.sparse.csr_array, linalg.SuperLU]:
        """Build the chain between aggregates of the states that begin a round.

        **Returns:** the aggregate of each state, as a matrix `A` of 0 and 1; the probability `B` of
        being in each aggregate one round after a state; and the LU factors of `A' (A - B)`."""
        count = self.again.size
        first = scipy.sparse.vstack(self.rows, format="csr")[self.again]
        into, first.indices = np.unique(first.indices, return_inverse=True)
        size = count + into.size
        # In this graph, states that share an image are two steps apart.
        near = scipy.sparse.csr_array(
            (first.data, count + first.indices, np.pad(first.indptr, (0, into.size), "edge")),
            shape=(size, size),
        )
        aggregate = aggregates(near, states=count, size=_SIZE)
        place = np.arange(count), self.again
        pick = scipy.sparse.csr_array((np.ones(count), place), shape=(count, self.order.size))
        later = (pick.T @ aggregate).tocsr()
        # Each block and the earlier blocks lead only to states before these bounds.
        ends = [self.again[-1], *(rows.indices.max(initial=0) for rows in self.rows)]
        reach = np.maximum.accumulate(ends) + 1
        for block in range(len(self.rows) - 1, -1, -1):
            rows = self.rows[block]
            steps = (rows.data, rows.indices, rows.indptr)
            steps = scipy.sparse.csr_array(steps, shape=(rows.shape[0], later.shape[0]))
            before, rest = later[: self.bounds[block]], later[self.bounds[block + 1] : reach[block]]
            later = scipy.sparse.vstack([before, _thinned(steps @ later), rest], format="csr")
        after = later[self.again]
        return aggregate, after, linalg.splu((aggregate.T @ (aggregate - after)).tocsc())

    def _round(
        self, again: Float[np.ndarray, "first"], right: Float[np.ndarray, "rows"]
    ) -> Float[np.ndarray, "rows"]:
        """Sweep backward to solve `x = right + Q x`, from the values `again` where rounds begin."""
        x = np.zeros_like(right)
        x[self.again] = again
        for block in range(len(self.rows) - 1, -1, -1):
            here = slice(self.bounds[block], self.bounds[block + 1])
            x[here] = right[here] + self.rows[block] @ x
        return x


def _thinned(matrix: scipy.sparse.csr_array) -> scipy.sparse.csr_array:
    """Drop small entries of a matrix, and scale each row to its old sum.

    If the matrix has few entries, all are kept: a rare step may be the only one out of a part.
    """
    if matrix.nnz <= _MOST * matrix.shape[0]:
        return matrix
    whole = matrix.sum(axis=1)
    matrix.data[matrix.data < _DROP * np.repeat(whole, np.diff(matrix.indptr))] = 0
    matrix.eliminate_zeros()
    kept = matrix.sum(axis=1)
    factor = np.divide(whole, kept, out=np.zeros_like(whole), where=kept > 0)
    matrix.data *= np.repeat(factor, np.diff(matrix.indptr))
    return matrix


def _bounds(after: Int[np.ndarray, "rows"]) -> Int[np.ndarray, "bounds"]:
    """Divide states into maximal blocks; `after[i]` is the first later state that `i` leads to."""
    bounds, count = [0], after.size
    while bounds[-1] < count and len(bounds) <= _MAX_BLOCKS:
        bounds.append(_end(after, bounds[-1]))
    return np.array(bounds)


def _end(after: Int[np.ndarray, "rows"], begin: int) -> int:
    """Find the end of the block that begins at `begin`: the first later state that it leads to."""
    least, size, at = after.size, 1024, begin
    while at < least:
        least = min(least, int(after[at : at + size].min()))
        at, size = at + size, 2 * size
    return least
