"""Travel times of moves on a graph, and a check of hitting times."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from ...optimize import Graph


# Tolerance of a time, relative to the longest.
_TIME = 1e-6


def move_times(
    graph: Graph, times: Any = None, wait: float = 1
) -> Float[np.ndarray, "vertices vertices"]:
    """Compute the time of a move between each pair of vertices; 0 if no edge joins them. An edge
    takes its entry in `times`, by default 1, and a wait at a vertex takes `wait`."""
    each = np.ones(len(graph.edges)) if times is None else np.asarray(times, np.float64)
    return graph.matrix(each).toarray() + wait * np.eye(graph.vertices)


def whole_times(graph: Graph, speed: float, unit: float) -> Int[np.ndarray, "edges"]:
    """Compute the travel time of each edge in whole units of time, at least 1.

    Lengths of edges are in metres, `speed` in metres per second, and `unit` in seconds.

    Two edges of 1 and 2.6 m at 0.5 m/s, in seconds:

        >>> from jaxcell import patrol
        >>> graph = patrol.Graph([[0, 1], [1, 2]], xy=[[0, 0], [1, 0], [3.6, 0]])
        >>> patrol.team.whole_times(graph, 0.5, 1.0).tolist()
        [2, 5]
    """
    return np.maximum(1, np.rint(graph.lengths / (speed * unit))).astype(np.int64)


def check_vertex(parameter: str, vertex: int, vertices: int) -> None:
    if not 0 <= vertex < vertices:
        raise ValueError(f"{parameter}: expected a vertex, 0 to {vertices - 1}, got {vertex}")


def names_of(vertices: int, names: Sequence[str] | None) -> list[str]:
    """Return the names of vertices, by default their numbers."""
    return [str(vertex) for vertex in range(vertices)] if names is None else list(names)


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
