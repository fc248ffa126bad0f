"""Travel times of moves on a graph, and checks of walks, times and vertices."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from ...optimize import Graph, GraphLike
from ...optimize.validation import one_each


# Tolerance of a time, relative to the longest.
_TIME = 1e-6
# The largest whole time, which an array of 32 bits holds.
_MOST = 2**31 - 1
# Rounding error of a whole time, relative, which does not count as another unit.
_ROUNDING = 1e-9
# Largest number of units of time that a search takes for the longest attack, by default.
_MOST_UNITS = 24
# Tolerance of a probability that a solver returns.
_CHANCE = 1e-6


def move_times(
    graph: Graph, times: Any = None, wait: float = 1
) -> Float[np.ndarray, "vertices vertices"]:
    """Compute the time of a move between each pair of vertices; 0 if no edge joins them. An edge
    takes its entry in `times`, by default 1, and a wait at a vertex takes `wait`."""
    return graph.matrix(edge_times(graph, times)).toarray() + wait * np.eye(graph.vertices)


def directed_times(graph: Graph, times: Any) -> Int[np.ndarray, "vertices vertices"]:
    """Check whole times between pairs of vertices; 0 is no way, and the diagonal is waits."""
    given = np.asarray(times)
    shape = (graph.vertices,) * 2
    whole = given.shape == shape and bool(((given >= 0) & (given == np.rint(given))).all())
    if not whole or given.max() > _MOST or (given[move_times(graph) == 0] > 0).any():
        raise ValueError(
            f"travel_times: expected whole numbers, an array {list(shape)} with positive entries "
            "only between the ends of edges, and on its diagonal"
        )
    return given.astype(np.int32)


def edge_times(graph: Graph, times: Any = None) -> Float[np.ndarray, "edges"]:
    """Return the time of each edge, positive and finite; by default all times are 1."""
    edges = len(graph.edges)
    given = np.full(edges, 1.0 if times is None else times) if np.ndim(times) == 0 else times
    return one_each("times", given, edges, "per edge")


def whole_times(graph: GraphLike, speed: float, unit: float) -> Int[np.ndarray, "edges"]:
    """Compute the travel time of each edge in whole units of time, rounded up, at least 1.

    Lengths of edges are in metres, `speed` in metres per second, and `unit` in seconds. A robot is
    never later than these times, so that it captures at least what they promise.

    Two edges of 1 and 2.6 m at 0.5 m/s, in seconds, which take 2 and 5.2 s:

        >>> from jaxcell import patrol
        >>> graph = patrol.Graph([[0, 1], [1, 2]], xy=[[0, 0], [1, 0], [3.6, 0]])
        >>> patrol.team.whole_times(graph, 0.5, 1.0).tolist()
        [2, 6]
    """
    for name, value in (("speed", speed), ("unit", unit)):
        if not 0 < value < np.inf:
            raise ValueError(f"{name}: expected a positive finite number, got {value}")
    units = graph.lengths / (speed * unit) * (1 - _ROUNDING)
    return np.maximum(1, np.ceil(units)).astype(np.int64)


def time_unit_of(graph: GraphLike, speed: float, attack_time: Any) -> float:
    """Choose a unit of time, in which travel times and attacks are whole numbers, in seconds.

    The time that a search takes grows with these numbers. So the unit is the longest attack divided
    by a whole number up to 24, which [`whole_times`][] and shorter attacks are rounded to least. An
    attack lasts one unit at least.

    **Arguments:** a graph whose edges have lengths in metres; the speed in metres per second; and
    the durations of attacks, in seconds.

    Edges of 7 and 14 m at 1 m/s, for attacks of 40 s, which take 17 units:

        >>> from jaxcell import patrol
        >>> graph = patrol.Graph([[0, 1], [1, 2]], xy=[[0, 0], [7, 0], [21, 0]])
        >>> unit = patrol.team.time_unit_of(graph, 1.0, 40.0)
        >>> round(unit, 3), (patrol.team.whole_times(graph, 1.0, unit) * unit).round(3).tolist()
        (2.353, [7.059, 14.118])
    """
    attacks = np.atleast_1d(np.asarray(attack_time, np.float64))

    def rounding(unit: float) -> float:
        whole = np.floor(attacks / unit * (1 + _ROUNDING))
        if not whole.min():
            return np.inf
        return float(whole_times(graph, speed, unit).sum() * (attacks / whole).max())

    units = [*(attacks.max() / np.arange(1, _MOST_UNITS + 1)).tolist(), float(attacks.min())]
    roundings = np.array([rounding(unit) for unit in units])
    return units[int(np.argmax(roundings <= roundings.min() * (1 + _ROUNDING)))]


def check_vertex(parameter: str, vertex: int, vertices: int) -> None:
    if not 0 <= vertex < vertices:
        raise ValueError(f"{parameter}: expected a vertex, 0 to {vertices - 1}, got {vertex}")


def check_whole(name: str, given: Any, count: int, what: str) -> Int[np.ndarray, "count"]:
    """Return a whole number, or `count` of them, one per `what`, as an array of `count` numbers."""
    numbers = np.asarray(given)
    real = np.issubdtype(numbers.dtype, np.integer) or np.issubdtype(numbers.dtype, np.floating)
    if numbers.shape not in ((), (count,)) or not real or (numbers != np.rint(numbers)).any():
        raise ValueError(
            f"{name}: expected a whole number, or {count}, one per {what}, got an array of "
            f"{numbers.dtype} with shape {list(numbers.shape)}"
        )
    numbers = np.broadcast_to(numbers, count)
    if numbers.min() < 1:
        wrong = int(np.argmin(numbers))
        raise ValueError(f"{name}: expected at least 1, got {numbers[wrong]} for {what} {wrong}")
    if numbers.max() > _MOST:
        wrong = int(np.argmax(numbers))
        raise ValueError(
            f"{name}: expected at most {_MOST:,}, got {numbers[wrong]} for {what} {wrong}; times "
            "in a longer unit are smaller"
        )
    return numbers.astype(np.int32)


def check_walks(graph: Graph, matrices: Any, memory: bool = False, name: str = "matrices") -> None:
    """Raise unless there is a transition matrix on the graph for each robot.

    With `memory`, states may be pairs of a state of memory and a vertex. Errors begin with
    `name`."""
    given, vertices = np.asarray(matrices, np.float64), graph.vertices
    states = given.shape[-1] if given.ndim == 3 else 0
    if (
        states == 0
        or given.shape[1] != states
        or states % vertices
        or not (memory or states == vertices)
    ):
        raise ValueError(
            f"{name}: expected an array [robots, {vertices}, {vertices}], a matrix for each "
            f"robot, got {list(given.shape)}"
        )
    if not (given >= 0).all() or np.abs(given.sum(axis=2) - 1).max() > _CHANCE:
        raise ValueError(f"{name}: expected rows of numbers of at least 0 that sum to 1")
    edge = np.tile(move_times(graph) > 0, (states // vertices,) * 2)
    wrong = np.argwhere((given > _CHANCE) & ~edge)
    if wrong.size:
        robot, start, end = wrong[0]
        raise ValueError(
            f"{name}: robot {robot} goes from vertex {start % vertices} to {end % vertices}, "
            "between which there is no edge"
        )


def names_of(vertices: int, names: Sequence[str] | None) -> list[str]:
    """Return the names of vertices, one for each, by default their numbers."""
    if names is None:
        return [str(vertex) for vertex in range(vertices)]
    if len(names) != vertices:
        raise ValueError(f"names: expected {vertices}, one per vertex, got {len(names)}")
    return list(names)


def hitting_check(
    matrix: Float[np.ndarray, "vertices vertices"],
    step: Float[np.ndarray, "vertices"],
    times: Float[np.ndarray, "vertices vertices"],
) -> tuple[float, float]:
    """Compute the relative residual of `times = step + matrix @ times`, for hitting times.

    Also returns the tolerance of the residual. Infinite times, to vertices that are not visited in
    the long run, are ignored; `step` is the mean time of a step from each vertex.
    """
    there = np.flatnonzero(np.isfinite(times).all(axis=0))
    gap = step[:, None] + matrix @ times[:, there] - times[:, there]
    gap[there, np.arange(there.size)] = 0
    return float(np.abs(gap).max(initial=0) / max(1.0, times[:, there].max(initial=0))), _TIME
