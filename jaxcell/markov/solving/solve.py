"""Solving with the matrix of a chain: products first, and a factorisation if they do not settle it.

A chain that mixes or is absorbed fast is settled by some tens of products, while a factorisation of
its matrix fills up: with 10 random images a cell and 6,000 cells, 2 ms against 9 s. A chain that is
slow, such as a robot between its walls or a drift on a plane, is held back by narrow passages; they
are what keeps a factorisation sparse, and it takes milliseconds where products would go on for
10,000 rounds. Each does what the other cannot.

A chain that hardly ever comes back to a cell that it has left, as drifters on water that goes to
the middles of its gyres, is all but a triangle in the order of its strong components. There a
factorisation does not fill up, and no products are tried.

Above 100,000 rows BiCGSTAB does it on two levels: with an incomplete factorisation, which takes at
most 60 bytes an entry of the matrix, and that of a chain of some ten thousand states. Where they do
not settle it a complete one does, or products above half a million rows, where it could take any
amount of memory.

A chain that is unrolled over the phases of a tide fills up however it is factored. It is a *cycle*
of blocks of states, and by sweeps through all its blocks GMRES works on one of them.

A part that is left once in 10^10 steps or less often is beyond all of these: their residuals are
small and their answers noise. Parts of that kind are eliminated without subtractions, which takes
some seconds for 10^5 cells of a plane.
"""

import math
from collections.abc import Callable

import numpy as np
import scipy.sparse
from jaxtyping import Float, Int
from scipy.sparse import csgraph, linalg

from .cycle import Cycle
from .elimination import Levels, eliminate
from .two_level import TwoLevel


# Products after which it is judged whether products will do.
_TRIAL = 60
# Products that cost about as much as a factorisation.
_WORTHWHILE = 400
# A matrix with more rows is solved on two levels, with more than the second number only so; one
# that is a cycle, with more than the third, is not factored.
_SMALLEST_TWO_LEVEL, _LARGEST_COMPLETE, _LARGEST_FACTORED_CYCLE = 100_000, 500_000, 20_000
# A matrix with more rows is not factored at all; products go on instead.
LARGEST_FACTOR = 20_000_000
MAX_PRODUCTS = 50_000
# The probabilities of all ways out of a part sum to 1. Where a factorisation misses that by more,
# and that takes no more multiplications than so many, the matrix is eliminated.
_ILL, _LARGEST_ELIMINATION = 1e-8, 1e11
# Rarer steps hide in the residual of a rough solve.
_HIDDEN = 1e-12
# Rows that sum to 1 but for rounding.
_CLOSED = 1e-12
# Entries of a complete factor in the order of components, for one of the matrix.
_MAX_FILL = 10
# A rough solve begins anew so often, each time on the residual.
_ROUNDS = 6
# It ends when no more than this part of the solution is left, which is its rounding. Products
# go on where it leaves a hundred times that and this part of the right-hand side.
_ROUNDING, _ENOUGH = 4e-16, 1e-10


def solve_transient(
    step: scipy.sparse.csr_array,
    right: Float[np.ndarray, "rows columns"],
    *,
    adjoint: bool = False,
) -> tuple[Float[np.ndarray, "rows columns"], int]:
    """Solve `x = right + Q x`, or `x = right + Q' x`, for a matrix whose powers tend to 0.

    **Arguments:**

    - `step`: the matrix Q.
    - `right`: what is added, not negative.
    - `adjoint`: whether to solve with the transposed matrix.

    **Returns:** the solution and the number of products.
    """
    if not right.any():
        return np.zeros_like(right), 0
    matrix = step.T.tocsr() if adjoint else step
    order, products, total = _by_components(step), 0, np.zeros_like(right)
    if order is None:
        total, products, done = _by_products(matrix, right)
        if done:
            return total, products
    leaving = 1 - np.asarray(step.sum(axis=1))[:, None]
    leaving[leaving <= _CLOSED] = 0
    found, more, sure = factor_and_solve(step, leaving, right, order, adjoint)
    if not sure and (exact := eliminate_unless_large(step, leaving, right, adjoint)) is not None:
        found = exact
    # The sum of the products is as good as any other answer where the matrix cannot be factored.
    return total if found is None else found, products + more


def factor_and_solve(
    step: scipy.sparse.csr_array,
    leaving: Float[np.ndarray, "rows 1"],
    right: Float[np.ndarray, "rows columns"],
    order: Int[np.ndarray, "rows"] | None,
    adjoint: bool,
) -> tuple[Float[np.ndarray, "rows columns"] | None, int, bool]:
    """Solve `x = right + Q x`, or with the transposed matrix, with a factorisation of `I - Q`.

    **Arguments:**

    - `step`: the matrix Q.
    - `leaving`: the probability of leaving from each row.
    - `right`, `adjoint`: as of [`solve_transient`][].
    - `order`: in which the rows are taken, if it is known.

    **Returns:** the solution, or `None` if the matrix is singular to rounding; the number of
    products; and whether rounding leaves the solution most of its digits.
    """
    products = 0
    try:
        if order is None:
            matrix = step.T.tocsr() if adjoint else step
            if (attempt := _attempt(matrix)) is not None:
                found, products = _solve_large(matrix, right, attempt)
                if found is not None:
                    # A part that is only left by rare steps keeps what the start put there.
                    steps = np.append(step.data, leaving)
                    return found, products, bool(steps[steps > 0].min() > _HIDDEN)
        solve = _factored(step, order)
        found, sure = solve(right, adjoint), solve(leaving)
    except RuntimeError:
        return None, products, False
    return found, products, bool(np.abs(sure - 1).max() <= _ILL)


def eliminate_unless_large(
    step: scipy.sparse.csr_array,
    leaving: Float[np.ndarray, "rows 1"],
    right: Float[np.ndarray, "rows columns"],
    adjoint: bool,
) -> Float[np.ndarray, "rows columns"] | None:
    """Solve by [`eliminate`][]; `None` if that takes too many multiplications."""
    levels = Levels.of(step)
    if levels.work > _LARGEST_ELIMINATION:
        return None
    return eliminate(step, leaving[:, 0], right, levels, adjoint=adjoint)


def _by_components(step: scipy.sparse.csr_array) -> Int[np.ndarray, "rows"] | None:
    """The order of strong components, in which nearly all of `I - Q` is a triangle; `None` if they
    are too large for that."""
    _, label = csgraph.connected_components(step, connection="strong")
    # A row of the factor has at most all of a component where the matrix has a step to it.
    most = np.bincount(label)[label[step.indices]].sum()
    return np.argsort(label, kind="stable") if most <= _MAX_FILL * step.nnz else None


def _by_products(
    matrix: scipy.sparse.csr_array, right: Float[np.ndarray, "rows columns"]
) -> tuple[Float[np.ndarray, "rows columns"], int, bool]:
    """What products add up to, their number, and whether that is the solution."""
    total, term = right.copy(), right
    first = float(right.max())
    goal = 1e-16 * first
    for products in range(1, MAX_PRODUCTS + 1):
        term = matrix @ term
        total += term
        largest = float(term.max())
        if largest <= goal:
            break
        if factor_instead(matrix.shape[0], products, first, largest, goal):
            return total, products, False
    return total, products, True


def _factored(
    matrix: scipy.sparse.csr_array, order: Int[np.ndarray, "rows"] | None = None
) -> Callable[..., Float[np.ndarray, "rows columns"]]:
    """Solve `x = right + matrix x`, or with the transposed matrix, with one factorisation.

    **Arguments:**

    - `matrix`: the matrix.
    - `order`: in which its rows are taken, if it is known.

    **Raises:** `RuntimeError` if the matrix is singular to rounding.
    """
    system = (scipy.sparse.eye_array(matrix.shape[0], format="csr") - matrix).tocsr()
    if order is None:
        order = np.arange(matrix.shape[0])
        factor = linalg.splu(system.tocsc())
    else:
        # There are no dense blocks in it for which columns are to be taken together.
        factor = linalg.splu(
            system[order][:, order].tocsc(),
            permc_spec="NATURAL",
            diag_pivot_thresh=0.0,
            relax=1,
            panel_size=1,
        )

    def solve(
        right: Float[np.ndarray, "rows columns"], adjoint: bool = False
    ) -> Float[np.ndarray, "rows columns"]:
        step, form = (matrix.T, "T") if adjoint else (matrix, "N")
        total = np.empty_like(right)
        total[order] = factor.solve(right[order], form)
        # One correction makes the residual as small as the rounding of a product.
        total[order] += factor.solve((right - (total - step @ total))[order], form)
        return total

    return solve


# Solves `x = right + matrix x` roughly; gives the products that it took beside.
_Attempt = Callable[[Float[np.ndarray, "rows"]], tuple[Float[np.ndarray, "rows"], int]]


def _attempt(matrix: scipy.sparse.csr_array) -> _Attempt | None:
    """How to solve with a matrix that is not to be factored completely; `None` if it is."""
    rows = matrix.shape[0]
    if rows > _LARGEST_FACTORED_CYCLE and (cycle := Cycle.of(matrix)) is not None:
        return cycle
    return TwoLevel.of(matrix) if rows > _SMALLEST_TWO_LEVEL else None


def _solve_large(
    matrix: scipy.sparse.csr_array, right: Float[np.ndarray, "rows columns"], attempt: _Attempt
) -> tuple[Float[np.ndarray, "rows columns"] | None, int]:
    """The same by rough solves. What those cannot do is left to products, or, for a matrix that can
    be factored completely, to that: it is `None` then."""
    products, columns = 0, []
    for wanted in right.T:
        found, left = np.zeros_like(wanted), wanted
        for _ in range(_ROUNDS):
            change, more = attempt(left)
            products += more
            now = wanted - (found + change - matrix @ (found + change))
            better = np.abs(now).max() < np.abs(left).max() / 2
            if better:
                found, left = found + change, now
            if not better or np.abs(left).max() <= _ROUNDING * np.abs(found).max():
                break
        goal = max(_ENOUGH * wanted.max(), 100 * _ROUNDING * np.abs(found).max())
        cycle = isinstance(attempt, Cycle)
        if np.abs(left).max() > goal and not cycle and matrix.shape[0] <= _LARGEST_COMPLETE:
            return None, products
        # A product goes through one block of a cycle only, and is of no use then.
        most = 0 if cycle else MAX_PRODUCTS
        while np.abs(left).max() > goal and products < most:
            found += left
            left = matrix @ left
            products += 1
        columns.append(found)
    return np.stack(columns, axis=1), products


def factor_instead(rows: int, products: int, first: float, now: float, goal: float) -> bool:
    """Whether a factorisation will be faster than going on with products.

    That is so where a residual that fell from `first` to `now` at a steady rate would reach the
    goal too late.
    """
    if products % _TRIAL or rows > LARGEST_FACTOR:
        return False
    if now >= first:
        return True
    return products * math.log(goal / first) / math.log(now / first) > _WORTHWHILE
