import dataclasses
from collections.abc import Callable

import numpy as np
import scipy.linalg
import scipy.sparse
from jaxtyping import Float, Inexact
from scipy.sparse import linalg

from ...base.threads import one_blas_thread
from ...mapping import Chain, ChainSequence


# Of matrices with fewer rows all eigenvalues are computed.
_MAX_DENSE = 200
# How near to another eigenvalue one counts as it, and the tolerance of those that are found. Of a
# symmetric matrix an eigenvalue is as near as the square of what its vector leaves.
_SAME, _TOLERANCE, _SYMMETRIC_TOLERANCE = 1e-7, 1e-9, 1e-7
# The tolerance that is enough to see whether there are more, and what counts as no direction.
_ROUGH = 1e-4
_MAX_RESTARTS = 2000
_SEED = 0


@dataclasses.dataclass(frozen=True, eq=False)
class Window:
    """Some steps of a chain, or of chains that follow on one another, taken as one.

    Its matrix is their product, which fills up and is never made.
    """

    matrices: tuple[scipy.sparse.csr_array, ...]
    "One for each step."

    @classmethod
    def of(cls, chain: Chain | ChainSequence, steps: int | None = None, start: int = 0) -> "Window":
        """The steps from a phase on.

        **Arguments:**

        - `chain`: the chain, or those that follow on one another.
        - `steps`: how many; by default one for each phase.
        - `start`: the phase.

        **Raises:** `ValueError` for less than one step.
        """
        period = 1 if isinstance(chain, Chain) else chain.phases
        count = period if steps is None else steps
        if count < 1:
            raise ValueError(f"steps: expected 1 or more, got {steps}")
        phases = [(start + n) % period for n in range(count)]
        matrices = {
            phase: (chain if isinstance(chain, Chain) else chain.at(phase)).to_scipy()
            for phase in set(phases)
        }
        return cls(tuple(matrices[phase] for phase in phases))

    @property
    def cells(self) -> int:
        """Number of cells."""
        return self.matrices[0].shape[0]

    def push(
        self, mass: Inexact[np.ndarray, "cells *columns"]
    ) -> Inexact[np.ndarray, "cells *columns"]:
        """Where mass is at the end; what it lacks has gone to the sink."""
        for matrix in self.matrices:
            mass = matrix.T @ mass
        return mass

    def pull(
        self, value: Inexact[np.ndarray, "cells *columns"]
    ) -> Inexact[np.ndarray, "cells *columns"]:
        """The expected values at the end; the sink counts as 0."""
        for matrix in reversed(self.matrices):
            value = matrix @ value
        return value


_Product = Callable[[Float[np.ndarray, "rows columns"]], Float[np.ndarray, "rows columns"]]


@dataclasses.dataclass(frozen=True, eq=False)
class Subspace:
    """What the eigenvectors of the leading eigenvalues span, those with the largest real parts."""

    basis: Float[np.ndarray, "rows vectors"]
    "Orthonormal."
    block: Float[np.ndarray, "vectors vectors"]
    "The matrix within it, whose eigenvalues are the leading ones."
    residual: float
    "The largest 2-norm of what a vector of the basis leaves the subspace by."
    products: int

    def above(self, least: float) -> Float[np.ndarray, "rows some"]:
        """Compute an orthonormal basis of what the eigenvectors with larger values span.

        The leading eigenvector is always one of them.
        """
        values, vectors = np.linalg.eig(self.block)
        count = max(int(np.count_nonzero(values.real > least)), 1)
        if count == values.size:
            return self.basis
        return self.basis @ _real_basis(values, vectors, count)


@one_blas_thread()
def leading_subspace(product: _Product, rows: int, count: int, *, symmetric: bool) -> Subspace:
    """The subspace of the leading eigenvalues of a matrix, by the method of Arnoldi or Lanczos.

    From one vector these methods see one eigenvector of an eigenvalue that has several, as 1 has
    where several sets are closed. So what was found is taken out and the rest is looked at again,
    until it has no eigenvalue that belongs to the leading ones.

    **Arguments:**

    - `product`: the matrix times some columns.
    - `rows`: of the matrix.
    - `count`: how many eigenvalues; of two that are conjugate both are taken.
    - `symmetric`: whether the matrix is.

    **Returns:** [`Subspace`][].

    **Raises:** `RuntimeError` if the eigenvalues do not converge.
    """
    if rows <= max(_MAX_DENSE, 2 * count + 2):
        matrix = product(np.eye(rows))
        basis, products = _dense(matrix, count, symmetric=symmetric), rows
    else:
        basis, products = _iterated(product, rows, count, symmetric=symmetric)
    image = product(basis)
    block = basis.T @ image
    left = np.linalg.norm(image - basis @ block, axis=0)
    return Subspace(basis, block, float(left.max()), products + basis.shape[1])


def _dense(
    matrix: Float[np.ndarray, "rows rows"], count: int, *, symmetric: bool
) -> Float[np.ndarray, "rows vectors"]:
    if symmetric:
        return np.linalg.eigh((matrix + matrix.T) / 2)[1][:, ::-1][:, :count]
    return _real_basis(*np.linalg.eig(matrix), count)


def _iterated(
    product: _Product, rows: int, count: int, *, symmetric: bool
) -> tuple[Float[np.ndarray, "rows vectors"], int]:
    products, random = 0, np.random.default_rng(_SEED)
    basis = np.zeros((rows, 0))

    def across(vectors: np.ndarray) -> np.ndarray:
        """The product in what is orthogonal to the basis, whose vectors have the eigenvalue -1."""
        nonlocal products
        products += 1
        within = basis @ (basis.T @ vectors)
        image = product(vectors - within)
        return image - basis @ (basis.T @ image) - within

    operator = linalg.LinearOperator(
        (rows, rows), lambda v: across(v.reshape(rows, 1)), matmat=across, dtype=np.float64
    )
    solve, which = (linalg.eigsh, "LA") if symmetric else (linalg.eigs, "LR")
    fine = _SYMMETRIC_TOLERANCE if symmetric else _TOLERANCE

    def leading(wanted: int, tolerance: float) -> tuple[np.ndarray, np.ndarray]:
        start, size = random.standard_normal(rows), min(rows, max(20, 3 * wanted))
        return solve(
            operator, wanted, v0=start, which=which, ncv=size, tol=tolerance, maxiter=_MAX_RESTARTS
        )

    basis = _real_basis(*leading(count, fine), count)
    for _ in range(count):
        least = np.linalg.eigvals(basis.T @ product(basis)).real.min() + _SAME
        if leading(1, _ROUGH)[0].real.max() <= least:
            break
        together = np.hstack([basis, _real_basis(*leading(1, fine), 1)])
        inner = np.linalg.eig(together.T @ product(together))
        basis = together @ _real_basis(*inner, count)
    return basis, products


def _real_basis(values: np.ndarray, vectors: np.ndarray, count: int) -> np.ndarray:
    """An orthonormal basis of what the leading eigenvectors span, in real numbers."""
    chosen = vectors[:, np.argsort(-values.real, kind="stable")[:count]]
    # One that is not real stands for its conjugate as well.
    return scipy.linalg.orth(np.hstack([chosen.real, chosen.imag]), rcond=_ROUGH**2)
