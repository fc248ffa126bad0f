import dataclasses
from typing import Annotated, ClassVar

import numpy as np
from jaxtyping import Float

from ...base.quantities import PROBABILITY, Checks, Result, derived, quantity
from ...mapping import Chain, persistent_groups
from ...markov import dense, limiting_distribution
from ...markov.quantities import entropy_rate, hitting_matrix, kemeny_constant, mixing_time, slem
from ..team.times import hitting_check


@dataclasses.dataclass(frozen=True, eq=False)
class Measures(Result):
    """Quantities of the Markov chain of a patroller, as NumPy arrays."""

    title: ClassVar[str] = "Random walk of a patroller"

    transition: Annotated[
        Float[np.ndarray, "vertices vertices"],
        quantity("start target", "probability of a step", "1", kind="distribution"),
    ]
    stationary: Annotated[
        Float[np.ndarray, "vertices"],
        quantity("vertex", "share of time in the long run", "1", kind="distribution"),
    ]
    hitting_time: Annotated[
        Float[np.ndarray, "vertices vertices"],
        quantity("start target", "mean steps until first there", "steps", kind="time"),
    ]
    mean_hitting_time: Annotated[
        float, quantity("", "mean hitting time over pairs of vertices", "steps", kind="time")
    ]
    kemeny_constant: Annotated[
        float, quantity("", "Kemeny constant: mean steps to a random vertex", "steps", kind="time")
    ]
    entropy_rate_nats: Annotated[float, quantity("", "entropy of a step in the long run", "nats")]
    slem: Annotated[float, quantity("", "second largest modulus of an eigenvalue", "1")]
    mixing_time: Annotated[
        float, quantity("", "steps until within 1/4 of the shares of time", "steps", kind="time")
    ]

    @derived("start target", "mean steps there and back", "steps", kind="time")
    def commute_time(self) -> Float[np.ndarray, "vertices vertices"]:
        return self.hitting_time + self.hitting_time.T

    @derived("", "mean commute time over pairs of vertices", "steps", kind="time")
    def mean_commute_time(self) -> float:
        return 2 * self.mean_hitting_time

    @derived("vertex", "mean steps to it", "steps", kind="time")
    def mean_time_to(self) -> Float[np.ndarray, "vertices"]:
        return self.hitting_time.sum(axis=0) / (self.stationary.size - 1)

    @derived("vertex", "probability of waiting there", "1", kind="share")
    def stay(self) -> Float[np.ndarray, "vertices"]:
        return np.diag(self.transition)

    def checks(self) -> Checks:
        P, share, times = self.transition, self.stationary, self.hitting_time
        return {
            "stationarity_residual": (float(np.abs(share @ P - share).sum()), PROBABILITY),
            "hitting_time_residual": hitting_check(P, np.ones(share.size), times),
        }


def measure(chain: Chain) -> Measures:
    """Compute all quantities of [`Measures`][] for a chain of up to a few thousand vertices.

    **Arguments:** a chain that visits the same vertices in the long run, wherever it starts.

    **Returns:** [`Measures`][]; times are in steps, the entropy rate in nats per step. Times to
    vertices that are not visited in the long run are infinite.

    A random walk round a triangle:

        >>> from jaxcell import patrol
        >>> graph = patrol.Graph([[0, 1], [1, 2], [2, 0]])
        >>> walk = patrol.walks.measure(patrol.random_walk(graph, [1, 1, 1]))
        >>> round(walk.mean_commute_time, 6), round(walk.kemeny_constant, 6), round(walk.slem, 6)
        (4.0, 1.333333, 0.5)
    """
    groups = persistent_groups(chain)
    P, vertices = chain.to_scipy().toarray(), chain.cells
    visited = np.asarray(groups.group) == 0
    if int(groups.count) == 1 and not visited.all():
        core = Chain.from_scipy(P[np.ix_(visited, visited)])
        times = np.where(visited, dense.hitting(P), np.inf)
        np.fill_diagonal(times, 0)
    else:
        core, times = chain, np.asarray(hitting_matrix(chain).value)
    return Measures(
        transition=P,
        stationary=np.asarray(limiting_distribution(chain, groups).value),
        hitting_time=times,
        mean_hitting_time=float(times.sum() / (vertices * (vertices - 1))),
        kemeny_constant=kemeny_constant(core),
        entropy_rate_nats=entropy_rate(core),
        slem=slem(core),
        mixing_time=mixing_time(core),
    )
