import numpy as np
import scipy.sparse
from jaxtyping import Float, Int
from scipy.sparse import csgraph

from ..bounce import Plan, bounce_map
from ..bounce.dynamics import Collision
from ..mapping import SimpleMap
from ..space import CellSpace
from .bounce import compare_images
from .comparison import Comparison


# Cells times angles, which Dijkstra's algorithm goes through within a second.
_MOST_STATES = 300_000
_SEARCH = "cost of the plan, by Dijkstra's algorithm on cells and the angle in use"


def compare_plan(
    cells: CellSpace,
    found: Plan,
    bounces: Float[np.ndarray, "angles"],
    keep: int | float,
    change: int | float,
    *,
    step: float | None = None,
    collision: Collision = "swept",
) -> list[Comparison]:
    """A plan against its steps by exact geometry, and against a search of the whole graph.

    **Arguments:**

    - `cells`: the cells of a map.
    - `found`: the plan, of method `"exact"`.
    - `bounces`, `keep`, `change`, `step`, `collision`: as for [`jaxcell.bounce.plan`][].
    """
    straight = bounce_map(cells, 0.0, step=step, collision=collision)
    visited = np.unique(found.cells)
    return [
        compare_images(cells, straight, 0.0, step=step, collision=collision, only=visited),
        _simulated(cells, straight, found, keep, change),
        *_searched(cells, straight, found, bounces, keep, change),
    ]


def _turns(cells: CellSpace, angles: Float[np.ndarray, "*some"]) -> Int[np.ndarray, "*some"]:
    return np.rint(angles * cells.directions / (2 * np.pi)).astype(int) % cells.directions


def _simulated(
    cells: CellSpace, straight: SimpleMap, found: Plan, keep: int | float, change: int | float
) -> Comparison:
    """The actions one after the other, and what they cost."""
    image, bumped = np.asarray(straight.image), np.asarray(straight.bumped)
    at, last = found.start, None
    cost: int | float = 0
    wrong = []
    for i, action in enumerate(found.actions.tolist()):
        if bool(bumped[at]) != (action != 0):
            wrong.append(
                f"action {i} from cell {at}: the robot {'bumps' if bumped[at] else 'goes'}"
            )
        if action == 0:
            at, cost = int(image[at]), cost + keep
        else:
            turn = int(_turns(cells, found.actions[[i]])[0])
            at = (at + turn * cells.positions) % cells.size
            cost += keep if last in (None, turn) else change
            last = turn
        if at != found.cells[i + 1]:
            wrong.append(f"action {i} leads to cell {at}, and the plan says {found.cells[i + 1]}")
    if found.found and at != found.goal:
        wrong.append(f"the plan ends in cell {at}, and the goal is {found.goal}")
    if found.found and not np.isclose(cost, found.cost, rtol=1e-12, atol=0):
        wrong.append(f"the plan costs {found.cost}, and its actions {cost}")
    count = 2 * found.actions.size + 2
    return Comparison.exact("actions of the plan, by following them", wrong, count)


def _searched(
    cells: CellSpace,
    straight: SimpleMap,
    found: Plan,
    bounces: Float[np.ndarray, "angles"],
    keep: int | float,
    change: int | float,
) -> list[Comparison]:
    """The least cost and the cells that reach the goal, on the graph of cells and angles in use.

    In the last of its layers no angle has been used so far.
    """
    turns = _turns(cells, np.asarray(bounces))
    layers, size = turns.size + 1, cells.size
    if layers * size > _MOST_STATES:
        return [Comparison.omitted(_SEARCH, f"more than {_MOST_STATES:,} states")]
    image, bumped = np.asarray(straight.image, np.int64), np.asarray(straight.bumped)
    goes, bumps = np.flatnonzero(~bumped), np.flatnonzero(bumped)
    tails, heads, weights = [], [], []
    for layer in range(layers):
        tails.append(layer * size + goes)
        heads.append(layer * size + image[goes])
        weights.append(np.full(goes.size, float(keep)))
        for angle, turn in enumerate(turns.tolist()):
            kept = layer in (angle, turns.size)
            tails.append(layer * size + bumps)
            heads.append(angle * size + (bumps + turn * cells.positions) % size)
            weights.append(np.full(bumps.size, float(keep if kept else change)))
    ways = (np.concatenate(tails), np.concatenate(heads))
    graph = scipy.sparse.csr_array(
        (np.concatenate(weights), ways), shape=(layers * size, layers * size)
    )
    # From any layer of the goal backwards.
    goals = np.arange(layers) * size + found.goal
    least = csgraph.dijkstra(graph.T.tocsr(), indices=goals, min_only=True)[turns.size * size :]
    cost = -1.0 if np.isinf(least[found.start]) else float(least[found.start])
    wrong = np.flatnonzero(np.isfinite(least) != found.reaching).tolist()
    return [
        Comparison.close(_SEARCH, [found.cost], [cost], 1e-9, relative=True),
        Comparison.exact(
            "cells that reach the goal, by the same search",
            [f"cell {z}: {found.reaching[z]} is told" for z in wrong],
            size,
        ),
    ]
