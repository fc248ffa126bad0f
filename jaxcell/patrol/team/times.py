"""How long moves on a graph take, and a walk until it comes to a vertex."""

from typing import Any

import numpy as np
from jaxtyping import Float, Int

from ...optimize import Graph


# Of a time, relative to the longest.
_TIME = 1e-6


def move_times(
    graph: Graph, times: Any = None, wait: float = 1
) -> Float[np.ndarray, "vertices vertices"]:
    """How long the move from one vertex to another takes; 0 where there is none.

    **Arguments:**

    - `graph`: the graph.
    - `times`: array `[edges]`, how long each edge takes; by default 1.
    - `wait`: how long a move takes that stays.
    """
    each = np.ones(len(graph.edges)) if times is None else np.asarray(times, np.float64)
    return graph.matrix(each).toarray() + wait * np.eye(graph.vertices)


def whole_times(graph: Graph, speed: float, unit: float) -> Int[np.ndarray, "edges"]:
    """How long each edge takes, in whole units of time of at least 1.

    **Arguments:**

    - `graph`: the graph, whose edges have lengths in metres.
    - `speed`: in metres per second.
    - `unit`: in seconds.

    **Returns:** the times, rounded.

    Two edges of 1 and 2.6 m at 0.5 m/s, in seconds:

        >>> from jaxcell import patrol
        >>> graph = patrol.Graph([[0, 1], [1, 2]], xy=[[0, 0], [1, 0], [3.6, 0]])
        >>> patrol.whole_times(graph, 0.5, 1.0).tolist()
        [2, 5]
    """
    return np.maximum(1, np.rint(graph.lengths / (speed * unit))).astype(np.int64)


def hitting_check(
    matrix: Float[np.ndarray, "vertices vertices"],
    step: Float[np.ndarray, "vertices"],
    times: Float[np.ndarray, "vertices vertices"],
) -> tuple[float, float]:
    """By how much hitting times miss `h = s + P h`, relative to the longest; and how much may be.

    Times to vertices that are not visited in the long run are infinite, and do not count.
    """
    there = np.flatnonzero(np.isfinite(times).all(axis=0))
    gap = step[:, None] + matrix @ times[:, there] - times[:, there]
    gap[there, np.arange(there.size)] = 0
    return float(np.abs(gap).max(initial=0) / max(1.0, times[:, there].max(initial=0))), _TIME
