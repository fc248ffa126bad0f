import dataclasses
import itertools
from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated, Any, ClassVar

import numpy as np
import scipy.sparse
from jaxtyping import Bool, Float, Int

from ...base import memory
from ...base.quantities import PROBABILITY, Checks, Result, derived, quantity
from ...optimize import GraphLike
from ...space.copies import copies
from .idleness import long_run
from .times import check_vertex, check_walks, check_whole, move_times, names_of


# Probability of greater ages below which the law may end, and the greatest age that is computed.
_REST, _LONGEST = 1e-9, 20_000
# The probability that defines the late age, a quantile.
_LATE = 0.95


@dataclasses.dataclass(frozen=True, eq=False)
class News(Result):
    """The age of the news at a base, to which robots report whenever they visit the base."""

    title: ClassVar[str] = "Age of news at a base"
    tables: ClassVar[Mapping[str, str]] = {"vertex": "vertices"}

    base: Annotated[str, quantity("", "vertex of the base", kind="text")]
    vertex: Annotated[list[str], quantity("vertex", "vertex", kind="coordinate")]
    unit: Annotated[float, quantity("", "unit of ages", kind="time")]
    "The unit of ages in seconds; 1 if ages are numbers of steps."
    passed: Annotated[
        Float[np.ndarray, "ages"],
        quantity("age", "probability that a robot passed the base this time ago or later", "1"),
    ]
    known: Annotated[
        Float[np.ndarray, "ages vertices"],
        quantity("age vertex", "probability that news of the vertex is this old or newer", "1"),
    ]

    @derived("age", "age", kind="coordinate")
    def age(self) -> Float[np.ndarray, "ages"]:
        return self.unit * np.arange(len(self.known))

    @derived("", "time since a robot passed the base, mean", kind="time")
    def mean_since_passed(self) -> float:
        return self._mean(self.passed[:, None])[0].item()

    @derived("vertex", "age of its news at the base, mean", kind="time")
    def mean_age(self) -> Float[np.ndarray, "vertices"]:
        return self._mean(self.known)

    @derived("vertex", "age that 95 % of the news do not exceed", kind="time")
    def late_age(self) -> Float[np.ndarray, "vertices"]:
        late = self.known >= _LATE
        return np.where(late.any(axis=0), self.unit * late.argmax(axis=0), np.inf)

    def checks(self) -> Checks:
        falls = -np.diff(self.known, axis=0, prepend=0).min(initial=0)
        later = (self.known - self.passed[:, None]).max(initial=0)
        return {"news_newer_than_the_robot": (float(max(falls, later)), PROBABILITY)}

    def _mean(self, law: Float[np.ndarray, "ages columns"]) -> Float[np.ndarray, "columns"]:
        """Compute the mean age from a distribution function; infinite if `law` does not reach 1."""
        tails = 1 - law
        return np.where(tails[-1] < 1e-6, self.unit * tails.sum(axis=0), np.inf)


def age_of_news(
    graph: GraphLike,
    matrices: Float[np.ndarray, "robots vertices vertices"],
    base: int,
    *,
    times: Any = None,
    unit: float = 1.0,
    names: Sequence[str] | None = None,
) -> News:
    """Compute the exact probability distribution of the age of news at a base.

    A robot sees a vertex when it is at the vertex, and reports when it is at the base. The news of
    a vertex is as old as the last visit to the vertex after which the same robot has been at the
    base. Backward in time, a robot is also a Markov chain, with `pi_j p_ji / pi_i` in place of
    `p_ij`: the age of its news is the backward time to the base and from there to the vertex.
    Robots are independent, and distributed as in the long run. An edge that takes several units of
    time is divided by additional vertices into edges of one unit.

    **Arguments:**

    - `graph`, `matrices`: the graph, and the transition matrix of each robot.
    - `base`: the vertex of the base.
    - `times`: integer array `[edges]`, units of time that an edge takes; by default 1.
    - `unit`: length of a unit, in seconds.
    - `names`: names of the vertices; by default their numbers.

    **Returns:** [`News`][], up to an age that is exceeded with a probability below 1e-9, or up to
    20,000 units.

    A robot that goes round a triangle visits the base at every third step:

        >>> import numpy as np
        >>> from jaxcell import patrol
        >>> ring = patrol.Graph([[0, 1], [1, 2], [2, 0]])
        >>> news = patrol.team.age_of_news(ring, np.roll(np.eye(3), 1, axis=1)[None], 0)
        >>> news.known.round(3).tolist()[:3], news.mean_age.round(3).tolist()
        ([[0.333, 0.0, 0.0], [0.667, 0.0, 0.333], [1.0, 0.333, 0.667]], [1.0, 3.0, 2.0])
    """
    check_vertex("base", base, graph.vertices)
    check_walks(graph, matrices)
    units = check_whole("times", 1 if times is None else times, len(graph.edges), "edge")
    if not 0 < unit < np.inf:
        raise ValueError(f"unit: expected a positive finite number, got {unit}")
    called = names_of(graph.vertices, names)
    delays = move_times(graph, units).astype(np.int64)
    # A matrix of each robot, and the chances of its states since the news of each vertex.
    states = int(delays[(np.asarray(matrices) > 0).any(axis=0)].sum())
    memory.check(
        len(matrices) * states * 8 * (3 * graph.vertices + 16),
        f"the age of news with {states:,} units of travel time",
        "expected times in a longer unit",
    )
    robots = [_backward(matrix, delays, base, graph.vertices) for matrix in matrices]
    heard = np.any([brought for brought, _ in robots], axis=0)
    missed: list[float] = []
    unheard: list[np.ndarray] = []
    for now in itertools.islice(zip(*(law for _, law in robots), strict=True), _LONGEST):
        away, later = zip(*now, strict=True)
        missed.append(float(np.prod(away)))
        unheard.append(np.prod(later, axis=0))
        if unheard[-1][heard].max(initial=0) < _REST:
            break
    return News(called[base], called, unit, 1 - np.array(missed), 1 - np.array(unheard))


def _backward(
    matrix: Float[np.ndarray, "vertices vertices"],
    delays: Int[np.ndarray, "vertices vertices"],
    base: int,
    vertices: int,
) -> tuple[Bool[np.ndarray, "vertices"], Iterator[tuple[float, Float[np.ndarray, "vertices"]]]]:
    """Follow a robot backward in time: from the base, where news arrives, to each vertex.

    **Returns:** a mask of the vertices whose news the robot brings to the base in the long run; and
    an iterator over ages, which yields the probability that the last visit to the base is longer
    ago, and for each vertex the probability that its news at the base is older.
    """
    whole = with_vertices_on_the_way(matrix, delays)
    (share,) = long_run([whole])
    often = np.divide(1.0, share, out=np.zeros_like(share), where=share > 0)
    back = (scipy.sparse.diags_array(share) @ whole @ scipy.sparse.diags_array(often)).tocsr()

    def law() -> Iterator[tuple[float, Float[np.ndarray, "vertices"]]]:
        here = np.arange(vertices)
        # The probability of each place before a visit to the base; and after a visit to the base,
        # but before the visit to each vertex.
        before, since = share.copy(), np.zeros((share.size, vertices))
        while True:
            since[base] += before[base]
            before[base] = since[here, here] = 0
            yield float(before.sum()), before.sum() + since.sum(axis=0)
            before, since = back @ before, back @ since

    return (share[:vertices] > 0) & (share[base] > 0), law()


def with_vertices_on_the_way(
    matrix: Float[np.ndarray, "vertices vertices"], delays: Int[np.ndarray, "vertices vertices"]
) -> scipy.sparse.csr_array:
    """Replace each step of several units of time by a chain of steps of one unit.

    The additional states on these chains are numbered after the vertices."""
    tails, heads = np.nonzero(matrix)
    units = delays[tails, heads]
    step, since = copies(units)
    # The additional state after each unit of time, unless it is the last unit of a step.
    state = len(matrix) + np.arange(step.size) - step
    here = np.where(since == 0, tails[step], state - 1)
    there = np.where(since == units[step] - 1, heads[step], state)
    chance = np.where(since == 0, matrix[tails, heads][step], 1.0)
    states = len(matrix) + step.size - units.size
    return scipy.sparse.csr_array((chance, (here, there)), shape=(states, states))
