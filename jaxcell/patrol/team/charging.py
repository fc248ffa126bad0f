import dataclasses
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar

import numpy as np
import scipy.sparse.csgraph
from jaxtyping import Float, Int

from ...base.quantities import Result, derived, quantity
from ...optimize import Graph
from .idleness import idleness_over_vertices, long_run


@dataclasses.dataclass(frozen=True, eq=False)
class Charged(Result):
    """A walk that is back at a charger every so many steps, and what it achieves."""

    title: ClassVar[str] = "Walk that returns to a charger"
    tables: ClassVar[Mapping[str, str]] = {"vertex": "vertices"}

    charger: Annotated[str, quantity("", "vertex of the charger", kind="text")]
    every: Annotated[int, quantity("", "steps between charges, at most", "steps", kind="count")]
    chance: Annotated[
        Float[np.ndarray, "ages starts targets"],
        quantity(
            "since start target", "probability of a step, by those since the charge", kind="share"
        ),
    ]
    share: Annotated[
        Float[np.ndarray, "vertices"],
        quantity("vertex", "share of time in the long run", "1", kind="share"),
    ]
    interval: Annotated[
        Float[np.ndarray, "intervals"],
        quantity("interval", "probability of this time between charges", "1", kind="share"),
    ]
    least_capture: Annotated[
        float | None,
        quantity("", "least capture within the attack time, robot where worst", "1", kind="share"),
    ] = None

    @derived("since", "steps since the charge", "steps", kind="coordinate")
    def since(self) -> Int[np.ndarray, "ages"]:
        return np.arange(self.every)

    @derived("interval", "steps between charges", "steps", kind="coordinate")
    def intervals(self) -> Int[np.ndarray, "intervals"]:
        return np.arange(1, self.every + 1)

    @derived("", "steps between charges, mean", "steps", kind="time")
    def mean_interval(self) -> float:
        return float(self.interval @ np.arange(1, self.every + 1))

    @derived("vertex", "steps between visits, mean", "steps", kind="time")
    def idleness(self) -> Float[np.ndarray, "vertices"]:
        return 1 / self.share

    mean_idleness, worst_idleness = idleness_over_vertices("steps")


def charged(
    graph: Graph,
    matrix: Float[np.ndarray, "vertices vertices"],
    charger: int,
    every: int,
    *,
    attack_time: Any = None,
    name: str = "",
) -> Charged:
    """A walk kept near enough to a charger, and its law, exactly.

    From each vertex the robot draws among those steps of the walk after which it can still be at
    the charger in time; where the walk has none, it goes to any neighbour that leads there. Where
    it goes depends on the steps since the charge: the vertices times these are the states of a
    Markov chain, from which all numbers come.

    **Arguments:**

    - `graph`: a connected graph.
    - `matrix`: the transition matrix of the walk.
    - `charger`: the vertex of the charger; being there is enough.
    - `every`: the most steps from one time there to the next.
    - `attack_time`: how many steps an attack takes, one number or array `[vertices]`.
    - `name`: of the charger.

    **Returns:** [`Charged`][].

    **Raises:** `ValueError` if a vertex is too far away to go there and come back in time.

    A robot on a line of three is at one end every fourth step, at least:

        >>> import numpy as np
        >>> from jaxcell import patrol
        >>> line = patrol.Graph([[0, 1], [1, 2]])
        >>> walk = np.array([[0, 1, 0], [0.5, 0, 0.5], [0, 1, 0]])
        >>> found = patrol.charged(line, walk, 0, 4)
        >>> found.interval.round(3).tolist(), found.share.round(3).tolist()
        ([0.0, 0.5, 0.0, 0.5], [0.333, 0.5, 0.167])
    """
    vertices = graph.vertices
    beside = graph.matrix(np.ones(len(graph.edges))).toarray()
    hops = scipy.sparse.csgraph.shortest_path(beside, indices=charger)
    if not every >= 2 * hops.max():
        raise ValueError(
            f"every: expected at least {2 * hops.max():.0f} steps, to the farthest vertex and "
            f"back, got {every}"
        )
    chance = np.zeros((every, vertices, vertices))
    for age in range(every):
        in_time = hops <= every - age - 1
        drawn = np.where(in_time, matrix, 0.0)
        stuck = drawn.sum(axis=1) <= 0
        drawn[stuck] = np.where(in_time, beside, 0.0)[stuck]
        total = drawn.sum(axis=1, keepdims=True)
        # From where it is too late the robot never is.
        chance[age] = np.divide(drawn, total, out=np.zeros_like(drawn), where=total > 0)
    whole = _product(chance, charger)
    share = long_run([whole])[0].reshape(every, vertices)
    # The chances to be at each vertex so long after a charge, and then at the charger.
    first = share / share[0, charger]
    interval = np.array([first[age] @ chance[age, :, charger] for age in range(every)])
    least = None
    if attack_time is not None:
        attack = np.broadcast_to(np.asarray(attack_time, np.int64), vertices)
        least = _least_capture(whole, share.ravel() > 0, attack)
    return Charged(name or str(charger), every, chance, share.sum(axis=0), interval, least)


def _product(
    chance: Float[np.ndarray, "ages vertices vertices"], charger: int
) -> scipy.sparse.csr_array:
    """The chain on steps since the charge and vertices; what is never reached goes to charge."""
    every, vertices, _ = chance.shape
    age, tail, head = np.nonzero(chance)
    here = age * vertices + tail
    there = np.where(head == charger, charger, (age + 1) % every * vertices + head)
    lost = np.flatnonzero(chance.sum(axis=2).ravel() == 0)
    numbers = np.concatenate([chance[age, tail, head], np.ones(lost.size)])
    ends = np.append(here, lost), np.append(there, np.full(lost.size, charger))
    return scipy.sparse.csr_array((numbers, ends), shape=(every * vertices,) * 2)


def _least_capture(
    whole: scipy.sparse.csr_array,
    visited: Any,
    attack: Int[np.ndarray, "vertices"],
) -> float:
    """The least probability to come to a vertex in time, from any state that occurs."""
    vertices = attack.size
    away = np.tile(1 - np.eye(vertices), (whole.shape[0] // vertices, 1))
    late, least = away, np.ones(vertices)
    for time in range(1, int(attack.max()) + 1):
        missed = whole @ late
        due = attack == time
        least[due] = 1 - missed[visited][:, due].max(axis=0)
        late = away * missed
    return float(least.min())
