"""Solvers for the matrix of a chain: repeated products or, if these are slow, a factorisation.

If a chain mixes or is absorbed fast, tens of products suffice, while the factors of its matrix are
not sparse. A slow chain, such as that of a robot between walls, has narrow passages, which keep the
factors sparse: a factorisation takes milliseconds, while 10,000 products would be necessary.

The matrix of a chain that hardly ever returns to a cell that it has left, such as that of drifters
that gather in gyres, is nearly triangular in the order of its strongly connected components. Its
factors are sparse, so it is factored without trying products first.

Matrices with more than 100,000 rows are solved by BiCGSTAB with a two-level preconditioner
(`TwoLevel`), in 60 bytes per entry. If it does not converge, the matrix is factored or, above half
a million rows, where the factors could exceed any memory, solved by products. The factors of a
chain that is unrolled over the phases of a tide are not sparse in any order, so `Cycle` solves it.

If a part of the chain is left once in 10^10 steps or less often, all these methods return wrong
answers with small residuals. Such chains are eliminated without subtractions, which takes some
seconds for 10^5 cells in a plane. So are all small chains.
"""

import contextlib
import dataclasses
import math
import warnings
from collections.abc import Callable

import numpy as np
import scipy.linalg
import scipy.sparse
from jaxtyping import Float, Int
from scipy.sparse import csgraph, linalg

from ...base.process import one_blas_thread
from ...mapping.batch import Batch
from .cycle import Cycle
from .elimination import Columns, Levels, eliminate
from .rounds import eliminated, most_products
from .two_level import TwoLevel


@dataclasses.dataclass(frozen=True)
class Limits:
    """Sizes of matrices and numbers of matrix products above which another method is used."""

    small: int = 200
    "Systems of equations with at most this many unknowns are solved by elimination."
    trial: int = 60
    "Number of products after which it is decided again whether to continue with products."
    worthwhile: int = 400
    "Number of products that take about as long as a factorisation."
    products: int = 50_000
    "Largest number of products."
    two_level: int = 100_000
    "A matrix with more rows is solved by BiCGSTAB with a two-level preconditioner."
    rough_steps: int = 60
    "Largest number of steps of BiCGSTAB with a two-level preconditioner."
    cycle: int = 20_000
    "A cycle with more rows is solved with GMRES."
    complete: int = 500_000
    "A matrix with more rows is not factored completely if BiCGSTAB does not converge."
    factored: int = 20_000_000
    "A matrix with more rows is never factored; products continue even if they are slow."
    dense: int = 12_000
    "A nearly full matrix with at most this many rows is factored as a dense matrix."
    elimination: float = 1e11
    "Largest number of multiplications of an elimination."


LIMITS = Limits()
# A factorisation is accepted if the bound on the relative error of the expected number of steps
# until the chain leaves is at most this number.
_ILL = 1e-7
# An approximate solution is accepted if no step is rarer than this; residuals hide rarer steps.
_HIDDEN = 1e-12
_HALF_ULP = 2.0**-53
# A multiplication in rounds takes as long as this many in levels.
_SLOWER = 1000
# Largest number of entries of the factors, in the order of components, per entry of the matrix.
_MAX_FILL = 10
# Part of the entries above which a matrix is nearly full: its factors are full.
_FULL = 0.1
# Largest number of approximate solutions, each for the residual of the sum of those before it.
_ROUNDS = 6
# The repeats end if the residual, relative to the solution, is at most the first number, rounding.
# Products follow if they end at more than a hundred times that, and at more than the second number
# relative to the right-hand side.
_ROUNDING, _ENOUGH = 4e-16, 1e-10


def solve_signed(
    solve: Callable[[Columns], Columns], right: Float[np.ndarray, "rows"]
) -> Float[np.ndarray, "rows"]:
    """Solve linear equations for `right` by a function that expects columns of numbers from 0."""
    signs = [sign for sign in (1, -1) if (sign * right).max(initial=0) > 0]
    return np.asarray(solve(np.maximum(np.outer(right, signs), 0)) @ signs)


def solve_transient(
    step: scipy.sparse.csr_array,
    leaving: Float[np.ndarray, "rows"],
    right: Columns,
    *,
    adjoint: bool = False,
    by_entries: bool = False,
) -> tuple[Columns, int, float]:
    """Solve `x = right + Q x`, or `x = right + Q' x` if `adjoint`, where `Q` is `step`.

    `leaving` contains the probability of a step from each row out of all rows, with all its digits.
    The powers of `Q` must tend to 0, and `right` must not be negative. With `by_entries`, larger
    systems too are eliminated, if possible, so that the smallest entries have their digits.

    **Returns:** the solution; the number of matrix products; and a bound on the relative error of
    every entry, or `inf` if the residual must tell the error.
    """
    if not right.any():
        return np.zeros_like(right), 0, 0.0
    if step.shape[0] <= LIMITS.small:
        exact = eliminate(step, leaving, right, adjoint=adjoint)
        return exact[0], 0, exact[1]
    if by_entries and (slow := eliminate_unless_large(step, leaving, right, adjoint)) is not None:
        return slow[0], 0, slow[1]
    matrix = step.T.tocsr() if adjoint else step
    order, products, total = _by_components(step), 0, np.zeros_like(right)
    if order is None:
        total, products, done = _by_products(matrix, right)
        if done:
            return total, products, math.inf
    x, more, sure = factor_and_solve(step, leaving, right, order, adjoint)
    if not sure and (slow := eliminate_unless_large(step, leaving, right, adjoint)) is not None:
        return slow[0], products + more, slow[1]
    # The sum of the products is the best answer where the matrix cannot be factored.
    return total if x is None else x, products + more, math.inf


def residual_bound(step: scipy.sparse.csr_array, right: Columns, x: Columns) -> Columns:
    """Bound the residual `right + Q x - x` of each equation, including its rounding."""
    terms = (np.diff(step.indptr) + 4)[:, None]
    rounding = terms * _HALF_ULP * (np.abs(x) + step @ np.abs(x) + np.abs(right))
    return np.abs(right + step @ x - x) + rounding


def imprecision(
    step: scipy.sparse.csr_array, leaving: Float[np.ndarray, "rows"]
) -> Float[np.ndarray, "rows"]:
    """Return by how much the probabilities of each row fail to sum to 1."""
    return np.abs(1 - step @ np.ones(step.shape[1]) - leaving)


@np.errstate(all="ignore")
def factor_and_solve(
    step: scipy.sparse.csr_array,
    leaving: Float[np.ndarray, "rows"],
    right: Columns,
    order: Int[np.ndarray, "rows"] | None,
    adjoint: bool,
) -> tuple[Columns | None, int, bool]:
    """Solve the equation of [`solve_transient`][] by factoring, or by iterating if `Q` is large.

    `order` is `None` or an order of rows in which the factors are sparse. Returns the solution, or
    `None` if the matrix is singular up to rounding; the number of products; and whether most digits
    are reliable.
    """
    products = 0
    ones = np.ones((step.shape[0], 1))
    try:
        if order is None:
            matrix = step.T.tocsr() if adjoint else step
            if (solver := _rough_solver(matrix)) is not None:
                x, products = _solve_large(matrix, right, solver)
                if x is not None:
                    # An approximate solution leaves mass in a part that only rare steps leave.
                    steps = np.append(step.data, leaving)
                    return x, products, bool(steps[steps > 0].min(initial=1.0) > _HIDDEN)
        solve = factored(step, order)
        x, steps = solve(right, adjoint), solve(ones)
    except RuntimeError:
        return None, products, False
    left = residual_bound(step, ones, steps)[:, 0] + imprecision(step, leaving) * np.abs(
        steps[:, 0]
    )
    return x, products, bool(left.max() <= _ILL)


def eliminate_unless_large(
    step: scipy.sparse.csr_array,
    leaving: Float[np.ndarray, "rows"],
    right: Columns,
    adjoint: bool,
) -> tuple[Columns, float] | None:
    """Solve with [`eliminate`][], or return `None` if it would take too many multiplications.

    A chain whose levels are wide, such as one with a hub, is eliminated in rounds if that is short.
    """
    levels = Levels.of(step)
    if levels.work > _SLOWER * most_products(step.nnz):
        rows, way = step.shape[0], step.tocoo()
        (last,) = np.nonzero(leaving)
        tail, head = np.append(way.row, last), np.append(way.col, np.full(last.size, rows))
        chance = np.append(way.data, leaving[last])[:, None]
        batch = Batch(rows, tail.astype(np.int64), head.astype(np.int64), chance)
        with contextlib.suppress(RuntimeError):
            x, error = eliminated(batch, np.ones(rows, bool), right, adjoint=adjoint)
            if np.isfinite(x).all():
                return x, float(error.max())
    if levels.work > LIMITS.elimination:
        return None
    return eliminate(step, leaving, right, levels, adjoint=adjoint)


def _by_components(step: scipy.sparse.csr_array) -> Int[np.ndarray, "rows"] | None:
    """Order rows by strongly connected components, or return `None` if these are too large."""
    _, label = csgraph.connected_components(step, connection="strong")
    # If a row has a step into a component, the row of the factor has at most all its entries.
    most = np.bincount(label)[label[step.indices]].sum()
    return np.argsort(label, kind="stable") if most <= _MAX_FILL * step.nnz else None


def _by_products(matrix: scipy.sparse.csr_array, right: Columns) -> tuple[Columns, int, bool]:
    """Sum `matrix^n right` over n; return the sum, the number of products, and if it converged."""
    total, term = right.copy(), right
    first = float(right.max())
    goal = 1e-16 * first
    for products in range(1, LIMITS.products + 1):
        term = matrix @ term
        total += term
        largest = float(term.max())
        if largest <= goal:
            break
        if factor_instead(matrix.shape[0], products, first, largest, goal):
            return total, products, False
    return total, products, True


def factored(
    matrix: scipy.sparse.csr_array, order: Int[np.ndarray, "rows"] | None = None
) -> Callable[..., Columns]:
    """Factor `I - matrix`, and return a function that solves with it or with its transpose.

    **Raises:** `RuntimeError` if the matrix is singular up to rounding.
    """
    rows = matrix.shape[0]
    system = (scipy.sparse.eye_array(rows, format="csr") - matrix).tocsr()
    back: Callable[[Columns, str], Columns]
    if rows <= LIMITS.dense and matrix.nnz > _FULL * rows**2:
        order = np.arange(rows)
        with one_blas_thread(), warnings.catch_warnings(action="ignore"):
            dense = scipy.linalg.lu_factor(system.toarray(), overwrite_a=True, check_finite=False)
        if not np.diag(dense[0]).all():
            raise RuntimeError("the matrix is singular up to rounding")

        def back(right: Columns, form: str) -> Columns:
            return scipy.linalg.lu_solve(dense, right, int(form == "T"), check_finite=False)

    elif order is None:
        order = np.arange(rows)
        back = linalg.splu(system.tocsc()).solve
    else:
        # Columns are not grouped, because the factors have no dense blocks.
        back = linalg.splu(
            system[order][:, order].tocsc(),
            permc_spec="NATURAL",
            diag_pivot_thresh=0.0,
            relax=1,
            panel_size=1,
        ).solve

    def solve(right: Columns, adjoint: bool = False) -> Columns:
        step, form = (matrix.T, "T") if adjoint else (matrix, "N")
        total = np.empty_like(right)
        total[order] = back(right[order], form)
        # One correction makes the residual as small as the rounding of a product.
        total[order] += back((right - (total - step @ total))[order], form)
        return total

    return solve


# A function that solves `x = right + matrix x` approximately. Returns the number of products too.
_RoughSolver = Callable[[Float[np.ndarray, "rows"]], tuple[Float[np.ndarray, "rows"], int]]


def _rough_solver(matrix: scipy.sparse.csr_array) -> _RoughSolver | None:
    """Return an approximate solver of a large matrix, or `None` to factor the matrix completely."""
    rows = matrix.shape[0]
    if rows > LIMITS.cycle and (cycle := Cycle.of(matrix)) is not None:
        return cycle
    return TwoLevel.of(matrix, LIMITS.rough_steps) if rows > LIMITS.two_level else None


def _solve_large(
    matrix: scipy.sparse.csr_array, right: Columns, solver: _RoughSolver
) -> tuple[Columns | None, int]:
    """Refine an approximate solution or, if that fails, continue with repeated products.

    Returns the solution, or `None` if the matrix should be factored completely instead, and the
    number of matrix products.
    """
    products, columns = 0, []
    cycle = isinstance(solver, Cycle)
    # Products do not help for a cycle, because each moves by only one block.
    most = 0 if cycle else LIMITS.products
    for wanted in right.T:
        x, left = np.zeros_like(wanted), wanted
        for _ in range(_ROUNDS):
            change, more = solver(left)
            products += more
            now = wanted - (x + change - matrix @ (x + change))
            better = np.abs(now).max() < np.abs(left).max() / 2
            if better:
                x, left = x + change, now
            if not better or np.abs(left).max() <= _ROUNDING * np.abs(x).max():
                break
        goal = max(_ENOUGH * wanted.max(), 100 * _ROUNDING * np.abs(x).max())
        if np.abs(left).max() > goal and not cycle and matrix.shape[0] <= LIMITS.complete:
            return None, products
        while np.abs(left).max() > goal and products < most:
            x += left
            left = matrix @ left
            products += 1
        columns.append(x)
    return np.stack(columns, axis=1), products


def factor_instead(rows: int, products: int, first: float, now: float, goal: float) -> bool:
    """Decide whether a factorisation will be faster than more products.

    The residual fell from `first` to `now` in these `products`, and must fall to `goal`.
    """
    if products % LIMITS.trial or rows > LIMITS.factored:
        return False
    if now >= first:
        return True
    return products * math.log(goal / first) / math.log(now / first) > LIMITS.worthwhile
