import dataclasses
from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np
import scipy.linalg
import scipy.sparse
from jaxtyping import Float, Inexact, Int
from scipy.sparse import linalg

from ...base.process import one_blas_thread
from ...mapping import Chain, ChainSequence


_Columns: TypeAlias = Inexact[np.ndarray, "cells *columns"]

# If a matrix has at most this many rows, all its eigenvalues are computed.
_MAX_DENSE = 200
# Distance up to which eigenvalues are equal, and the tolerances of eigenvalues. The tolerance of a
# symmetric matrix is larger, because the error is the square of the residual of the eigenvector.
_SAME, _TOLERANCE, _SYMMETRIC_TOLERANCE = 1e-7, 1e-9, 1e-7
# Tolerance of the search for missed eigenvalues; vectors shorter than its square count as 0.
_ROUGH = 1e-4
# Weight of the square of imaginary parts in the search among eigenvalues with equal real parts.
_TILT = 0.1
_MAX_RESTARTS = 2000
# A matrix with at most this many rows, and branches per row, is factored. The shift of the inverse.
_MAX_FACTORED, _MAX_BRANCHES, _SHIFT = 100_000, 40, 1e-6
_SEED = 0


def steps_of(
    chain: Chain | ChainSequence, steps: int | None = None, start: int = 0
) -> tuple[Chain, ...]:
    """Return the chain of each step, by default of one step per phase from the phase `start`."""
    period = 1 if isinstance(chain, Chain) else chain.phases
    count = period if steps is None else steps
    if count < 1:
        raise ValueError(f"steps: expected 1 or more, got {steps}")
    if start < 0:
        raise ValueError(f"start: expected a phase, 0 or more, got {start}")
    phases = [(start + n) % period for n in range(count)]
    each = {n: chain if isinstance(chain, Chain) else chain.at(n) for n in set(phases)}
    return tuple(each[n] for n in phases)


@dataclasses.dataclass(frozen=True, eq=False)
class Window:
    """Several steps of a chain, or of consecutive chains, taken as one step.

    The product of the matrices of all steps is never computed, because it would not be sparse.
    """

    matrices: tuple[scipy.sparse.csr_array, ...]
    "The matrix of each step."

    @classmethod
    def of(cls, chain: Chain | ChainSequence, steps: int | None = None, start: int = 0) -> "Window":
        """Create the window of `steps` steps, by default one per phase, that begins at `start`."""
        return cls(tuple(one.to_scipy() for one in steps_of(chain, steps, start)))

    @property
    def cells(self) -> int:
        return self.matrices[0].shape[0]

    @property
    def matrix(self) -> scipy.sparse.csr_array | None:
        """The matrix of a window of one step; `None` for more steps."""
        return self.matrices[0] if len(self.matrices) == 1 else None

    def push(self, mass: _Columns) -> _Columns:
        """Compute the mass of each cell at the end of the window from the mass at its start."""
        for matrix in self.matrices:
            mass = matrix.T @ mass
        return mass

    def pull(self, value: _Columns) -> _Columns:
        """Compute, for each start cell, the expected value at the end of the window."""
        for matrix in reversed(self.matrices):
            value = matrix @ value
        return value


_Product = Callable[[Float[np.ndarray, "rows columns"]], Float[np.ndarray, "rows columns"]]


@dataclasses.dataclass(frozen=True, eq=False)
class Subspace:
    """The span of the eigenvectors whose eigenvalues have the largest real parts."""

    basis: Float[np.ndarray, "rows vectors"]
    "An orthonormal basis."
    block: Float[np.ndarray, "vectors vectors"]
    "The matrix, restricted to the subspace, in this basis; it has the leading eigenvalues."
    residual: float
    "The largest 2-norm of the part of a basis vector's image that is outside the subspace."
    products: int

    def above(self, least: float) -> Float[np.ndarray, "rows above"]:
        """Compute an orthonormal basis of the span of eigenvectors with eigenvalues above `least`.

        The leading eigenvector is always included.
        """
        values, vectors = np.linalg.eig(self.block)
        count = max(int(np.count_nonzero(values.real > least)), 1)
        if count == values.size:
            return self.basis
        return self.basis @ _real_basis(values, vectors, count)


@one_blas_thread()
def leading_subspace(
    product: _Product,
    rows: int,
    count: int,
    *,
    symmetric: bool,
    copies: bool = False,
    matrix: scipy.sparse.sparray | None = None,
) -> Subspace:
    """Compute the subspace of the leading eigenvalues with Arnoldi's or Lanczos's method.

    These methods find only one eigenvector of a multiple eigenvalue, such as 1 if several sets are
    closed. So the eigenvectors that were found are deflated, and the search is repeated until no
    leading eigenvalue is left.

    `product` is a function that multiplies the matrix by columns. The subspace has `count`
    dimensions, or one more to complete a conjugate pair. If `copies` is true, it also has the
    eigenvectors that were found of eigenvalues equal to the last one, or to its conjugate.

    `matrix` is the matrix itself, if it is known; no eigenvalue is above 1. If it is sparse, its
    eigenvalues near 1 are found by the inverse of `1 - matrix`, which separates them.
    """
    if rows <= max(_MAX_DENSE, 2 * count + 2):
        dense, products = product(np.eye(rows)), rows
        if symmetric:
            basis = np.linalg.eigh((dense + dense.T) / 2)[1][:, ::-1][:, :count]
        else:
            basis = _real_basis(*np.linalg.eig(dense), count, copies=copies)
    else:
        inverse = None
        if matrix is not None and rows <= _MAX_FACTORED and matrix.nnz <= _MAX_BRANCHES * rows:
            inverse = _inverse(matrix, symmetric)
        basis, products = _iterated(product, rows, count, inverse, symmetric=symmetric)
        if basis.shape[1] > count:
            within = np.linalg.eig(basis.T @ product(basis))
            basis = basis @ _real_basis(*within, count, copies=copies)
    image = product(basis)
    block = basis.T @ image
    left = np.linalg.norm(image - basis @ block, axis=0)
    return Subspace(basis, block, float(left.max()), products + basis.shape[1])


def _inverse(matrix: scipy.sparse.sparray, symmetric: bool) -> Callable[[np.ndarray], np.ndarray]:
    """Factor `1 + shift - matrix`, and return the product with its inverse."""
    shifted = (1 + _SHIFT) * scipy.sparse.eye_array(matrix.shape[0]) - matrix
    # The shifted matrix is positive definite if it is symmetric, and needs no pivots.
    ways = {"diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}} if symmetric else {}
    order = "MMD_AT_PLUS_A" if symmetric else "COLAMD"
    solve: Any = linalg.splu(shifted.tocsc(), permc_spec=order, **ways).solve
    return solve


def _iterated(
    product: _Product,
    rows: int,
    count: int,
    inverse: Callable[[np.ndarray], np.ndarray] | None,
    *,
    symmetric: bool,
) -> tuple[Float[np.ndarray, "rows vectors"], int]:
    products, random = 0, np.random.default_rng(_SEED)
    basis = np.zeros((rows, 0))

    def across(vectors: np.ndarray) -> np.ndarray:
        """Multiply by the deflated matrix, in which vectors of the basis have the eigenvalue -1."""
        nonlocal products
        products += 1
        within = basis @ (basis.T @ vectors)
        image = product(vectors - within)
        return image - basis @ (basis.T @ image) - within

    def solved(vector: np.ndarray) -> np.ndarray:
        """Multiply by the inverse, in which vectors of the basis have the eigenvalue 0."""
        nonlocal products
        assert inverse is not None
        products += 1
        result = inverse(vector - basis @ (basis.T @ vector))
        return result - basis @ (basis.T @ result)

    solve, which = (linalg.eigsh, "LA") if symmetric else (linalg.eigs, "LR")
    fine = _SYMMETRIC_TOLERANCE if symmetric else _TOLERANCE

    def leading(
        wanted: int, tolerance: float, multiply: _Product = across
    ) -> tuple[np.ndarray, np.ndarray]:
        operator = linalg.LinearOperator(
            (rows, rows), lambda v: multiply(v.reshape(rows, 1)), matmat=multiply, dtype=np.float64
        )
        start, size = random.standard_normal(rows), min(rows, max(20, 3 * wanted))
        options = {"v0": start, "ncv": size, "tol": tolerance, "maxiter": _MAX_RESTARTS}
        # Of a symmetric matrix, whose eigenvalues are at most 1, the leading ones are nearest to 1.
        # Of another matrix these are only a beginning, because complex ones may lead.
        if inverse is not None and (symmetric or not basis.size):
            near = linalg.LinearOperator((rows, rows), solved, dtype=np.float64)
            values, vectors = solve(near, wanted, which="LA" if symmetric else "LM", **options)
            return 1 + _SHIFT - 1 / values, vectors
        return solve(operator, wanted, which=which, **options)

    basis, rest = _real_basis(*leading(count, fine), count), -np.inf
    for _ in range(count):
        least = np.linalg.eigvals(basis.T @ product(basis)).real.min() + _SAME
        # Arnoldi's method may return fewer vectors than it was asked for.
        found = basis.shape[1] >= count
        # With an inverse no eigenvalue is above 1, and a search among many copies of 1 is slow.
        if found and inverse is not None and least >= 1:
            break
        rest = leading(1, _ROUGH)[0].real.max()
        if found and rest <= least:
            break
        together = np.hstack([basis, _real_basis(*leading(1, fine), 1)])
        inner = np.linalg.eig(together.T @ product(together))
        basis = together @ _real_basis(*inner, count)
    if symmetric:
        return basis, products
    # Of the eigenvalues that tie with the last one, those with the largest modulus are needed.
    for _ in range(count):
        values = np.linalg.eigvals(basis.T @ product(basis))
        last = values[leading_order(values)][count - 1]
        # Eigenvalues with the real part of the first one, the spectral radius, are equal to it.
        if last.real >= values.real.max() - _SAME or rest <= last.real - 2 * _ROUGH:
            break

        def tilted(vectors: np.ndarray, level: float = last.real) -> np.ndarray:
            """Multiply by `A - tilt (A - level)^2`: the largest imaginary part of a tie leads."""
            moved = across(vectors)
            across_level = moved - level * vectors
            return moved - _TILT * (across(across_level) - level * across_level)

        try:
            more, vectors = leading(1, fine, tilted)
        except linalg.ArpackNoConvergence:
            break
        if more.real.max() <= last.real + _TILT * last.imag**2 + _SAME:
            break
        basis = np.hstack([basis, _real_basis(more, vectors, 1)])
    return basis, products


def leading_order(values: Inexact[np.ndarray, "values"]) -> Int[np.ndarray, "values"]:
    """Sort eigenvalues by descending real part, and those that tie by descending modulus.

    Real parts tie if they differ by at most 1e-7, so that rounding errors do not decide. Conjugate
    values are neighbours, with the positive imaginary part first.
    """
    by_real = np.argsort(-values.real, kind="stable")
    level = np.zeros(values.size, int)
    level[by_real[1:]] = np.cumsum(np.diff(values.real[by_real]) < -_SAME)
    # Copies of a pair are two pairs, each with both of its values.
    copy = np.tril(values == values[:, None], -1).sum(axis=1)
    imaginary = np.abs(values.imag)
    keys = (-values.imag, copy, -values.real, -imaginary, -np.abs(values), level)
    return np.lexsort(keys)


def _real_basis(
    values: np.ndarray, vectors: np.ndarray, count: int, *, copies: bool = False
) -> np.ndarray:
    """Return a real orthonormal basis of the span of the leading eigenvectors."""
    order = leading_order(values)
    if copies:
        upper = (values.real + 1j * np.abs(values.imag))[order]
        other = np.abs(upper[count:] - upper[count - 1]) > _SAME
        count += int(np.argmax(np.append(other, True)))
    chosen = vectors[:, order[:count]]
    # A complex eigenvector stands for its conjugate too.
    return scipy.linalg.orth(np.hstack([chosen.real, chosen.imag]), rcond=_ROUGH**2)
