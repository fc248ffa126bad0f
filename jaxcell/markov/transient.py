import dataclasses

import numpy as np
import scipy.sparse
from jaxtyping import Bool, Float, Int

from .solving.solve import solve_transient


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
        step = matrix[cells][:, cells]
        count = cells.size
        start = step.indptr[:-1]
        on_run = np.diff(step.indptr) == 1
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
        return cls(cells, step, branching, end, jump, tuple(hops))

    def expect(
        self, gain: Float[np.ndarray, "part columns"]
    ) -> tuple[Float[np.ndarray, "part columns"], int]:
        """Compute the expected total of `gain` over all visited cells, from each start cell.

        It is the solution of `x = gain + Q x`. Also returns the number of matrix products.
        """
        run = np.zeros((self.cells.size + 1, gain.shape[1]))
        run[:-1] = gain
        run[self.branching] = 0
        for hop in self.hops:
            run[:-1] += run[hop]
        run = run[:-1]
        # A branching cell gains its own share, and that of the run to the next branching cell.
        right = gain[self.branching] + self.step[self.branching] @ run
        at_branching, products = solve_transient(self.jump, right)
        return run + at_branching[self.end], products

    def visits(self, start: Float[np.ndarray, "part"]) -> tuple[Float[np.ndarray, "section"], int]:
        """Compute the expected visits to each branching cell, for a distribution of the start.

        This is the adjoint of `expect`. The part is left only from branching cells. Also returns
        the number of matrix products.
        """
        arriving = np.zeros(self.branching.size)
        np.add.at(arriving, self.end, start)
        visits, products = solve_transient(self.jump, arriving[:, None], adjoint=True)
        return visits[:, 0], products
