import dataclasses

import numpy as np
import scipy.sparse
from jaxtyping import Float
from scipy.sparse import csgraph, linalg

from ...base.threads import one_blas_thread


# States to an aggregate, and more where there would be more aggregates than so many.
_SIZE, _MAX_AGGREGATES = 25, 50_000
# Entries of an incomplete factor are dropped below this part of their column, and there are no more
# than so many for one of the matrix; the second two are of the matrix between aggregates.
_DROP, _FILL = 1e-2, 5.0
_COARSE_DROP, _COARSE_FILL = 1e-3, 10.0
# Steps of BiCGSTAB, and the part of the right-hand side that it leaves.
_STEPS, _LEFT = 60, 1e-8
_SEED = 0


@dataclasses.dataclass(frozen=True, eq=False)
class TwoLevel:
    """A rough inverse of `I - Q` on two scales, with which BiCGSTAB solves.

    An incomplete factorisation settles what happens among near states: `I - Q` is an M-matrix,
    whose incomplete factors exist without pivoting (Meijerink & van der Vorst 1977). What is left
    then hardly differs between near states, since a chain that is slow spends long among some of
    them before it goes on, as a drifter does in an eddy. So near states are taken together, and
    what goes between such *aggregates* is again a chain, with few states (Takahashi 1975).
    """

    matrix: scipy.sparse.csr_array
    "Q."
    factor: linalg.SuperLU
    "Of `I - Q`."
    aggregate: scipy.sparse.csr_array
    "1 where a state, by its row, is in an aggregate, by its column."
    coarse: linalg.SuperLU
    "Of `I - Q` between aggregates."

    @classmethod
    def of(cls, matrix: scipy.sparse.csr_array) -> "TwoLevel":
        """Factor a matrix and that between aggregates.

        **Raises:** `RuntimeError` if one of them is singular to rounding.
        """
        identity = scipy.sparse.eye_array(matrix.shape[0], format="csr")
        system = (identity - matrix).tocsr()
        aggregate = _aggregates(matrix)
        between = aggregate.T @ (system @ aggregate)
        with one_blas_thread():
            # In their own order neighbours on a grid stay near each other; no row is exchanged.
            factor = linalg.spilu(
                system.tocsc(),
                drop_tol=_DROP,
                fill_factor=_FILL,
                permc_spec="NATURAL",
                diag_pivot_thresh=0.0,
            )
            coarse = linalg.spilu(between.tocsc(), _COARSE_DROP, _COARSE_FILL)
        return cls(matrix, factor, aggregate, coarse)

    def __call__(self, right: Float[np.ndarray, "rows"]) -> tuple[Float[np.ndarray, "rows"], int]:
        """Solve `x = right + Q x` roughly; gives the products beside."""
        products = 0

        def left(x: Float[np.ndarray, "rows"]) -> Float[np.ndarray, "rows"]:
            nonlocal products
            products += 1
            return x - self.matrix @ x

        def inverse(value: Float[np.ndarray, "rows"]) -> Float[np.ndarray, "rows"]:
            x = self.aggregate @ self.coarse.solve(self.aggregate.T @ value)
            return x + self.factor.solve(value - left(x))

        system, roughly = (
            linalg.LinearOperator(self.matrix.shape, f, dtype=np.float64) for f in (left, inverse)
        )
        with one_blas_thread():
            found, _ = linalg.bicgstab(system, right, rtol=_LEFT, maxiter=_STEPS, M=roughly)
        return found, products


def _aggregates(matrix: scipy.sparse.csr_array) -> scipy.sparse.csr_array:
    """Each state with the nearest of some that are drawn; one that none is near is in no aggregate.

    A step that is taken once in n times, there or back, is n long.
    """
    rows = matrix.shape[0]
    count = min(-(-rows // _SIZE), _MAX_AGGREGATES)
    # Drawn, since states at even distances of a grid would lie in columns.
    middles = np.sort(np.random.default_rng(_SEED).choice(rows, count, replace=False))
    length = (matrix + matrix.T).tocsr()
    length.data = 1 / length.data
    nearest = csgraph.dijkstra(length, indices=middles, min_only=True, return_predecessors=True)[2]
    (member,) = np.nonzero(nearest >= 0)
    place = member, np.searchsorted(middles, nearest[member])
    return scipy.sparse.csr_array((np.ones(member.size), place), shape=(rows, count))
