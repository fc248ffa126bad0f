import dataclasses
from typing import Annotated, Any, ClassVar

import jax
import numpy as np
from jaxtyping import Float

from ...base.certificate import Numbers, Real
from ...base.quantities import PROBABILITY, Checks, Result, derived, quantity
from ...base.secondary import Secondary
from ...base.wide import host_array, traced
from ...mapping import Chain, ChainLike, persistent_groups
from ...markov import dense, limiting_distribution
from ...markov.quantities import entropy_rate, hitting_matrix, kemeny_constant, mixing_time, slem
from ..team.times import hitting_check


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, eq=False)
class Measures(Result):
    """Quantities of the Markov chain of a patroller."""

    title: ClassVar[str] = "Random walk of a patroller"

    transition: Annotated[
        Float[Numbers, "vertices vertices"],
        quantity("start target", "probability of a step", "1", kind="distribution"),
    ]
    stationary: Annotated[
        Float[Numbers, "vertices"],
        quantity("vertex", "share of time in the long run", "1", kind="distribution"),
    ]
    entropy_rate_nats: Annotated[Real, quantity("", "entropy of a step in the long run", "nats")]
    hitting_time: Annotated[
        Float[Numbers, "vertices vertices"] | None,
        quantity("start target", "mean steps until first there", "steps", kind="time"),
    ] = None
    kemeny_constant: Annotated[
        Real | None,
        quantity("", "Kemeny constant: mean steps to a random vertex", "steps", kind="time"),
    ] = None
    slem: Annotated[Real | None, quantity("", "second largest modulus of an eigenvalue", "1")] = (
        None
    )
    mixing_time: Annotated[
        Real | None,
        quantity("", "steps until within 1/4 of the shares of time", "steps", kind="time"),
    ] = None
    left_out: tuple[str, ...] = dataclasses.field(default=(), metadata={"static": True})
    "Sentences about the quantities that could not be computed and are `None`."

    @derived("", "mean hitting time over pairs of vertices", "steps", kind="time")
    def mean_hitting_time(self) -> Real | None:
        vertices, times = self.stationary.size, self.hitting_time
        if times is None:
            return None
        mean = times.sum() / (vertices * (vertices - 1))
        return mean if traced(mean) else float(mean)

    @derived("start target", "mean steps there and back", "steps", kind="time")
    def commute_time(self) -> Float[Numbers, "vertices vertices"] | None:
        return None if self.hitting_time is None else self.hitting_time + self.hitting_time.T

    @derived("", "mean commute time over pairs of vertices", "steps", kind="time")
    def mean_commute_time(self) -> Real | None:
        return None if self.mean_hitting_time is None else 2 * self.mean_hitting_time

    @derived("vertex", "mean steps to it", "steps", kind="time")
    def mean_time_to(self) -> Float[Numbers, "vertices"] | None:
        times = self.hitting_time
        return None if times is None else times.sum(axis=0) / (self.stationary.size - 1)

    @derived("vertex", "probability of waiting there", "1", kind="share")
    def stay(self) -> Float[Numbers, "vertices"]:
        return self.transition.diagonal()

    def checks(self) -> Checks:
        P, share, times = self.transition, self.stationary, self.hitting_time
        checks = {"stationarity_residual": (float(np.abs(share @ P - share).sum()), PROBABILITY)}
        if times is not None:
            checks["hitting_time_residual"] = hitting_check(P, np.ones(share.size), times)
        return checks


def measure(chain: ChainLike) -> Measures:
    """Compute all quantities of [`Measures`][] for a chain of up to a few thousand vertices.

    **Arguments:** a chain that visits the same vertices in the long run, wherever it starts.

    **Returns:** [`Measures`][]; times are in steps, the entropy rate in nats per step. Times to
    vertices that are not visited in the long run are infinite. Quantities whose computation fails
    are `None`. The chain may be traced by `jit`, `vmap` and `grad`. Then quantities that fail are
    NaN, and so are those of all pairs if a vertex is not visited in the long run.

    A random walk round a triangle:

        >>> from jaxcell import patrol
        >>> graph = patrol.Graph([[0, 1], [1, 2], [2, 0]])
        >>> walk = patrol.walks.measure(patrol.random_walk(graph, [1, 1, 1]))
        >>> round(walk.mean_commute_time, 6), round(walk.kemeny_constant, 6), round(walk.slem, 6)
        (4.0, 1.333333, 0.5)
    """
    groups, beside = persistent_groups(chain), Secondary()
    core = chain
    if traced(chain):
        P = dense.matrix(chain)
    else:
        P = chain.to_scipy().toarray()
        visited = np.asarray(groups.group) == 0
        if int(groups.count) == 1 and not visited.all():
            core = Chain.from_scipy(P[np.ix_(visited, visited)])

    def times() -> Any:
        if core is chain:
            return host_array(hitting_matrix(chain).value)
        found = np.where(visited, dense.hitting(P), np.inf)
        np.fill_diagonal(found, 0)
        return found

    return Measures(
        transition=P,
        stationary=host_array(limiting_distribution(chain, groups).value),
        entropy_rate_nats=entropy_rate(core),
        hitting_time=beside.compute("the table of hitting times", times),
        kemeny_constant=beside.compute("the Kemeny constant", lambda: kemeny_constant(core)),
        slem=beside.compute("the second largest eigenvalue", lambda: slem(core)),
        mixing_time=beside.compute("the mixing time", lambda: mixing_time(core)),
        left_out=beside.left_out,
    )
