import dataclasses
import functools
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int

from ..base.shown import Shown
from .hidden import FEW, Estimate, HiddenMap


if TYPE_CHECKING:
    import scipy.sparse


@dataclasses.dataclass(frozen=True, eq=False)
class Bounded(Shown):
    """A filter whose state is the set of possible cells, for maps with several images per cell.

    If each step of the robot is possible on the map, the set always contains the robot's cell. An
    observation may make the set larger, because a cell has several images.

    A robot in one of three cells in a row moves on or stays, and bumps at the end:

        >>> import numpy as np
        >>> from jaxcell import automata
        >>> moves = np.array([[0.5, 0.5, 0], [0, 0.5, 0.5], [0, 0, 0]])
        >>> bumps = np.diag([0.0, 0.0, 1.0])
        >>> hidden = automata.HiddenMap.of(moves, bumps, np.arange(3), np.ones(3) / 3)
        >>> sets = automata.Bounded.of(hidden)
        >>> sets.observe(sets.observe(sets.start(), 1), 1).tolist()
        [2]
    """

    images: "tuple[tuple[scipy.sparse.csr_array, ...], tuple[scipy.sparse.csr_array, ...]]"
    """For each observation, matrices whose product is `True` at `[i, j]` if a robot may move from
    cell `i` to cell `j`. If a matrix has fewer rows than there are cells, each row stands for a
    block of consecutive cells, which move together."""
    configuration: Int[np.ndarray, "cells"]
    "The number of the configuration that contains each cell."
    start_weight: Float[np.ndarray, "cells"]
    "A positive number for each cell in which the robot may start, 0 for other cells."

    @classmethod
    def of(cls, hidden: HiddenMap) -> "Bounded":
        """Build the filter of a hidden map with one angle, from moves of positive probability."""
        if hidden.angles > 1:
            raise ValueError(f"hidden: expected a map of one angle, got {hidden.angles}")
        moves, bumps = (part > 0 for part in (hidden.moves, hidden.bumps[0]))
        return cls(((moves,), (bumps,)), hidden.configuration, hidden.start)

    @functools.cached_property
    def _arriving(self) -> "tuple[tuple[scipy.sparse.csr_array, ...], ...]":
        return tuple(tuple(part.T.tocsr() for part in parts) for parts in self.images)

    def start(self) -> Int[np.ndarray, "cells"]:
        """Return the possible cells before the first observation, in ascending order."""
        return np.flatnonzero(self.start_weight).astype(np.int32)

    def observe(self, state: Int[np.ndarray, "cells"], observation: int) -> Int[np.ndarray, "_"]:
        """Return the possible cells after an observation, 0 or 1; no cells if it is impossible."""
        possible = np.zeros(self.configuration.size, bool)
        possible[state] = True
        both = zip(self.images[observation], self._arriving[observation], strict=True)
        for leaving, arriving in both:
            block = possible.size // leaving.shape[0]
            if block == 1 and np.count_nonzero(possible) < FEW * possible.size:
                ends = leaving[np.flatnonzero(possible)].indices
                possible = np.zeros(leaving.shape[1], bool)
                possible[ends] = True
            else:
                possible = (arriving @ possible.reshape(-1, block)).ravel()
        return np.flatnonzero(possible).astype(np.int32)

    def estimate(self, state: Int[np.ndarray, "cells"]) -> Estimate:
        """Return the configurations of the cells; without cells the robot is nowhere on the map."""
        cells = np.flatnonzero(np.bincount(self.configuration[state])).astype(np.int32)
        return Estimate(cells, np.full(cells.size, 1 / max(1, cells.size)), float(cells.size == 0))
