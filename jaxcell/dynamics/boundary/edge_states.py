import dataclasses

import numpy as np
from jaxtyping import Complex, Float, Int

from ...base.shown import Shown


@dataclasses.dataclass(frozen=True, eq=False)
class EdgeStates(Shown):
    """Edge states: saddles on boundaries of basins, which attract the orbits on the boundary."""

    first: Int[np.ndarray, "edges"]
    "The attractor on one side of each edge state, the one with the smaller number."
    second: Int[np.ndarray, "edges"]
    "The attractor on the other side of each edge state."
    point: Float[np.ndarray, "edges axes"]
    "A point of each edge state."
    period: Int[np.ndarray, "edges"]
    "The period in mappings, from 1 to 8; 0 for other states, such as chaos or a cycle of a flow."
    multipliers: Complex[np.ndarray, "edges axes"]
    "Eigenvalues of the map's derivative over one period, the largest first; NaN if `period` is 0."
    orbit: Float[np.ndarray, "edges window axes"]
    "Successive points of an orbit near each edge state, padded with NaN."

    @property
    def unstable(self) -> Int[np.ndarray, "edges"]:
        """Number of unstable directions of each edge state, or -1 if the state has no period."""
        count = np.count_nonzero(np.abs(self.multipliers) > 1, axis=1)
        return np.where(self.period > 0, count, -1)
