import dataclasses
import functools
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int

from .hidden import FEW, Estimate, HiddenMap
from .subset import Automaton


if TYPE_CHECKING:
    import scipy.sparse


# Default of the largest total size of the sets of an automaton.
_LIMIT = 10_000_000


@dataclasses.dataclass(frozen=True, eq=False)
class Bounded:
    """The sets of cells that observations leave possible, for maps with several images per cell.

    The sets always contain a robot that behaves as the map allows, and they may grow.

    A robot in one of three cells in a row, which moves on or stays, and bumps at the end:

        >>> import numpy as np
        >>> from jaxcell import automata
        >>> moves = np.array([[0.5, 0.5, 0], [0, 0.5, 0.5], [0, 0, 0]])
        >>> bumps = np.diag([0.0, 0.0, 1.0])
        >>> hidden = automata.HiddenMap.of(moves, bumps, np.arange(3), np.ones(3) / 3)
        >>> sets = automata.Bounded.of(hidden)
        >>> sets.observe(sets.observe(sets.start(), 1), 1).tolist()
        [2]
        >>> sets.automaton().transition.tolist()
        [[0, 1], [-1, 1]]
    """

    images: "tuple[tuple[scipy.sparse.csr_array, ...], tuple[scipy.sparse.csr_array, ...]]"
    """For observation 0 and 1, matrices that are applied one after the other: a robot may move from
    a row to a column with an entry `True`. Each row and column of a smaller matrix stands for a
    block of cells, and leads to the corresponding cells of other blocks."""
    configuration: Int[np.ndarray, "cells"]
    "The configuration of each cell."
    start_weight: Float[np.ndarray, "cells"]
    "A distribution over the cells at the start; only its support matters."

    @classmethod
    def of(cls, hidden: HiddenMap) -> "Bounded":
        """Make the sets of possible cells of a hidden map with one angle.

        **Raises:** `ValueError` for a map with several angles.
        """
        if hidden.angles > 1:
            raise ValueError(f"hidden: expected a map of one angle, got {hidden.angles}")
        moves, bumps = (part > 0 for part in (hidden.moves, hidden.bumps[0]))
        return cls(((moves,), (bumps,)), hidden.configuration, hidden.start)

    @functools.cached_property
    def _arriving(self) -> "tuple[tuple[scipy.sparse.csr_array, ...], ...]":
        return tuple(tuple(part.T.tocsr() for part in parts) for parts in self.images)

    def start(self) -> Int[np.ndarray, "cells"]:
        """Return the possible cells before the first observation, ascending."""
        return np.flatnonzero(self.start_weight).astype(np.int32)

    def observe(self, state: Int[np.ndarray, "cells"], observation: int) -> Int[np.ndarray, "_"]:
        """Return the possible cells after an observation, 0 or 1; none if it is impossible."""
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
        """Return the configurations of the set; if there are none, the robot is surely nowhere."""
        cells = np.flatnonzero(np.bincount(self.configuration[state])).astype(np.int32)
        return Estimate(cells, np.full(cells.size, 1 / max(1, cells.size)), float(cells.size == 0))

    def automaton(self, *, limit: int = _LIMIT) -> Automaton:
        """Make the automaton of the sets for all observation strings.

        **Raises:** `ValueError` if the sets have more than `limit` cells in all; then use
        [`Bounded.observe`][].
        """
        sets, number = [self.start()], {self.start().tobytes(): 0}
        transition, members, state = [], sets[0].size, 0
        while state < len(sets):
            after = [-1, -1]
            for bit in (0, 1):
                possible = self.observe(sets[state], bit)
                if not possible.size:
                    continue
                after[bit] = number.setdefault(possible.tobytes(), len(sets))
                if after[bit] == len(sets):
                    sets.append(possible)
                    members += possible.size
                if members > limit:
                    raise ValueError(
                        f"the sets of the first {len(sets)} states have {members} members, more "
                        f"than the limit of {limit}; follow sets one observation at a time instead"
                    )
            transition.append(after)
            state += 1
        ends = np.cumsum([0, *map(len, sets)], dtype=np.int64)
        return Automaton(np.array(transition, np.int32), ends, np.concatenate(sets))
