import dataclasses
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar

import numpy as np
import scipy.sparse.csgraph
from jaxtyping import Bool, Float, Int

from ...base.connected import check_connected
from ...base.quantities import Result, derived, quantity
from ...optimize import Graph, GraphLike
from ..walks.arrival import captured_by_any
from .idleness import RobotShares, idleness_over_vertices, steps_between_visits
from .times import check_vertex, check_walks, names_of


# Largest number of step probabilities of a robot, by steps since the charge, at 8 bytes each.
_MAX_CHANCES = 50_000_000


@dataclasses.dataclass(frozen=True, eq=False)
class Charged(Result):
    """Walks that return to a charger after at most `every` steps, and their statistics."""

    title: ClassVar[str] = "Walks that return to a charger"
    tables: ClassVar[Mapping[str, str]] = {"vertex": "vertices"}

    charger: Annotated[str, quantity("", "vertex of the charger", kind="text")]
    vertex: Annotated[list[str], quantity("vertex", "vertex", kind="coordinate")]
    every: Annotated[int, quantity("", "steps between charges, at most", "steps", kind="count")]
    chance: Annotated[
        Float[np.ndarray, "robots ages starts targets"],
        quantity(
            "robot since start target",
            "probability of a step, by those since the charge",
            kind="share",
        ),
    ]
    shares: RobotShares
    interval: Annotated[
        Float[np.ndarray, "intervals"],
        quantity("interval", "probability of this time between charges", "1", kind="share"),
    ]
    "The distribution of the number of steps between charges, averaged over robots."
    least_capture: Annotated[
        float | None,
        quantity("", "least capture in the attack time from the worst starts", "1", kind="share"),
    ] = None
    led_back: Annotated[
        float | None,
        quantity("", "least capture of walks without a charger, led to one", "1", kind="share"),
    ] = None
    """The least probability of capture by walks that were optimised without a charger, after
    [`charged`][] has modified them to return to one."""
    late_gain: Annotated[
        float | None,
        quantity("", "share of capture that the last quarter of the steps added", kind="residual"),
    ] = None

    @classmethod
    def of(
        cls,
        chance: Float[np.ndarray, "robots ages starts targets"],
        charger: int,
        *,
        attack_time: Any = None,
        names: Sequence[str] | None = None,
    ) -> "Charged":
        """Compute the statistics of walks whose steps depend on the number of steps since a charge.

        `chance` contains the probability of each step, 0 in states that never occur."""
        robots, every, vertices, _ = chance.shape
        often, interval = np.zeros((robots, every, vertices)), np.zeros((robots, every))
        here = np.tile(np.eye(vertices)[charger], (robots, 1))
        for age in range(every):
            often[:, age] = here
            here = np.einsum("ri,rij->rj", here, chance[:, age])
            interval[:, age] = here[:, charger]
            here[:, charger] = 0
        least = None
        if attack_time is not None:
            attack = np.broadcast_to(np.asarray(attack_time, np.int64), vertices)
            each = [
                _captured(steps, visited, charger, attack)
                for steps, visited in zip(chance, often > 0, strict=True)
            ]
            least = float(captured_by_any(np.array(each)[:, None]).min())
        shares = often.sum(axis=1) / often.sum(axis=(1, 2))[:, None]
        mean = interval.mean(axis=0)
        called = names_of(vertices, names)
        return cls(called[charger], called, every, chance, shares, mean, least)

    @derived("since", "steps since the charge", "steps", kind="coordinate")
    def since(self) -> Int[np.ndarray, "ages"]:
        return np.arange(self.every)

    @derived("interval", "steps between charges", "steps", kind="coordinate")
    def intervals(self) -> Int[np.ndarray, "intervals"]:
        return np.arange(1, self.every + 1)

    @derived("", "steps between charges, mean", "steps", kind="time")
    def mean_interval(self) -> float:
        return float(self.interval @ np.arange(1, self.every + 1))

    @derived("vertex", "share of time in the long run, mean over robots", "1", kind="share")
    def share(self) -> Float[np.ndarray, "vertices"]:
        return self.shares.mean(axis=0)

    @derived("vertex", "steps between visits by any robot, mean", "steps", kind="time")
    def idleness(self) -> Float[np.ndarray, "vertices"]:
        return steps_between_visits(self.shares)

    mean_idleness, worst_idleness = idleness_over_vertices("steps")


def charged(
    graph: GraphLike,
    matrices: Float[np.ndarray, "robots vertices vertices"],
    charger: int,
    every: int,
    *,
    attack_time: Any = None,
    names: Sequence[str] | None = None,
) -> Charged:
    """Modify walks so that they return to a charger in time, and compute their exact statistics.

    A robot draws its next step among those of its walk after which it can still reach the charger
    in time. If there is none, it goes to a random neighbour from which it can reach the charger in
    time. So its steps depend on the number of steps since the last charge. Robots are independent.

    **Arguments:**

    - `graph`, `matrices`: a connected graph, and the transition matrix of each robot.
    - `charger`: the vertex of the charger; a visit charges the robot.
    - `every`: the largest number of steps from one charge to the next.
    - `attack_time`: number of steps that an attack takes, one number or array `[vertices]`.
    - `names`: names of the vertices; by default their numbers.

    **Returns:** [`Charged`][].

    A robot on a line of three vertices returns to one end within four steps:

        >>> import numpy as np
        >>> from jaxcell import patrol
        >>> line = patrol.Graph([[0, 1], [1, 2]])
        >>> walk = np.array([[[0, 1, 0], [0.5, 0, 0.5], [0, 1, 0]]])
        >>> result = patrol.team.charged(line, walk, 0, 4)
        >>> result.interval.round(3).tolist(), result.share.round(3).tolist()
        ([0.0, 0.5, 0.0, 0.5], [0.333, 0.5, 0.167])
    """
    check_walks(graph, matrices)
    check_connected(graph.vertices, graph.edges)
    beside = graph.matrix(np.ones(len(graph.edges))).toarray()
    in_time = in_time_for_charge(graph, charger, every)[:, None, :]
    drawn = np.where(in_time, matrices[:, None], 0.0)
    stuck = drawn.sum(axis=3, keepdims=True) <= 0
    drawn = np.where(stuck, np.where(in_time, beside, 0.0), drawn)
    total = drawn.sum(axis=3, keepdims=True)
    # States from which the charger is too far never occur.
    chance = np.divide(drawn, total, out=np.zeros_like(drawn), where=total > 0)
    return Charged.of(chance, charger, attack_time=attack_time, names=names)


def in_time_for_charge(graph: Graph, charger: int, every: int) -> Bool[np.ndarray, "ages vertices"]:
    """Return a mask of the vertices to which a robot may step and still reach the charger in time.

    Row `k` is for a robot that was charged `k` steps ago.
    """
    check_vertex("charger", charger, graph.vertices)
    beside = graph.matrix(np.ones(len(graph.edges)))
    hops = scipy.sparse.csgraph.shortest_path(beside, unweighted=True, indices=charger)
    if not every >= 2 * hops.max():
        raise ValueError(
            f"every: expected at least {2 * hops.max():.0f} steps, to the farthest vertex and "
            f"back, got {every}"
        )
    most = _MAX_CHANCES // graph.vertices**2
    if every > most:
        raise ValueError(
            f"every: expected at most {most:,} steps on {graph.vertices:,} vertices, got {every:,}"
        )
    return hops <= every - 1 - np.arange(every)[:, None]


def _captured(
    chance: Float[np.ndarray, "ages vertices vertices"],
    visited: Bool[np.ndarray, "ages vertices"],
    charger: int,
    attack: Int[np.ndarray, "vertices"],
) -> Float[np.ndarray, "vertices"]:
    """Compute the least capture at each vertex, for attacks that begin in the states `visited`."""
    away, least = 1 - np.eye(attack.size), np.ones(attack.size)
    late = np.broadcast_to(away, chance.shape)
    for time in range(1, int(attack.max()) + 1):
        after = np.roll(late, -1, axis=0)
        after[:, charger] = late[0, charger]
        missed = chance @ after
        due = attack == time
        least[due] = 1 - missed[visited][:, due].max(axis=0)
        late = away * missed
    return least
