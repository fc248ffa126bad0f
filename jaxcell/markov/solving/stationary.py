"""The stationary distributions of closed classes.

Small chains are eliminated without subtractions: every share has nearly all its digits, however
rare the cell is. Larger chains are solved as `solve.py` says. Products converge from two starts,
since one start may already have the shape of a mode that hardly ever changes. Where products take
too long, one cell of each class, its *root*, is set to 1, and the others follow from it. The root
is a likely cell: without a cell that the chain hardly ever visits, the matrix is singular to
rounding.
"""

import dataclasses

import numpy as np
import scipy.sparse
from jaxtyping import Float, Int

from . import solve


# Classes with at most this many cells in all are eliminated.
_SMALL = 200
# The most by which distributions from two starts may differ, in the 1-norm.
_FORGOTTEN = 1e-9
# The number of roots that are tried.
_ROOTS = 3
_SEED = 0


def solve_stationary(
    step: scipy.sparse.csr_array, group: Int[np.ndarray, "cells"]
) -> tuple[Float[np.ndarray, "cells"], int]:
    """Solve for the stationary distribution of every closed class: `x = P' x`, of sum 1 in each.

    **Arguments:**

    - `step`: the matrix P of the classes, with nothing between them.
    - `group`: the class of each cell, numbered from 0 without gaps.

    **Returns:** the distributions side by side and the number of products.
    """
    size = np.bincount(group)
    x = 1 / size[group]
    products = 0
    if group.size == size.size:
        return x, products
    if group.size > _SMALL:
        x, products, done = _by_products(step, group)
        if done or group.size > solve.LARGEST_FACTOR:
            return x, products
        for _ in range(_ROOTS):
            rooted = Rooted.of(step, group, x)
            found, more, sure = solve.factor_and_solve(
                rooted.step, rooted.leaving, rooted.entering, None, True
            )
            products += more
            if found is None:
                break
            # Even where rounding spoils a solution, its largest entries are those of likely cells.
            x = rooted.shares(np.abs(found))
            if sure:
                return x, products
    for _ in range(_ROOTS):
        rooted = Rooted.of(step, group, x)
        with np.errstate(all="ignore"):
            found = solve.eliminate_unless_large(rooted.step, rooted.leaving, rooted.entering, True)
        if found is None:
            break
        if np.isfinite(found).all():
            return rooted.shares(found), products
        # The root is so rare that shares overflow beside it.
        x = rooted.shares(np.where(np.isfinite(found), 0.0, 2.0))
    return x, products


@dataclasses.dataclass(frozen=True, eq=False)
class Rooted:
    """Classes without their roots, which are set to 1."""

    group: Int[np.ndarray, "cells"]
    others: Int[np.ndarray, "others"]
    step: scipy.sparse.csr_array
    "The probabilities of steps among the other cells."
    leaving: Float[np.ndarray, "others 1"]
    "The probability of a step from each to its root."
    entering: Float[np.ndarray, "others 1"]
    "The probability of a step from the root to each."

    @classmethod
    def of(
        cls,
        step: scipy.sparse.csr_array,
        group: Int[np.ndarray, "cells"],
        likely: Float[np.ndarray, "cells"],
    ) -> "Rooted":
        """Take the likeliest cell of each class as its root."""
        peak = np.zeros(np.bincount(group).size)
        np.maximum.at(peak, group, likely)
        peaks = np.flatnonzero(likely == peak[group])
        roots = peaks[np.unique(group[peaks], return_index=True)[1]]
        others = np.delete(np.arange(group.size), roots)
        root = np.zeros((group.size, 1))
        root[roots] = 1
        among = step[others][:, others]
        return cls(group, others, among, (step @ root)[others], (step.T @ root)[others])

    def shares(self, found: Float[np.ndarray, "others 1"]) -> Float[np.ndarray, "cells"]:
        """The distribution in which the others are so many times as likely as their root."""
        x = np.ones(self.group.size)
        x[self.others] = found[:, 0]
        return x / np.bincount(self.group, x)[self.group]


def _by_products(
    step: scipy.sparse.csr_array, group: Int[np.ndarray, "cells"]
) -> tuple[Float[np.ndarray, "cells"], int, bool]:
    """Converge by products from a uniform and from a random start.

    **Returns:** the distribution, the number of products, and whether both starts agree on it.
    """
    matrix = step.T.tocsr()
    size = np.bincount(group)
    x, products, done = _converge(matrix, 1 / size[group], size.size)
    # A uniform distribution that no product changes needs no other start.
    if not done or products == 1:
        return x, products, done
    start = np.random.default_rng(_SEED).random(group.size)
    other, more, done = _converge(matrix, start / np.bincount(group, start)[group], size.size)
    return x, products + more, done and bool(np.abs(other - x).sum() <= _FORGOTTEN * size.size)


def _converge(
    matrix: scipy.sparse.csr_array, x: Float[np.ndarray, "cells"], classes: int
) -> tuple[Float[np.ndarray, "cells"], int, bool]:
    """Converge by products from a start. They end early where a factorisation will be faster."""
    goal = 1e-14 * classes
    first = 0.0
    for products in range(1, solve.MAX_PRODUCTS + 1):
        change = matrix @ x - x
        largest = float(np.abs(change).sum())
        first = first or largest
        if largest <= goal:
            return x, products, True
        # Staying put every second time breaks any period and leaves what is stationary so.
        x = x + change / 2
        if solve.factor_instead(matrix.shape[0], products, first, largest, goal):
            break
    return x, products, False
