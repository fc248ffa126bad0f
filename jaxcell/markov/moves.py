import dataclasses
import functools
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
import scipy.sparse
from jaxtyping import Bool, Float, Int

from ..mapping.classes import next_cells
from ..mapping.generalized import leaving_rows, missing_rows


_Cells: TypeAlias = Bool[np.ndarray, "cells"]
_Values: TypeAlias = Float[np.ndarray, "cells"]
Policy: TypeAlias = Int[np.ndarray, "cells"]
"""The action to take in each cell."""
Usable: TypeAlias = Bool[np.ndarray, "actions cells"]
"""A mask of the actions that may be taken in each cell."""


@dataclasses.dataclass(frozen=True, eq=False)
class Moves:
    """The possible steps of all actions, in a matrix with a row for each action in each cell."""

    matrix: scipy.sparse.csr_array
    allowed: Usable
    stays: Usable
    "`True` for an action in a cell if none of its steps from there leaves the space."

    @classmethod
    def of(cls, matrices: Sequence[scipy.sparse.csr_array], allowed: Usable) -> "Moves":
        """Create the moves from the transition matrix and the allowed cells of each action."""
        stays = np.stack([leaving_rows(matrix) == 0 for matrix in matrices])
        matrix = scipy.sparse.vstack(matrices, format="csr")
        return cls(matrix, np.asarray(allowed), stays)

    @property
    def cells(self) -> int:
        return self.allowed.shape[1]

    @functools.cached_property
    def missing(self) -> Float[np.ndarray, "actions cells"]:
        """1 minus the sum of the probabilities of each action in each cell, with all digits."""
        return missing_rows(self.matrix).reshape(self.allowed.shape)

    @functools.cached_property
    def steps(self) -> tuple[Int[np.ndarray, "edges"], Int[np.ndarray, "edges"]]:
        """The row and the column of every possible step, row by row."""
        return self.matrix.nonzero()

    def of_policy(self, policy: Policy) -> scipy.sparse.csr_array:
        return self.matrix[policy * self.cells + np.arange(self.cells)]

    def expected(
        self, value: Float[np.ndarray, "cells *members"]
    ) -> Float[np.ndarray, "actions cells *members"]:
        """Compute the expected value after one step, for each action and cell."""
        return (self.matrix @ value).reshape(*self.allowed.shape, *value.shape[1:])

    def changes(self, *values: _Values) -> tuple[np.ndarray, np.ndarray]:
        """Compute the expected change of the sum of some values in one step, and its size.

        Both are arrays `[actions, cells]`. The size is the expected sum of the absolute changes.
        """
        cell = np.repeat(
            np.tile(np.arange(self.cells), len(self.allowed)), np.diff(self.matrix.indptr)
        )
        changes = [value[self.matrix.indices] - value[cell] for value in values]
        totals = []
        for change in (sum(changes), sum(map(np.abs, changes))):
            weighed = (self.matrix.data * change, self.matrix.indices, self.matrix.indptr)
            totals.append(scipy.sparse.csr_array(weighed, self.matrix.shape) @ np.ones(self.cells))
        moved, size = (total.reshape(self.allowed.shape) for total in totals)
        return moved, size

    def joint(self, usable: Usable) -> scipy.sparse.csr_array:
        """Return the graph of all possible steps of usable actions."""
        row, column = self.steps
        kept = usable.ravel()[row]
        row, column = row[kept] % self.cells, column[kept]
        # Entries of a pair of cells are added up.
        ones = np.ones(row.size)
        return scipy.sparse.csr_array((ones, (row, column)), shape=(self.cells, self.cells))

    def nearer(self, policy: Policy, usable: Usable, target: _Cells) -> Policy:
        """Change a policy, where possible, to usable actions that may lead nearer to a target."""
        after = next_cells(self.joint(usable), target)
        row, column = self.steps
        action, cell = np.divmod(row, self.cells)
        leads = usable.ravel()[row] & ~target[cell] & (after[cell] == column)
        policy = policy.copy()
        # The first action is assigned last, so it stays.
        policy[cell[leads][::-1]] = action[leads][::-1]
        return policy
