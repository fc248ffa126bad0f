import dataclasses
import itertools

import numpy as np
import scipy.sparse
from jaxtyping import Float, Int
from scipy.sparse import linalg

from ...base.process import one_blas_thread


# Largest number of blocks of a cycle, and largest share of steps that begin a new round.
_MAX_BLOCKS, _MAX_BACK = 10_000, 0.4
# Number of directions that GMRES keeps, largest number of their bytes, and number of restarts.
_DIRECTIONS, _MAX_BYTES, _ROUNDS = 300, 2**30, 4


@dataclasses.dataclass(frozen=True, eq=False)
class Cycle:
    """A chain whose states form blocks that are visited one after the other, round and round.

    Every step leads to a later block, except the steps that begin a new round. One sweep through
    the blocks, backwards, solves for a round; so the unknowns are only the values of the states
    that begin a round.
    """

    order: Int[np.ndarray, "rows"]
    "The states, block by block."
    bounds: Int[np.ndarray, "bounds"]
    "The first place of each block in `order`."
    rows: list[scipy.sparse.csr_array]
    "The steps from each block to states in this order."
    again: Int[np.ndarray, "first"]
    "The places of the states that begin a new round."

    @classmethod
    def of(cls, matrix: scipy.sparse.csr_array) -> "Cycle | None":
        """Find the cycle of a matrix whose states are in the order of its blocks, or in reverse
        order; return `None` if it is not a cycle."""
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
        """Solve `x = right + matrix x` by GMRES; return the number of products too.

        GMRES takes about half as many products as BiCGSTAB, and a product is expensive here.
        """
        wanted, none = right[self.order], np.zeros(right.size)
        products = 0

        def returns(value: Float[np.ndarray, "first"]) -> Float[np.ndarray, "first"]:
            nonlocal products
            products += 1
            return value - self._round(value, none)[self.again]

        shape = self.again.size, self.again.size
        system = linalg.LinearOperator(shape, returns, dtype=np.float64)
        begin = self._round(np.zeros(self.again.size), wanted)[self.again]
        kept = min(_DIRECTIONS, _MAX_BYTES // (8 * max(1, self.again.size)), self.again.size)
        with one_blas_thread():
            value, _ = linalg.gmres(system, begin, rtol=1e-8, restart=kept, maxiter=_ROUNDS)
        x = np.empty_like(right)
        x[self.order] = self._round(value, wanted)
        return x, products

    def _round(
        self, again: Float[np.ndarray, "first"], right: Float[np.ndarray, "rows"]
    ) -> Float[np.ndarray, "rows"]:
        """Sweep backwards through a round, from the values at its end."""
        x = np.zeros_like(right)
        x[self.again] = again
        for block in range(len(self.rows) - 1, -1, -1):
            here = slice(self.bounds[block], self.bounds[block + 1])
            x[here] = right[here] + self.rows[block] @ x
        return x


def _bounds(after: Int[np.ndarray, "rows"]) -> Int[np.ndarray, "bounds"]:
    """Find the blocks, as long as possible, from the next state that each state leads to."""
    bounds, count = [0], after.size
    while bounds[-1] < count and len(bounds) <= _MAX_BLOCKS:
        bounds.append(_end(after, bounds[-1]))
    return np.array(bounds)


def _end(after: Int[np.ndarray, "rows"], begin: int) -> int:
    """Return the first state that a state from `begin` on leads to, or the end."""
    least, size, at = after.size, 1024, begin
    while at < least:
        least = min(least, int(after[at : at + size].min()))
        at, size = at + size, 2 * size
    return least
