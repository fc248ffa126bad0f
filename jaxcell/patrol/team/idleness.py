import dataclasses
import heapq
import math
from collections.abc import Callable, Iterable, Mapping
from functools import cached_property
from operator import attrgetter
from typing import Annotated, Any, ClassVar, TypeAlias

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from ...base.certificate import Numbers
from ...base.quantities import Result, derived, quantity
from ...base.wide import host_array
from ...mapping import Chain, persistent_groups
from ...markov import limiting_distribution
from ...optimize import GraphLike, shortest_tour
from .times import check_walks, edge_times, move_times


# Least number of moves of a simulation, in total and per vertex.
_MOVES, _VISITS = 20_000, 50
# Number of parts of a simulation, whose means determine the standard error.
_BATCHES = 10
# Share of the time that is ignored at the start, when no vertex has been visited yet.
_BEFORE = 0.1
# Decimals of times in a simulation, whose unit is the least travel time.
_DECIMALS = 9

RobotShares: TypeAlias = Annotated[
    Float[np.ndarray, "robots vertices"],
    quantity("robot vertex", "share of time in the long run of each robot", "1", kind="share"),
]
# A function of a robot, its vertex, and the times of the last visits, that returns the next vertex.
_Next = Callable[[int, int, Float[np.ndarray, "vertices"]], int]


@dataclasses.dataclass(frozen=True, eq=False)
class Idleness(Result):
    """Statistics of the times between visits to vertices, from one simulation of each patrol."""

    title: ClassVar[str] = "Idleness of patrols"
    tables: ClassVar[Mapping[str, str]] = {"patrol": "patrols"}

    patrol: Annotated[list[str], quantity("patrol", "patrol", kind="coordinate")]
    mean: Annotated[
        Float[np.ndarray, "patrols"],
        quantity("patrol", "time between visits, mean over vertices", kind="time"),
    ]
    mean_error: Annotated[
        Float[np.ndarray, "patrols"], quantity("patrol", "standard error of the mean", kind="time")
    ]
    worst: Annotated[
        Float[np.ndarray, "patrols"],
        quantity("patrol", "at the vertex where it is longest", kind="time"),
    ]
    worst_error: Annotated[
        Float[np.ndarray, "patrols"], quantity("patrol", "standard error of the worst", kind="time")
    ]
    longest: Annotated[
        Float[np.ndarray, "patrols"],
        quantity("patrol", "longest time between two visits", kind="time"),
    ]
    least_capture: Annotated[
        Float[np.ndarray, "patrols"] | None,
        quantity("patrol", "least capture of attacks that begin at any time", "1", kind="share"),
    ] = None


def long_run(matrices: Iterable[Any]) -> Float[Numbers, "robots vertices"]:
    """Compute the share of time of each robot at each vertex in the long run, wherever it starts.

    `matrices` are the transition matrices of the robots, dense or sparse. Dense matrices may be
    traced by `jit`, `vmap` and `grad`.

    A robot that alternates between two vertices at one end of a line of three:

        >>> from jaxcell import patrol
        >>> patrol.team.long_run([[[0, 1, 0], [1, 0, 0], [0, 1, 0]]]).tolist()
        [[0.5, 0.5, 0.0]]
    """
    chains = [Chain.from_scipy(matrix) for matrix in matrices]
    limits = [limiting_distribution(chain, persistent_groups(chain)).value for chain in chains]
    return host_array(jnp.stack(limits))


def idleness_over_vertices(
    units: str, idleness: Callable[[Any], Float[np.ndarray, "vertices"]] = attrgetter("idleness")
) -> tuple[cached_property[float], cached_property[float]]:
    """Build two quantities: the mean and the maximum over vertices of the time between visits.

    `idleness` is a function that computes this time at each vertex for a result, in `units`."""
    mean = derived("", "time between visits, mean over vertices", units, kind="time")
    worst = derived("", "time between visits at the vertex where it is longest", units, kind="time")
    return mean(lambda self: float(idleness(self).mean())), worst(
        lambda self: float(idleness(self).max())
    )


def steps_between_visits(
    shares: Float[np.ndarray, "robots vertices"],
) -> Float[np.ndarray, "vertices"]:
    """Compute the mean time between visits to each vertex by any robot.

    Robots are independent; simultaneous visits count as one, and each step spent waiting is a
    visit. `shares` is the result of [`long_run`][]. Times are in steps, infinite if no robot visits
    the vertex.

    Two robots, each of which spends half of the time at each of two vertices:

        >>> import numpy as np
        >>> from jaxcell import patrol
        >>> patrol.team.steps_between_visits(np.array([[0.5, 0.5], [0.5, 0.5]])).round(3).tolist()
        [1.333, 1.333]
    """
    with np.errstate(divide="ignore"):
        return 1 / (1 - (1 - shares).prod(axis=0))


def simulate_idleness(
    graph: GraphLike,
    matrices: Float[np.ndarray, "robots states states"],
    *,
    times: Any = None,
    attack_time: Any = None,
    seed: int = 0,
) -> Idleness:
    """Simulate the times between visits to vertices, for given walks and for three other patrols.

    The other patrols are baselines of patrolling_sim (Portugal and Rocha): robots at equal
    intervals on a short closed tour through all vertices (*tour*); robots that go to a uniformly
    random neighbour (*random*); and robots that go to the neighbour whose last visit, by any robot,
    is longest ago (*reactive*, "conscientious reactive" of Machado et al. 2003). The matrices
    define the *walk*. All robots start on the tour.

    **Arguments:**

    - `graph`: a connected graph.
    - `matrices`: the transition matrix of each robot. Its states are the vertices or, if robots
        have memory, pairs of a state of the memory and a vertex, as in
        [`MaximinCapture`][jaxcell.patrol.walks.MaximinCapture].
    - `times`: array `[edges]`, the travel time of each edge; by default 1. A wait takes the least
        travel time.
    - `attack_time`: duration of an attack, one number or array `[vertices]`, if capture is wanted.
    - `seed`: seed of the simulation.

    **Returns:** [`Idleness`][], in the unit of `times`.

    Two robots follow each other on a ring of eight vertices, four steps apart:

        >>> import numpy as np
        >>> from jaxcell import patrol
        >>> ring = patrol.Graph([(i, (i + 1) % 8) for i in range(8)])
        >>> walk = patrol.random_walk(ring, np.ones(8)).to_scipy().toarray()
        >>> result = patrol.team.simulate_idleness(ring, np.stack([walk, walk]))
        >>> result.patrol[1], result.mean[1].item(), result.longest[1].item()
        ('tour', 4.0, 4.0)
    """
    check_walks(graph, matrices, memory=True)
    robots, vertices = len(matrices), graph.vertices
    each = edge_times(graph, times)
    # In units of the least time and rounded, coinciding visits have equal times.
    unit = float(each.min())
    durations = move_times(graph, (each / unit).round(_DECIMALS))
    tour = shortest_tour(graph, range(vertices))
    spaced = _spaced(tour, durations, robots)
    neighbours = [np.flatnonzero(row) for row in graph.matrix(each).toarray()]
    random = np.random.default_rng(seed)
    total = matrices.cumsum(axis=2)
    place, state = list(spaced), tour[spaced]
    attack = np.broadcast_to(np.nan if attack_time is None else attack_time, vertices)

    def walk(robot, here, last):  # type: ignore[no-untyped-def]
        row = total[robot, state[robot]]
        state[robot] = np.searchsorted(row, random.random() * row[-1], side="right")
        return int(state[robot]) % vertices

    def follow(robot, here, last):  # type: ignore[no-untyped-def]
        place[robot] = (place[robot] + 1) % tour.size
        return int(tour[place[robot]])

    def anywhere(robot, here, last):  # type: ignore[no-untyped-def]
        return int(neighbours[here][int(random.random() * neighbours[here].size)])

    def reactive(robot, here, last):  # type: ignore[no-untyped-def]
        near = neighbours[here]
        longest = near[last[near] == last[near].min()]
        return int(longest[int(random.random() * longest.size)])

    rules: dict[str, _Next] = {
        "walk": walk,
        "tour": follow,
        "random": anywhere,
        "reactive": reactive,
    }
    moves = max(_MOVES, _VISITS * vertices)
    rows = []
    for rule in rules.values():
        gaps = [unit * times for times in _gaps(rule, durations, tour[spaced], moves)]
        batches = np.array([_batches(times) for times in gaps])
        means = np.array([times.mean() for times in gaps])
        at, longest = int(means.argmax()), max(float(times.max()) for times in gaps)
        errors = _error(batches.mean(axis=0)), _error(batches[at])
        # An attack begins at a random time, and the next visit interrupts the attack.
        attacked = zip(gaps, attack, strict=True)
        caught = min(np.minimum(times, time).sum() / times.sum() for times, time in attacked)
        rows.append((means.mean(), errors[0], means[at], errors[1], longest, caught))
    *columns, captured = np.array(rows).T
    columns.append(None if attack_time is None else captured)
    return Idleness(list(rules), *columns)


def _batches(times: Float[np.ndarray, "_"]) -> list[float]:
    """Compute the means of successive batches of times between visits; `inf` for too few times."""
    few = times.size < _BATCHES
    return [np.inf if few else part.mean() for part in np.array_split(times, _BATCHES)]


def _error(means: Float[np.ndarray, "batches"]) -> float:
    """Compute the standard error of the mean from batches; infinite with too few visits."""
    return float(means.std(ddof=1) / math.sqrt(means.size)) if np.isfinite(means).all() else np.inf


def _spaced(
    tour: Int[np.ndarray, "steps"], durations: Float[np.ndarray, "vertices vertices"], robots: int
) -> list[int]:
    """Choose starts on a tour so that robots follow each other at nearly equal intervals."""
    reached = np.concatenate([[0.0], durations[tour, np.roll(tour, -1)].cumsum()])
    aims = np.arange(robots) * reached[-1] / robots
    return [int(np.abs(reached[:-1] - aim).argmin()) for aim in aims]


def _gaps(
    rule: _Next,
    durations: Float[np.ndarray, "vertices vertices"],
    starts: Int[np.ndarray, "robots"],
    moves: int,
) -> list[Float[np.ndarray, "_"]]:
    """Simulate the times between visits to each vertex; infinite for fewer than two visits."""
    last = np.full(len(durations), -1.0)
    visits: list[list[float]] = [[] for _ in range(len(durations))]
    moving = [(0.0, robot, int(start)) for robot, start in enumerate(starts)]
    for _, _, here in moving:
        last[here] = 0.0
    for _ in range(moves + len(starts)):
        now, robot, here = heapq.heappop(moving)
        last[here] = now
        if not visits[here] or visits[here][-1] < now:
            visits[here].append(now)
        there = rule(robot, here, last)
        arrival = round(now + float(durations[here, there]), _DECIMALS)
        heapq.heappush(moving, (arrival, robot, there))
    begin = _BEFORE * now
    gaps = []
    for times in visits:
        counted = np.array([time for time in times if time >= begin])
        gaps.append(np.diff(counted) if counted.size > 1 else np.array([np.inf]))
    return gaps
