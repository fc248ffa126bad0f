"""Solving with the matrix of a chain: products first, and a factorisation if they do not settle it.

A chain that mixes or is absorbed fast is settled by some tens of products, while a factorisation of
its matrix fills up: with 10 random images a cell and 6,000 cells, 2 ms against 9 s. A chain that is
slow, such as a robot between its walls or a drift on a plane, is held back by narrow passages; they
are what keeps a factorisation sparse, and it takes milliseconds where products would go on for
10,000 rounds. Each does what the other cannot.
"""

import math

import numpy as np
import scipy.sparse
from jaxtyping import Float, Int
from scipy.sparse import linalg


# Products after which it is judged whether products will do.
_TRIAL = 60
# Products that cost about as much as a factorisation.
_WORTHWHILE = 400
# A matrix with more rows is not factored, for that takes gigabytes; products go on instead.
_LARGEST_FACTOR = 500_000
_MOST_PRODUCTS = 50_000


def solve_transient(
    step: scipy.sparse.csr_array,
    right: Float[np.ndarray, "rows columns"],
    *,
    adjoint: bool = False,
) -> tuple[Float[np.ndarray, "rows columns"], int]:
    """Solves `x = right + Q x`, or `x = right + Q' x`, for a matrix whose powers tend to 0.

    **Arguments:**

    - `step`: the matrix Q.
    - `right`: what is added, not negative.
    - `adjoint`: whether to solve with the transposed matrix.

    **Returns:** the solution and the number of products.
    """
    if not right.any():
        return np.zeros_like(right), 0
    matrix = step.T.tocsr() if adjoint else step
    total, term = right.copy(), right
    first = float(right.max())
    goal = 1e-16 * first
    for products in range(1, _MOST_PRODUCTS + 1):
        term = matrix @ term
        total += term
        largest = float(term.max())
        if largest <= goal:
            return total, products
        if _factor_instead(step.shape[0], products, first, largest, goal):
            break
    else:
        return total, products
    identity = scipy.sparse.eye_array(step.shape[0], format="csc")
    factor = linalg.splu((identity - matrix).tocsc())
    total = factor.solve(right)
    # One correction makes the residual as small as the rounding of a product.
    total += factor.solve(right - (total - matrix @ total))
    return total, products


def solve_stationary(
    step: scipy.sparse.csr_array, group: Int[np.ndarray, "cells"]
) -> tuple[Float[np.ndarray, "cells"], int]:
    """The stationary distribution of every closed class: `x = P' x`, of sum 1 in each class.

    **Arguments:**

    - `step`: the matrix P of the classes, with nothing between them.
    - `group`: the class of each cell, numbered from 0 without gaps.

    **Returns:** the distributions side by side and the number of products.
    """
    matrix = step.T.tocsr()
    size = np.bincount(group)
    x = 1 / size[group]
    goal = 1e-14 * size.size
    first = 0.0
    for products in range(1, _MOST_PRODUCTS + 1):
        change = matrix @ x - x
        largest = float(np.abs(change).sum())
        first = first or largest
        if largest <= goal:
            return x, products
        # Staying put every second time breaks any period and leaves what is stationary so.
        x = x + change / 2
        if _factor_instead(step.shape[0], products, first, largest, goal):
            break
    else:
        return x, products
    # In each class one cell is set to 1, and the others follow from it.
    _, roots = np.unique(group, return_index=True)
    others = np.delete(np.arange(group.size), roots)
    into_others = matrix[others]
    right = np.asarray(into_others[:, roots].sum(axis=1)).ravel()
    among = into_others[:, others]
    identity = scipy.sparse.eye_array(others.size, format="csc")
    factor = linalg.splu((identity - among).tocsc())
    y = factor.solve(right)
    y += factor.solve(right - (y - among @ y))
    x = np.ones(group.size)
    x[others] = np.maximum(y, 0)
    return x / np.bincount(group, x)[group], products


def _factor_instead(rows: int, products: int, first: float, now: float, goal: float) -> bool:
    """Whether a factorisation will be faster than going on with products.

    That is so where a residual that fell from `first` to `now` at a steady rate would reach the
    goal too late.
    """
    if products % _TRIAL or rows > _LARGEST_FACTOR:
        return False
    if now >= first:
        return True
    return products * math.log(goal / first) / math.log(now / first) > _WORTHWHILE
