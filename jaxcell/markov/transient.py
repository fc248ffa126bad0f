import dataclasses

import numpy as np
import scipy.sparse
from jaxtyping import Bool, Float, Int

from .solving.solve import solve_transient


@dataclasses.dataclass(frozen=True, eq=False)
class Transient:
    """A part of a chain that it leaves for good, reduced to the cells at which it branches.

    Most cells of some chains have one certain image, such as the cells of a robot between two
    bumps. Such *runs* are removed first: the value of a cell on a run follows from the *branching*
    cell at its end, the first whose image in the part is not certain. One in six cells of a
    bouncing robot is a branching cell. Arrays are over the cells of the part, which are numbered by
    their places in it.
    """

    cells: Int[np.ndarray, "part"]
    "The cells, in ascending order."
    step: scipy.sparse.csr_array
    "The probabilities of steps within the part."
    branching: Int[np.ndarray, "section"]
    "The branching cells."
    end: Int[np.ndarray, "part"]
    "The number of the branching cell at the end of the run from each cell."
    jump: scipy.sparse.csr_array
    "The probabilities of steps from branching cell to branching cell."
    hops: tuple[Int[np.ndarray, "part"], ...]
    "The cell 1, 2, 4, ... steps down the run; the number of cells past its end."

    @classmethod
    def of(cls, matrix: scipy.sparse.csr_array, inside: Bool[np.ndarray, "cells"]) -> "Transient":
        """Take a part out of a chain that each of its cells can leave.

        The transition matrix has no zeros among its entries.

        **Raises:** `RuntimeError` if a cell cannot leave, because it is on a circuit of certain
        steps.
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
                    "never leaves: what led here was lost in rounding"
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
        """Compute the total gain from each cell until the part is left: solve `x = gain + Q x`.

        Returns the number of products too.
        """
        run = np.zeros((self.cells.size + 1, gain.shape[1]))
        run[:-1] = gain
        run[self.branching] = 0
        for hop in self.hops:
            run[:-1] += run[hop]
        run = run[:-1]
        # A branching cell gains its own share and that of the run to the next.
        right = gain[self.branching] + self.step[self.branching] @ run
        at_branching, products = solve_transient(self.jump, right)
        return run + at_branching[self.end], products

    def visits(self, start: Float[np.ndarray, "part"]) -> tuple[Float[np.ndarray, "section"], int]:
        """Compute the expected visits to the branching cells from a distribution over the part.

        This is the adjoint of `expect`: one solve for one start and any number of gains. A cell on
        a run stays in the part, so the part is left only from branching cells. Returns the number
        of products too.
        """
        arriving = np.zeros(self.branching.size)
        np.add.at(arriving, self.end, start)
        visits, products = solve_transient(self.jump, arriving[:, None], adjoint=True)
        return visits[:, 0], products
