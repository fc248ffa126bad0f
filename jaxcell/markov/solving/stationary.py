"""The stationary distributions of closed classes.

Small chains are eliminated without subtractions, so that the probability of each cell has nearly
all its digits, even if it is tiny. Larger chains are solved as described in `solve.py`. Repeated
products are accepted only if they converge to the same distribution from two starts: from one, they
may seem to converge while a slow mode remains. If they converge slowly, the value of one cell of
each class, its *root*, is set to 1, and a linear system gives the values of the other cells. The
root must be a likely cell, because without an unlikely cell the matrix remains nearly singular.
"""

import contextlib
import dataclasses
import math
from typing import TypeAlias

import numpy as np
import scipy.sparse
from jaxtyping import Float, Int

from . import solve
from .elimination import eliminate


_Shares: TypeAlias = Float[np.ndarray, "cells"]
_Classes: TypeAlias = Int[np.ndarray, "cells"]

# Largest 1-norm of the difference of the distributions that follow from two starts.
_FORGOTTEN = 1e-9
# A second start is needed if a step is rarer than this.
_RARE = 1e-6
# Largest number of roots that are tried.
_ROOTS = 3
# An inverse is accepted if it gives the probability of reaching a root, which is 1, with at most
# this error.
_SURE = 1e-10
_SEED = 0


def solve_stationary(
    step: scipy.sparse.csr_array, group: _Classes, *, by_entries: bool = False
) -> tuple[_Shares, int, float]:
    """Compute the stationary distribution of each closed class: `x = P' x` with sum 1.

    `step` is the matrix `P`, without steps between classes, and `group` the class of each cell,
    numbered from 0. With `by_entries`, larger chains too are eliminated, if possible. Returns the
    distributions, in one array, the number of matrix products, and a bound on the relative error of
    every entry, `inf` if it is unknown.
    """
    size = np.bincount(group)
    x = 1 / size[group]
    products = 0
    if group.size == size.size:
        return x, products, 0.0
    if group.size > solve.LIMITS.small:
        x, products, done = _by_products(step, group)
        if (done and not by_entries) or group.size > solve.LIMITS.factored:
            return x, products, math.inf
        rooted = None
        for _ in range(0 if done else _ROOTS):
            last, rooted = rooted, Rooted.of(step, group, x)
            if last is not None and np.array_equal(last.others, rooted.others):
                break
            others, more, sure = solve.factor_and_solve(
                rooted.step, rooted.leaving, rooted.entering, None, adjoint=True
            )
            products += more
            if others is None:
                break
            # Even if rounding spoils a solution, its largest entries belong to likely cells.
            x = rooted.shares(np.abs(others))
            if sure and by_entries:
                break
            if sure:
                return x, products, math.inf
    for _ in range(_ROOTS):
        rooted = Rooted.of(step, group, x)
        eliminated = solve.eliminate_unless_large(
            rooted.step, rooted.leaving, rooted.entering, adjoint=True
        )
        if eliminated is None:
            break
        others, error = eliminated
        if np.isfinite(others).all():
            return rooted.shares(others), products, 2 * error
        # The root is so rare that the shares of other cells, relative to it, overflow.
        x = rooted.shares(np.where(np.isfinite(others), 0.0, 2.0))
    return x, products, math.inf


@dataclasses.dataclass(frozen=True, eq=False)
class Rooted:
    """Equations for the cells of closed classes, relative to one cell of each class, its root."""

    group: _Classes
    "The class of each cell."
    others: Int[np.ndarray, "others"]
    "The cells that are not roots."
    step: scipy.sparse.csr_array
    "The probabilities of steps between cells that are not roots."
    leaving: Float[np.ndarray, "others"]
    "The probability of a step from each cell in `others` to the root of its class."
    entering: Float[np.ndarray, "others 1"]
    "The probability of a step to each cell in `others` from the root of its class."

    @classmethod
    def of(cls, step: scipy.sparse.csr_array, group: _Classes, likely: _Shares) -> "Rooted":
        """Build the equations, with the likeliest cell of each class, by `likely`, as its root."""
        peak = np.zeros(np.bincount(group).size)
        np.maximum.at(peak, group, likely)
        peaks = np.flatnonzero(likely == peak[group])
        roots = peaks[np.unique(group[peaks], return_index=True)[1]]
        others = np.delete(np.arange(group.size), roots)
        root = np.zeros((group.size, 1))
        root[roots] = 1
        among = step[others][:, others]
        return cls(group, others, among, (step @ root)[others, 0], (step.T @ root)[others])

    def shares(self, others: Float[np.ndarray, "others 1"]) -> _Shares:
        """Return the distribution of each class from the values of `others` relative to roots."""
        x = np.ones(self.group.size)
        x[self.others] = others[:, 0]
        return x / np.bincount(self.group, x)[self.group]

    def visits(self, small: int = 400) -> Float[np.ndarray, "others others"]:
        """Compute the expected visits to each cell, for each start, before a root is reached.

        If cells are at most `small`, or if rounding spoils the inverse matrix, they are eliminated.
        """
        identity = np.eye(self.others.size)
        if self.others.size > small:
            with contextlib.suppress(np.linalg.LinAlgError):
                visits = np.linalg.inv(identity - self.step.toarray())
                # The chain reaches a root with probability 1.
                if np.abs(visits @ self.leaving - 1).max() <= _SURE:
                    return visits
        return eliminate(self.step, self.leaving, identity)[0]


def _by_products(step: scipy.sparse.csr_array, group: _Classes) -> tuple[_Shares, int, bool]:
    """Multiply a uniform and a random distribution by the matrix until both converge.

    Returns the distribution, the number of products, and whether both starts converge to it.
    """
    matrix = step.T.tocsr()
    size = np.bincount(group)
    x, products, done = _converge(matrix, 1 / size[group], 1e-14 * size.size)
    # No second start is needed if the uniform distribution is stationary and no step is so rare
    # that the rounding of other steps hides it.
    if not done or (products == 1 and step.data.min() > _RARE):
        return x, products, done
    start = np.random.default_rng(_SEED).random(group.size)
    start /= np.bincount(group, start)[group]
    _, more, done = _converge(matrix, start, _FORGOTTEN * size.size, limit=x)
    return x, products + more, done


def _converge(
    matrix: scipy.sparse.csr_array, x: _Shares, goal: float, *, limit: _Shares | None = None
) -> tuple[_Shares, int, bool]:
    """Multiply a distribution by the matrix until it converges or a factorisation will be faster.

    It converges if the 1-norm of the last change, or the distance to `limit`, is at most `goal`.
    Returns the distribution, the number of products, and whether the goal is reached.
    """
    first = 0.0
    for products in range(1, solve.LIMITS.products + 1):
        following = matrix @ x
        left = float(np.abs(following - (x if limit is None else limit)).sum())
        first = first or left
        if left <= goal:
            return x, products, True
        # Every second step is halved, which removes alternating modes and breaks any period.
        x = following if products % 2 else (x + following) / 2
        if solve.factor_instead(matrix.shape[0], products, first, left, goal):
            break
    return x, products, False
