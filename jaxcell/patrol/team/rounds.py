import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from typing import Annotated, Any, ClassVar

import numpy as np
from jaxtyping import Bool, Float, Int

from ...base.quantities import Result, derived, quantity
from ...optimize import GraphLike
from ...optimize.validation import check_count, one_each
from ..rounds.game import Game
from ..rounds.search import best_rounds
from .times import check_whole, names_of
from .watching import watching_tours


# Number of covers of a map from which tours begin.
_COVERS = 2
# Rounding error of a time, relative, by which an attack does not become longer.
_ROUNDING = 1e-9


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Round(Result):
    """Robots that follow closed tours at equal intervals, which a shared clock keeps.

    All robots follow one tour, or each tour is on a part of the graph and has some of the robots.
    """

    title: ClassVar[str] = "Evenly spaced round"
    tables: ClassVar[Mapping[str, str]] = {"tour": "tours"}

    robots: Annotated[
        Int[np.ndarray, "tours"], quantity("tour", "robots that follow the tour", kind="count")
    ]
    stops: Annotated[
        np.ndarray | None, quantity("tour stop", "vertices in order", kind="text", listed=True)
    ] = None
    "Array `[tours, stops]` of names of vertices, padded with empty names; `None` on a map."
    walk: Int[np.ndarray, "steps"] | None = None
    "The cells of the tour in order, on a map; otherwise `None`."
    duration: Float[np.ndarray, "tours"]
    "The time that a robot takes for each tour, in units."
    longest: float
    """The longest time between visits to a vertex by any robot, in units; on a map, between views
    of a cell."""
    unit: float | None = None
    "The unit of time in seconds, or `None` for steps."
    least_capture: Annotated[
        float | None,
        quantity("", "least capture of attacks that begin at any time", "1", kind="share"),
    ] = None
    "The least probability over places, for an adversary that does not see the robots."
    watched_capture: Annotated[
        float | None,
        quantity("", "least capture if the adversary sees the robots", "1", kind="share"),
    ] = None
    "1 if no attack succeeds; 0 if an adversary that sees the robots can find a time and a place."

    @property
    def followers(self) -> str:
        """The robots and their tours, as a noun phrase."""
        tours, robots = self.robots.size, int(self.robots.sum())
        if robots == 1:
            return "a robot on a closed tour"
        if tours == 1:
            return "evenly spaced robots on one closed tour, which keep a shared clock"
        if tours == robots:
            return f"one robot on a closed tour of each of {tours} parts"
        return f"robots on closed tours of {tours} parts, evenly spaced by a shared clock"

    @derived("tour", "time that a robot takes for the tour", "steps", kind="time")
    def steps(self) -> Float[np.ndarray, "tours"] | None:
        return None if self.unit else self.duration

    @derived("", "longest time that a place is not visited or seen", "steps", kind="time")
    def steps_between(self) -> float | None:
        return None if self.unit else self.longest

    @derived("tour", "time that a robot takes for the tour", "s", kind="time")
    def seconds(self) -> Float[np.ndarray, "tours"] | None:
        return self.unit * self.duration if self.unit else None

    @derived("", "longest time that a place is not visited or seen", "s", kind="time")
    def seconds_between(self) -> float | None:
        return self.unit * self.longest if self.unit else None


def evenly_spaced_round(
    graph: GraphLike,
    robots: int,
    attack_time: Any = None,
    *,
    travel_times: Any = None,
    unit: float | None = None,
    names: Sequence[str] | None = None,
) -> Round:
    """Follow short closed tours that pass all vertices with evenly spaced robots.

    All robots of a connected graph follow one tour, or each tour is on a part of the graph, and has
    one or more robots. The round that captures most is returned, without attacks the round with the
    shortest time between visits, as far as [`best_rounds`][jaxcell.patrol.rounds.best_rounds] finds
    it. Each connected component of a graph has its own tours.

    The robots have a shared clock: each robot is at the place of the next one a fixed time later.
    An attack begins as a robot leaves a vertex, or at any other time.

    **Arguments:**

    - `graph`: a graph.
    - `robots`: number of robots, at least one for each connected component.
    - `attack_time`: duration of an attack, or array `[vertices]` of them.
    - `travel_times`: array `[edges]`, travel time of each edge; by default 1.
    - `unit`: duration of a unit of time, in seconds; by default times are in steps, and whole
        numbers.
    - `names`: names of the vertices; by default their numbers.

    **Returns:** [`Round`][].

    Two robots on a cycle of six vertices visit each vertex in every third step, and two robots on a
    line of six each go to and fro in one half:

        >>> from jaxcell import patrol
        >>> cycle = patrol.Graph([(i, (i + 1) % 6) for i in range(6)])
        >>> found = patrol.team.evenly_spaced_round(cycle, 2, attack_time=3)
        >>> found.longest, found.least_capture, found.watched_capture
        (3.0, 1.0, 1.0)
        >>> line = patrol.Graph([(i, i + 1) for i in range(5)])
        >>> patrol.team.evenly_spaced_round(line, 2, attack_time=4).stops.tolist()
        [['0', '1', '2', '1'], ['3', '4', '5', '4']]
    """
    check_count("robots", robots)
    times = _times("travel_times", travel_times, len(graph.edges), "edge", unit)
    # Without attacks, the longest time is shortest relative to any long time.
    attack = np.full(graph.vertices, 2.0 * times.sum())
    if attack_time is not None:
        attack = _times("attack_time", attack_time, graph.vertices, "vertex", unit).astype(float)
    called = names_of(graph.vertices, names)
    game = Game(
        names=tuple(called),
        ends=np.concatenate([graph.edges, graph.edges[:, ::-1]]),
        times=np.tile(times, 2).astype(float),
        targets=np.arange(graph.vertices),
        attack=attack,
        value=np.ones(graph.vertices),
        robots=robots,
        unit="steps" if unit is None else "s",
    )
    rounds = best_rounds(game)
    walks = [game.walk(order) for order in rounds.orders]
    most = max(walk.size for walk, _, _ in walks)
    stops = [[called[v] for v in walk.tolist()] for walk, _, _ in walks]
    found = Round(
        robots=np.array(rounds.robots),
        stops=np.array([each + [""] * (most - len(each)) for each in stops]),
        duration=np.array([duration for _, _, duration in walks]),
        longest=float(rounds.evaluation.longest.max()),
        unit=unit,
    )
    if attack_time is None:
        return found
    exposed = float(rounds.evaluation.exposure.max())
    return dataclasses.replace(found, least_capture=1 - exposed, watched_capture=float(not exposed))


def round_on_map(
    graph: GraphLike,
    visible: Bool[np.ndarray, "cells cells"],
    robots: int,
    attack_time: int,
    places: Int[np.ndarray, "places"],
) -> Round | None:
    """Follow a short closed tour that sees all cells of a map with evenly spaced robots.

    Tours that become shorter and shorter are compared, from tours through greedy covers on, until
    no attack succeeds; the round is on the tour with the most capture.

    **Arguments:** the graph of the cells; `visible[i, j]` is true if a robot in cell `i` sees cell
    `j`; the number of robots; the number of steps of an attack, which begins when no robot sees its
    cell; and the cells that may be attacked. **Returns:** [`Round`][], or `None` if all cells are
    seen from a single one.
    """
    best = None
    for walk in watching_tours(graph, visible, min(robots, _COVERS)):
        seen = visible[walk]
        gaps = [_gaps(np.flatnonzero(seen[:, place]), len(seen), robots) for place in places]
        least, watched = _least(gaps, np.full(len(gaps), float(attack_time)), 1)
        rank = least, -_longest(gaps)
        if best is None or rank > best[0]:
            best = rank, walk, watched
        if watched:
            break
    if best is None:
        return None
    (least, late), walk, watched = best
    return Round(
        robots=np.array([robots]),
        walk=walk,
        duration=np.array([float(walk.size)]),
        longest=-late,
        least_capture=least,
        watched_capture=watched,
    )


def walk_around(
    walk: Int[np.ndarray, "steps"], cells: int
) -> tuple[Int[np.ndarray, "1 states"], Float[np.ndarray, "1 states"]]:
    """Build the walk of a robot that goes around a closed tour, with a memory of its visits.

    **Arguments:** the cells of the tour in order, and the number of cells of the map. **Returns:**
    the next state of each state, and its probability, which is 1. A state is a cell plus the number
    of earlier visits to it in this round, times `cells`; the tour begins in a state without any.

    A robot that goes to and fro visits the middle of three cells in two states:

        >>> import numpy as np
        >>> from jaxcell import patrol
        >>> image, _ = patrol.team.walk_around(np.array([0, 1, 2, 1]), 3)
        >>> image.tolist()
        [[1, 2, 4, 3, 0, 5]]
    """
    visits = np.array([np.count_nonzero(walk[:step] == walk[step]) for step in range(walk.size)])
    states = visits * cells + walk
    image = np.arange(cells * (int(visits.max()) + 1))
    image[states] = np.roll(states, -1)
    return image[None], np.ones((1, image.size))


def _times(
    name: str, given: Any, count: int, what: str, unit: float | None
) -> Float[np.ndarray, "count"] | Int[np.ndarray, "count"]:
    """Return `count` times, by default 1: whole numbers of steps, or of any units."""
    given = 1 if given is None else given
    if unit is None:
        return check_whole(name, given, count, what)
    each = np.full(count, given) if np.ndim(given) == 0 else given
    return one_each(name, each, count, f"per {what}")


def _gaps(
    visits: Float[np.ndarray, "_"] | Int[np.ndarray, "_"], period: float | int, robots: int
) -> Float[np.ndarray, "visits"]:
    """Return the times between visits of any robot, for the times when robot 0 visits a place.

    Robots follow each other at whole times if the visits of robot 0 are at whole times."""
    if visits.size == 0:
        return np.array([np.inf])
    if not period:
        return np.zeros(1)
    whole = np.issubdtype(visits.dtype, np.integer)
    apart = np.arange(robots) * period // robots if whole else np.arange(robots) * period / robots
    times = np.unique((visits[:, None] + apart) % period)
    return np.diff(times, append=times[0] + period).astype(float)


def _longest(gaps: Iterable[Float[np.ndarray, "_"]]) -> float:
    return float(max((each.max() for each in gaps), default=0.0))


def _least(
    gaps: Sequence[Float[np.ndarray, "_"]], attack: Float[np.ndarray, "places"], away: int
) -> tuple[float, float]:
    """Compute the least capture of attacks, at any time, and at the worst time.

    Attacks begin at most `gap - away` steps before a visit."""
    least, watched = 1.0, 1.0
    for each, time in zip(gaps, attack.tolist(), strict=True):
        hidden = each - away
        if hidden.max() > time * (1 + _ROUNDING):
            watched = 0.0
            least = min(least, float(np.minimum(hidden, time).sum() / hidden.sum()))
    return least, watched
