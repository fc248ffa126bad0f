import dataclasses

import numpy as np
from jaxtyping import Float

from ...mapping import Chain, persistent_groups
from ...markov import limiting_distribution
from ...markov.quantities import (
    entropy_rate,
    hitting_matrix,
    kemeny_constant,
    mixing_time,
    slem,
)


@dataclasses.dataclass(frozen=True, eq=False)
class Measures:
    """What there is to know of a patroller's chain, on the host."""

    transition: Float[np.ndarray, "vertices vertices"]
    "The probability of a step from the vertex of the row to that of the column."
    stationary: Float[np.ndarray, "vertices"]
    "The share of time at each vertex in the long run."
    hitting_times: Float[np.ndarray, "vertices vertices"]
    "The expected number of steps from the vertex of the row until first at that of the column."
    mean_hitting_time: float
    "Over pairs of different vertices."
    kemeny_constant: float
    "The expected number of steps to a vertex drawn from the stationary distribution."
    entropy_rate: float
    "The entropy of a step in the long run, in nats."
    slem: float
    "The second largest eigenvalue modulus."
    mixing_time: float
    "The steps until within 1/4 of the stationary distribution in total variation."

    @property
    def commute_times(self) -> Float[np.ndarray, "vertices vertices"]:
        """The expected number of steps there and back."""
        return self.hitting_times + self.hitting_times.T

    @property
    def mean_commute_time(self) -> float:
        """Over pairs of different vertices."""
        return 2 * self.mean_hitting_time


def measure(chain: Chain) -> Measures:
    """All quantities of [`Measures`][], for a chain of up to some thousand vertices.

    **Arguments:**

    - `chain`: an irreducible chain.

    **Returns:** [`Measures`][]; times are in steps, the entropy rate in nats a step.

    **Raises:** as [`jaxcell.markov.hitting_matrix`][] and [`jaxcell.markov.mixing_time`][].

    A random walk round a triangle:

        >>> from jaxcell import patrol
        >>> graph = patrol.Graph([[0, 1], [1, 2], [2, 0]])
        >>> found = patrol.measure(patrol.random_walk(graph, [1, 1, 1]))
        >>> round(found.mean_commute_time, 6), round(found.kemeny_constant, 6), round(found.slem, 6)
        (4.0, 1.333333, 0.5)
    """
    times = np.asarray(hitting_matrix(chain).value)
    vertices = chain.cells
    return Measures(
        chain.to_scipy().toarray(),
        np.asarray(limiting_distribution(chain, persistent_groups(chain)).value),
        times,
        float(times.sum() / (vertices * (vertices - 1))),
        kemeny_constant(chain),
        entropy_rate(chain),
        slem(chain),
        mixing_time(chain),
    )
