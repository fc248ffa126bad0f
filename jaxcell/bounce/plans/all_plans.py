import dataclasses
import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Annotated, ClassVar, TypeAlias

import numpy as np
from jaxtyping import Array, Float, Int, Integer, Shaped

from ...base import memory
from ...base.quantities import Checks, Result, quantity
from ...base.shown import Shown
from ...space import CELL_BY_CELL, CellSpace, Motion
from ..dynamics import Place, cell_of, check_cell
from .plan import Plan, read_plan
from .roadmap import Method, Roadmap
from .routes import Routes, block_size, costs, solve
from .store import read_roadmap, read_routes, write_plans


_Goals: TypeAlias = Int[np.ndarray, "goals"]
# Number of pairs whose costs are read at once.
_PAIRS = 1 << 24


@dataclasses.dataclass(frozen=True, eq=False)
class CostSummary(Result):
    """The costs of the plans between all pairs of cells."""

    title: ClassVar[str] = "Costs of the plans between all pairs of cells"

    cells: CellSpace
    reachable_pairs: Annotated[
        float,
        quantity(
            "", "share of pairs of cells with a path from one to the other", "1", kind="share"
        ),
    ]
    mean_cost: Annotated[
        float, quantity("", "mean cost of the plans between pairs with a path", "1")
    ]
    largest_cost: Annotated[float, quantity("", "largest cost of a plan between two cells", "1")]
    costliest: Plan
    "A plan with the largest cost."

    def checks(self) -> Checks:
        error = abs(self.largest_cost - self.costliest.cost)
        return {**self.costliest.checks(), "largest_cost_minus_that_of_the_plan": (error, 0)}


@dataclasses.dataclass(frozen=True, eq=False)
class AllPlans(Shown):
    """The cheapest plans between all pairs of cells (Alam 2018, Alg. 3.2).

    Only the routes from walls to entries are kept (see [`jaxcell.bounce.Roadmap`][]), in memory or
    in a store, because they determine all plans: a plan is a run to a wall, a route from this wall
    to an entry, which is a cell after a bump, and a run from the entry to the goal.
    """

    cells: CellSpace
    roadmap: Roadmap
    source: Routes | Path
    "The routes to all entries, or the store that holds them."

    def plan(self, start: Place, goal: Place) -> Plan:
        """Find the cheapest plan from a cell to a goal, as [`jaxcell.bounce.plan`][] does."""
        start, goal = cell_of(self.cells, start), cell_of(self.cells, goal, "goal")
        routes = self._routes(self.roadmap.entry_of[[goal]])
        return read_plan(self.cells, self.roadmap, routes, start, goal)

    def costs(self, goals: _Goals | None = None) -> Shaped[np.ndarray, "cells goals"]:
        """Compute the costs of plans from all cells to goals (by default all); -1 for no path."""
        goals, entries, of = self._goals(goals)
        return costs(self.roadmap, self._routes(entries).cost[of], goals)

    def actions(self, goals: _Goals | None = None) -> Integer[np.ndarray, "cells goals"]:
        """Find the first action of the plan from each cell to goals (by default all cells).

        An action is 0 for a step forward, `k + 1` for a bump with angle `k`, and -1 if the cell is
        the goal or has no path to it.
        """
        goals, entries, of = self._goals(goals)
        routes = self._routes(entries)
        result = np.where(routes.cost < 0, -1, 0).astype(routes.turn.dtype)[of].T[self.roadmap.wall]
        turn = np.take_along_axis(routes.turn, routes.layer[:, None], axis=1)[of, 0].T
        result[self.roadmap.wall_cell] = np.where(turn < 0, -1, turn + 1)
        result[self.roadmap.straight(goals)] = 0
        result[goals, np.arange(goals.size)] = -1
        return result

    def angles_used(self, goals: _Goals | None = None) -> Integer[np.ndarray, "cells goals"]:
        """Count the different angles in each plan to `goals` (by default all); -1 for no path."""
        goals, entries, of = self._goals(goals)
        routes = self._routes(entries)
        used = np.where(routes.cost < 0, -1, _angles_used(self.roadmap, routes, entries))
        result = used.astype(routes.turn.dtype)[of].T[self.roadmap.wall]
        result[self.roadmap.straight(goals)] = 0
        return result

    def cost_summary(self) -> CostSummary:
        """Summarise the costs of all plans, and find a costliest plan."""
        size, pairs, total, largest, ends = self.roadmap.size, 0, 0.0, -1.0, (0, 0)
        block = max(1, _PAIRS // size)
        for begin in range(0, size, block):
            costs = self.costs(np.arange(begin, min(begin + block, size)))
            known = costs[costs >= 0]
            pairs += known.size
            total += float(known.sum(dtype=float))
            start, goal = np.unravel_index(costs.argmax(), costs.shape)
            if costs[start, goal] > largest:
                largest, ends = float(costs[start, goal]), (int(start), begin + int(goal))
        return CostSummary(self.cells, pairs / size**2, total / pairs, largest, self.plan(*ends))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the plans to a Zarr store, either completely or not at all."""
        write_plans(path, self.roadmap, map(self._routes, _blocks(self.roadmap)))

    @classmethod
    def load(cls, path: str | os.PathLike[str], cells: CellSpace) -> "AllPlans":
        """Open a store of plans for these cells. Routes are read when they are needed.

        **Raises:** `FileNotFoundError` without a store; `ValueError` without plans for these cells.
        """
        return cls(cells, read_roadmap(Path(path), cells), Path(path))

    def _goals(self, goals: _Goals | None) -> tuple[_Goals, Int[np.ndarray, "entries"], _Goals]:
        """List the goals, by default all cells, and the entries from which robots run to them.

        The last result is, for each goal, the index of its entry among these entries.
        """
        if goals is None:
            goals = np.arange(self.roadmap.size)
        for wrong in goals[(goals < 0) | (goals >= self.roadmap.size)].tolist()[:1]:
            check_cell(wrong, self.cells.size, "goals")
        return goals, *np.unique(self.roadmap.entry_of[goals], return_inverse=True)

    def _routes(self, entries: Int[np.ndarray, "entries"]) -> Routes:
        """Find the routes to sorted `entries`; an index -1 stands for no entry, without routes."""
        known = entries[entries >= 0]
        if entries.size and not known.size:
            return solve(self.roadmap, entries)
        if isinstance(self.source, Path):
            routes = read_routes(self.source, known)
        else:
            routes = Routes(*(values[known] for values in vars(self.source).values()))
        if known.size == entries.size:
            return routes
        return Routes.joined([solve(self.roadmap, entries[:1]), routes])


def all_plans(
    cells: CellSpace,
    bounces: Float[np.ndarray, "angles"] | Array | Sequence[float],
    keep: int | float = 1,
    change: int | float = 100,
    *,
    motion: Motion = CELL_BY_CELL,
    method: Method = "exact",
    store: str | os.PathLike[str] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> AllPlans:
    """Find cheapest plans between all pairs of cells (Alam 2018, Alg. 3.2).

    **Arguments:** as for [`jaxcell.bounce.plan`][], and

    - `store`: a folder such as `plans.zarr`, for plans that do not fit in memory. Plans are written
        to it as soon as they are found, and read from it. By default plans stay in memory.
    - `progress`: a function that is called with the number of finished entries (cells after a
        bump) and the number of all entries.

    **Returns:** [`AllPlans`][], in memory or in the store.

    The costs of the plans from all six cells of a corridor to cell 0:

        >>> import math
        >>> import numpy as np
        >>> from jaxcell import bounce, examples
        >>> cells = examples.corridor()
        >>> plans = bounce.all_plans(cells, [math.pi])
        >>> plans.costs(np.array([0])).ravel().tolist()
        [0, 5, 4, 1, 2, 3]
    """
    roadmap = Roadmap.of(cells, bounces, keep, change, motion=motion, method=method)

    if store is None:
        # Costs, layers and turns, twice because the parts are joined.
        state = roadmap.number.itemsize + roadmap.small.itemsize * (1 + len(roadmap.bounces))
        memory.check(
            2.0 * state * roadmap.entry.size * roadmap.walls,
            f"plans from {roadmap.walls:,} walls to {roadmap.entry.size:,} entries",
            "write them to a store, or use larger cells or fewer directions",
        )

    def solved() -> Iterator[Routes]:
        for block in _blocks(roadmap):
            yield solve(roadmap, block)
            if progress is not None:
                progress(int(block[-1]) + 1, roadmap.entry.size)

    if store is not None:
        write_plans(store, roadmap, solved())
        return AllPlans(cells, roadmap, Path(store))
    return AllPlans(cells, roadmap, Routes.joined(list(solved())))


def _blocks(roadmap: Roadmap) -> list[Int[np.ndarray, "entries"]]:
    """Split the entries into blocks; the routes to the entries of a block are found together."""
    size = block_size(roadmap)
    entries = np.arange(roadmap.entry.size)
    return [entries[i : i + size] for i in range(0, entries.size, size)]


def _angles_used(
    roadmap: Roadmap, routes: Routes, entries: Int[np.ndarray, "entries"]
) -> Integer[np.ndarray, "entries walls"]:
    """Count the different angles of each route, by pointer doubling along its bumps."""
    count, angles, walls = routes.turn.shape
    turn = routes.turn.astype(np.int32)
    wall = np.arange(walls)
    cell = roadmap.turned[turn, wall]
    layer = turn if roadmap.method == "exact" else np.arange(angles, dtype=np.int32)[:, None]
    over = (turn < 0) | roadmap.runs_through(cell, roadmap.entry[entries][:, None, None])
    end = angles * walls
    onward = np.where(over, end, layer * walls + roadmap.wall[cell]).reshape(count, -1)
    onward = np.pad(onward, ((0, 0), (0, 1)), constant_values=end)
    turn = np.pad(turn.reshape(count, -1), ((0, 0), (0, 1)), constant_values=-1)
    used = [turn == k for k in range(angles)]
    for _ in range(end.bit_length() + 1):
        if (onward == end).all():
            break
        for by_angle in used:
            by_angle |= np.take_along_axis(by_angle, onward, axis=1)
        onward = np.take_along_axis(onward, onward, axis=1)
    else:
        raise ValueError("the plans do not lead to their goals; their store was altered")
    first = routes.layer.astype(np.int32) * walls + wall
    each = (np.take_along_axis(by_angle, first, axis=1) for by_angle in used)
    return np.asarray(sum(by_angle.astype(routes.turn.dtype) for by_angle in each))
