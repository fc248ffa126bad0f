import numpy as np
import scipy.sparse
from jaxtyping import Int
from scipy.sparse import csgraph

from ..bounce import CELL_BY_CELL, Motion, Plan
from .bounce import compare_straight
from .comparison import Comparison


# Number of states (cells times angles) that Dijkstra's algorithm searches within a second.
_MAX_STATES = 300_000
_SEARCH = "cost of the plan, by Dijkstra's algorithm on cells and the angle in use"


def compare_plan(plan: Plan, motion: Motion = CELL_BY_CELL) -> list[Comparison]:
    """Compare a plan of method `"exact"` with geometric steps, and with Dijkstra's algorithm.

    The searched graph has a copy of all cells for each bouncing angle, and one more copy for a
    robot that has not bumped yet. The actions, the cells and the cost of the plan are not compared
    with each other here, because the method `checks` of the plan does so.
    """
    straight, images = compare_straight(plan.cells, np.unique(plan.visited), motion)
    directions, size = plan.cells.directions, plan.cells.size
    turns = np.rint(plan.roadmap.bounces * directions / (2 * np.pi)).astype(int) % directions
    if (turns.size + 1) * size > _MAX_STATES:
        return [images, Comparison.omitted(_SEARCH, f"more than {_MAX_STATES:,} states")]
    image, bumped = np.asarray(straight.image, np.int64), np.asarray(straight.bumped)
    graph = _graph(plan, image, bumped, turns)
    # Search backwards from the goal in any layer.
    goals = np.arange(turns.size + 1) * size + plan.goal
    least = csgraph.dijkstra(graph.T.tocsr(), indices=goals, min_only=True)[turns.size * size :]
    cost = -1.0 if np.isinf(least[plan.start]) else float(least[plan.start])
    wrong = np.flatnonzero(np.isfinite(least) != plan.reaching).tolist()
    return [
        images,
        Comparison.close(_SEARCH, [plan.cost], [cost], 1e-9, relative=True),
        Comparison.exact(
            "cells that reach the goal, by the same search",
            [f"cell {z}: {plan.reaching[z]} in the plan" for z in wrong],
            size,
        ),
    ]


def _graph(
    plan: Plan,
    image: Int[np.ndarray, "cells"],
    bumped: np.ndarray,
    turns: Int[np.ndarray, "angles"],
) -> scipy.sparse.csr_array:
    size, keep, change = plan.cells.size, plan.roadmap.keep, plan.roadmap.change
    goes, bumps = np.flatnonzero(~bumped), np.flatnonzero(bumped)
    edges = []
    for layer in range(turns.size + 1):
        edges.append((layer * size + goes, layer * size + image[goes], keep))
        for angle, turn in enumerate(turns.tolist()):
            turned = angle * size + (bumps + turn * plan.cells.positions) % size
            price = keep if layer in (angle, turns.size) else change
            edges.append((layer * size + bumps, turned, price))
    weights = np.concatenate([np.full(tails.size, float(price)) for tails, _, price in edges])
    tails, heads = (np.concatenate([edge[end] for edge in edges]) for end in (0, 1))
    states = (turns.size + 1) * size
    return scipy.sparse.csr_array((weights, (tails, heads)), shape=(states, states))
