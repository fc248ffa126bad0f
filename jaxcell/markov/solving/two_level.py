import dataclasses

import numpy as np
import scipy.sparse
from jaxtyping import Float
from scipy.sparse import csgraph, linalg

from ...base.process import one_blas_thread


# Mean number of states per aggregate, unless there would be more aggregates than the second number.
_SIZE, _MAX_AGGREGATES = 25, 50_000
# An entry of an incomplete factor is dropped if it is less than this part of its column; largest
# number of entries per entry of the matrix. The second line is for the matrix between aggregates.
_DROP, _FILL = 1e-2, 5.0
_COARSE_DROP, _COARSE_FILL = 1e-3, 10.0
# Residual at which BiCGSTAB ends, relative to the right-hand side.
_LEFT = 1e-8
_SEED = 0


@dataclasses.dataclass(frozen=True, eq=False)
class TwoLevel:
    """An approximate solver of equations with `I - Q`: BiCGSTAB with a two-level preconditioner.

    An incomplete factorisation evens out the errors of neighbouring states. It needs no pivoting,
    because `I - Q` is an M-matrix (Meijerink & van der Vorst 1977). The remaining error is nearly
    equal in neighbouring states, because a slow chain stays among a few states for long before it
    moves on, like a drifter in an eddy. So such states are joined in *aggregates*, and the chain
    between aggregates has few states (Takahashi 1975).
    """

    matrix: scipy.sparse.csr_array
    "The matrix `Q`."
    factor: linalg.SuperLU
    "An incomplete factorisation of `I - Q`."
    aggregate: scipy.sparse.csr_array
    "A matrix with an entry 1 if the state of the row is in the aggregate of the column."
    coarse: linalg.SuperLU
    "An incomplete factorisation of `A' (I - Q) A`, where `A` is the matrix `aggregate`."
    steps: int
    "Largest number of steps of BiCGSTAB."

    @classmethod
    def of(cls, matrix: scipy.sparse.csr_array, steps: int) -> "TwoLevel":
        """Factor `I - Q`, and the matrix between aggregates.

        **Raises:** `RuntimeError` if a matrix is singular up to rounding.
        """
        identity = scipy.sparse.eye_array(matrix.shape[0], format="csr")
        system = (identity - matrix).tocsr()
        aggregate = aggregates(matrix)
        between = aggregate.T @ (system @ aggregate)
        with one_blas_thread():
            # In natural order, neighbours on a grid stay near each other; rows are not exchanged.
            factor = linalg.spilu(
                system.tocsc(),
                drop_tol=_DROP,
                fill_factor=_FILL,
                permc_spec="NATURAL",
                diag_pivot_thresh=0.0,
            )
            coarse = linalg.spilu(between.tocsc(), _COARSE_DROP, _COARSE_FILL)
        return cls(matrix, factor, aggregate, coarse, steps)

    def __call__(self, right: Float[np.ndarray, "rows"]) -> tuple[Float[np.ndarray, "rows"], int]:
        """Solve `x = right + Q x` approximately; return the solution and the number of products."""
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
            x, _ = linalg.bicgstab(system, right, rtol=_LEFT, maxiter=self.steps, M=roughly)
        return x, products


def aggregates(
    matrix: scipy.sparse.csr_array, *, states: int | None = None, size: int = _SIZE
) -> scipy.sparse.csr_array:
    """Join states in aggregates: each state joins the nearest of some randomly chosen states.

    The length of a step, in either direction, is the inverse of its probability. A state that is
    not connected to a chosen state is in no aggregate.

    Only the first `states` states are assigned, by default all. `size` is the mean number of states
    per aggregate. Returns a matrix with an entry 1 if the state of the row is in the aggregate of
    the column.
    """
    rows = states or matrix.shape[0]
    count = min(-(-rows // size), _MAX_AGGREGATES)
    # Middles are random, because states at equal distances of a grid would lie in columns.
    middles = np.sort(np.random.default_rng(_SEED).choice(rows, count, replace=False))
    length = (matrix + matrix.T).tocsr()
    length.data = 1 / length.data
    nearest = csgraph.dijkstra(length, indices=middles, min_only=True, return_predecessors=True)[2]
    (member,) = np.nonzero(nearest[:rows] >= 0)
    place = member, np.searchsorted(middles, nearest[member])
    return scipy.sparse.csr_array((np.ones(member.size), place), shape=(rows, count))
