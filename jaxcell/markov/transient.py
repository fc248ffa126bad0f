import dataclasses
import math
from typing import TypeAlias

import numpy as np
import scipy.sparse
from jaxtyping import Bool, Float, Int

from ..mapping.generalized import leaving_rows
from .solving.elimination import eliminate_scaled
from .solving.scaled import Scaled
from .solving.solve import imprecision, residual_bound, solve_transient


_Columns: TypeAlias = Float[np.ndarray, "part columns"]

_HALF_ULP = 2.0**-53
# Smaller numbers lose digits.
_TINIEST = 2.0**-1021


@dataclasses.dataclass(frozen=True, eq=False)
class Transient:
    """A transient part of a chain, reduced to the cells at which the chain branches.

    In some chains most cells have one certain image, such as the cells of a robot between two
    bumps. The chain goes from such a cell along a *run* of certain steps to a *branching* cell, the
    first cell whose image in the part is not certain. The value of the cell is that of the
    branching cell plus a sum over the run. So equations are solved only for the branching cells:
    for a bouncing robot, one in six cells. Except in `cells`, cells are numbered within the part.
    """

    cells: Int[np.ndarray, "part"]
    "The numbers, in the whole chain, of the cells of the part, in ascending order."
    step: scipy.sparse.csr_array
    "The probabilities of steps within the part."
    leaving: Float[np.ndarray, "part"]
    """The probability of a step out of the part. It is a sum over the steps that lead out, and has
    all its digits even if it is tiny; 1 minus the probability of staying would not."""
    branching: Int[np.ndarray, "section"]
    end: Int[np.ndarray, "part"]
    "The index in `branching` of the cell at the end of the run from each cell."
    jump: scipy.sparse.csr_array
    "The transition matrix from each branching cell to the next branching cell."
    hops: tuple[Int[np.ndarray, "part"], ...]
    """The cell that is reached from each cell by 1, 2, 4, ... steps along its run. If the run is
    shorter, it is the number of cells of the part, which is the index of no cell."""

    @classmethod
    def of(cls, matrix: scipy.sparse.csr_array, inside: Bool[np.ndarray, "cells"]) -> "Transient":
        """Extract the transient cells `inside` from a transition matrix without stored zeros.

        **Raises:** `RuntimeError` for a cycle of certain steps, which the chain never leaves.
        """
        cells = np.flatnonzero(inside)
        rows = matrix[cells]
        step = rows[:, cells]
        leaving = leaving_of(rows, inside)
        count = cells.size
        start = step.indptr[:-1]
        # Beside a step of probability 1 there may be a step whose probability is below rounding.
        on_run = (np.diff(step.indptr) == 1) & (leaving == 0)
        on_run[on_run] = step.data[start[on_run]] == 1
        hop = np.full(count + 1, count)
        hop[:-1][on_run] = step.indices[start[on_run]]
        end = np.where(on_run, hop[:-1], np.arange(count))
        hops: list[np.ndarray] = []
        while (hop < count).any():
            if len(hops) > count.bit_length():
                raise RuntimeError(
                    f"cell {cells[np.flatnonzero(hop < count)[0]]} is on a circuit that the chain "
                    "never leaves: the steps out of it were lost in rounding"
                )
            hops.append(hop[:-1])
            hop, end = hop[hop], end[end]
        branching = np.flatnonzero(~on_run)
        end = (np.cumsum(~on_run) - 1)[end]
        rows = step[branching]
        jump = scipy.sparse.csr_array(
            (rows.data, end[rows.indices], rows.indptr), shape=(branching.size, branching.size)
        )
        jump.sum_duplicates()
        return cls(cells, step, leaving, branching, end, jump, tuple(hops))

    def expect(self, gain: _Columns, *, by_entries: bool = False) -> "Expected":
        """Compute the expected total of `gain` over all visited cells, from each start cell.

        It is the solution of `x = gain + Q x`; `gain` must not be negative. The last column of the
        result is the expected number of steps in the part. With `by_entries`, errors are relative
        to each value if possible (see [`jaxcell.markov.solving.solve.solve_transient`][]).
        """
        # The expected number of steps is solved too: it turns residuals into errors.
        right = np.column_stack([gain, np.ones(self.cells.size)])
        value, products, relative = self._solve(right, by_entries)
        with np.errstate(all="ignore"):
            left = residual_bound(self.step, right, value)
            left = left + imprecision(self.step, self.leaving)[:, None] * np.abs(value)
            most = left.max(axis=0, initial=0.0)
            # With t = 1 + Q t + r, the error of t is at most max |r| times the true t.
            steps = value[:, -1:] / (1 - most[-1]) if most[-1] < 1 else np.inf
            # In each step, an elimination may lose probabilities that are too small for 64 bits.
            lost = _TINIEST * self.branching.size**2 * value.max(axis=0, initial=0.0)
            error = np.fmin(np.abs(value) * relative + value[:, -1:] * lost, most * steps)
        return Expected(value, np.where(np.isnan(error), np.inf, error), products)

    def expect_scaled(self, gain: Float[np.ndarray, "part"]) -> tuple[Scaled, float] | None:
        """Compute the expected total of a gain at branching cells, however small it is.

        Returns it with a bound on the relative errors, or `None` if it would take too long.
        """
        right = gain[self.branching, None]
        solved = eliminate_scaled(self.jump, self.leaving[self.branching], right)
        return solved and (solved[0][self.end, 0], solved[1] + self._inputs)

    def _solve(self, gain: _Columns, by_entries: bool) -> tuple[_Columns, int, float]:
        run = np.zeros((self.cells.size + 1, gain.shape[1]))
        run[:-1] = gain
        run[self.branching] = 0
        for hop in self.hops:
            run[:-1] += run[hop]
        run = run[:-1]
        # A branching cell gains its own share, and that of the run to the next branching cell.
        right = gain[self.branching] + self.step[self.branching] @ run
        at_branching, products, error = solve_transient(
            self.jump, self.leaving[self.branching], right, by_entries=by_entries
        )
        return run + at_branching[self.end], products, error + self._inputs

    @property
    def _inputs(self) -> float:
        """A bound on the relative error of solutions that is due to sums of probabilities."""
        terms = np.diff(self.jump.indptr).max(initial=0) + len(self.hops) + 2
        return float(2 * self.branching.size * terms * _HALF_ULP)

    def visited(self, start: _Columns, *, by_entries: bool = False) -> tuple[_Columns, int, float]:
        """Compute the expected visits to each cell, `x = start + Q' x`; `start` is not negative.

        This is the adjoint of `expect`. Returns the visits, the number of products, and a bound on
        the relative error of every entry, or `inf` if the residual must tell the error.
        """
        arriving = _summed(self.end, start, self.branching.size)
        at_branching, products, relative = solve_transient(
            self.jump,
            self.leaving[self.branching],
            arriving,
            adjoint=True,
            by_entries=by_entries,
        )
        passing = np.zeros((self.cells.size + 1, start.shape[1]))
        passing[:-1] = start + self.step[self.branching].T @ at_branching
        for hop in self.hops:
            passing += _summed(hop, passing[:-1], len(passing))
        passing[self.branching] = at_branching
        return passing[:-1], products, relative + self._inputs

    def visits(self, start: Float[np.ndarray, "part"], *, by_entries: bool = False) -> "Visited":
        """Compute the expected visits to each cell, for a distribution of the start."""
        visits, products, relative = self.visited(start[:, None], by_entries=by_entries)
        left = residual_bound(self.step.T.tocsr(), start[:, None], visits)[:, 0]
        left = left + imprecision(self.step, self.leaving) * np.abs(visits[:, 0])
        return Visited(visits[:, 0], products, relative, left)

    def sum_error(self, visited: "Visited") -> float:
        """Bound the sum of the errors of all visits, relative to the sum of the visits."""
        total = float(visited.value.sum())
        if math.isfinite(visited.relative) or not total:
            return visited.relative if math.isfinite(total) else math.inf
        # A visit that the residual adds is followed by the expected number of steps from there.
        steps = self.expect(np.empty((self.cells.size, 0)))
        with np.errstate(all="ignore"):
            error = float(visited.left @ (steps.value + steps.error)[:, 0] / total)
        return math.inf if math.isnan(error) else error


def leaving_of(
    rows: scipy.sparse.csr_array, inside: Bool[np.ndarray, "cells"]
) -> Float[np.ndarray, "rows"]:
    """Return the probability of a step from each row out of some cells, as a sum over steps."""
    return rows @ (~inside).astype(float) + leaving_rows(rows)


def _summed(
    index: Int[np.ndarray, "part"], rows: _Columns, size: int
) -> Float[np.ndarray, "sums columns"]:
    """Sum the rows that have the same index."""
    # Sums of no rows would be whole numbers.
    sums = [np.bincount(index, column, size) for column in rows.T]
    return np.stack(sums, axis=1, dtype=np.float64)


@dataclasses.dataclass(frozen=True, eq=False)
class Expected:
    """The expected total of each gain until a part is left, and the expected number of steps."""

    value: Float[np.ndarray, "part columns"]
    error: Float[np.ndarray, "part columns"]
    "A bound on the absolute error of each value; `inf` if it is unknown."
    products: int

    @property
    def relative(self) -> Float[np.ndarray, "part columns"]:
        """A bound on the relative error of each value."""
        with np.errstate(all="ignore"):
            part = np.where(self.error > 0, self.error / np.abs(self.value), 0.0)
        return np.where(np.isnan(part), np.inf, part)


@dataclasses.dataclass(frozen=True, eq=False)
class Visited:
    """The expected number of visits to each cell of a part until the part is left."""

    value: Float[np.ndarray, "part"]
    products: int
    relative: float
    "A bound on the relative error of every number of visits; `inf` if it is unknown."
    left: Float[np.ndarray, "part"]
    "A bound on the residual of each equation."

    @property
    def exits_error(self) -> float:
        """A bound on the sum of the errors of the probabilities of all ways out of the part."""
        # All visits that the residual adds end with a step out of the part.
        return float(np.fmin(self.relative, self.left.sum()))
