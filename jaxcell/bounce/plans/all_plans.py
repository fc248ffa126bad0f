import dataclasses
import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Annotated, ClassVar

import numpy as np
from jaxtyping import Array, Float, Int, Integer, Shaped

from ...base import memory
from ...base.quantities import Checks, Result, quantity
from ...space import CELL_BY_CELL, CellSpace, Motion
from .plan import Plan, read_plan
from .roadmap import Method, Roadmap
from .routes import Routes, block_size, costs, solve
from .store import read_roadmap, read_routes, write_plans


# Costs of so many pairs are read at a time.
_PAIRS = 1 << 24


@dataclasses.dataclass(frozen=True, eq=False)
class CostSummary(Result):
    """What the plans between all pairs of cells cost."""

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
class AllPlans:
    """The cheapest plans between all pairs of cells (Alam 2018, Alg. 3.2).

    Only the routes from walls to entries are kept (see [`jaxcell.bounce.Roadmap`][]), in memory or
    in a file, from which what is asked for is read. All else is read off them: a plan bump by bump,
    a cost as that of a run to the wall, of a route, and of a run from the entry to the goal.
    """

    cells: CellSpace
    roadmap: Roadmap
    source: Routes | Path
    "The routes to all entries, or the store that holds them."

    def plan(self, start: int, goal: int) -> Plan:
        """What [`jaxcell.bounce.plan`][] gives."""
        roadmap = self.roadmap
        start, goal = roadmap.check_cell(start, "start"), roadmap.check_cell(goal, "goal")
        return read_plan(self.cells, roadmap, self._ways(roadmap.entry_of[[goal]]), start, goal)

    def costs(
        self, goals: Int[np.ndarray, "goals"] | None = None
    ) -> Shaped[np.ndarray, "cells goals"]:
        """What the plans from all cells to some goals cost, -1 where there is no path.

        **Arguments:**

        - `goals`: cells, all by default. The result has `cells * goals` entries.
        """
        goals, entries, of = self._goals(goals)
        return costs(self.roadmap, self._ways(entries).cost[of], goals)

    def actions(
        self, goals: Int[np.ndarray, "goals"] | None = None
    ) -> Integer[np.ndarray, "cells goals"]:
        """The first action of the plan from each cell to some goals.

        **Arguments:**

        - `goals`: cells, all by default.

        **Returns:** 0 for a step forward, `k + 1` for a bump with angle `k`, -1 where there is no
        path, or nothing left to do.
        """
        goals, entries, of = self._goals(goals)
        routes = self._ways(entries)
        result = np.where(routes.cost < 0, -1, 0).astype(routes.turn.dtype)[of].T[self.roadmap.wall]
        turn = routes.first_turn()[of].T
        result[self.roadmap.wall_cell] = np.where(turn < 0, -1, turn + 1)
        result[self.roadmap.straight(goals)] = 0
        result[goals, np.arange(goals.size)] = -1
        return result

    def angles_used(
        self, goals: Int[np.ndarray, "goals"] | None = None
    ) -> Integer[np.ndarray, "cells goals"]:
        """How many different angles the plan from each cell to some goals uses.

        **Arguments:**

        - `goals`: cells, all by default.

        **Returns:** the numbers, -1 where there is no path.
        """
        goals, entries, of = self._goals(goals)
        routes = self._ways(entries)
        used = np.where(routes.cost < 0, -1, _angles_used(self.roadmap, routes, entries))
        result = used.astype(routes.turn.dtype)[of].T[self.roadmap.wall]
        result[self.roadmap.straight(goals)] = 0
        return result

    def cost_summary(self) -> CostSummary:
        """What the plans cost, and a costliest one."""
        size, pairs, total, largest, ends = self.roadmap.size, 0, 0.0, -1.0, (0, 0)
        block = max(1, _PAIRS // size)
        for begin in range(0, size, block):
            found = self.costs(np.arange(begin, min(begin + block, size)))
            known = found[found >= 0]
            pairs += known.size
            total += float(known.sum(dtype=float))
            start, goal = np.unravel_index(found.argmax(), found.shape)
            if found[start, goal] > largest:
                largest, ends = float(found[start, goal]), (int(start), begin + int(goal))
        return CostSummary(self.cells, pairs / size**2, total / pairs, largest, self.plan(*ends))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the plans to a Zarr store, whole or not at all.

        **Raises:** `FileNotFoundError` if the parent folder does not exist.
        """
        write_plans(path, self.roadmap, map(self._ways, _blocks(self.roadmap)))

    @classmethod
    def load(cls, path: str | os.PathLike[str], cells: CellSpace) -> "AllPlans":
        """Open a store of plans. Routes are read from it when they are needed.

        **Arguments:**

        - `path`: the store.
        - `cells`: the cell space that the plans are for.

        **Raises:** `ValueError` if it is not a store of plans, or of other cells;
        `FileNotFoundError`.
        """
        return cls(cells, read_roadmap(Path(path), cells), Path(path))

    def _goals(
        self, goals: Int[np.ndarray, "goals"] | None
    ) -> tuple[Int[np.ndarray, "goals"], Int[np.ndarray, "some"], Int[np.ndarray, "goals"]]:
        """The goals, the entries that lead to them, and which of these leads to each."""
        if goals is None:
            goals = np.arange(self.roadmap.size)
        for wrong in goals[(goals < 0) | (goals >= self.roadmap.size)].tolist()[:1]:
            self.roadmap.check_cell(wrong, "goals")
        return goals, *np.unique(self.roadmap.entry_of[goals], return_inverse=True)

    def _ways(self, entries: Int[np.ndarray, "some"]) -> Routes:
        """The routes to entries in ascending order; none leads to entry -1."""
        known = entries[entries >= 0]
        if entries.size and not known.size:
            return solve(self.roadmap, entries)
        if isinstance(self.source, Path):
            routes = read_routes(self.source, known)
        else:
            routes = Routes(
                self.source.cost[known], self.source.layer[known], self.source.turn[known]
            )
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
    """Cheapest plans between all pairs of cells (Alam 2018, Alg. 3.2).

    **Arguments:**

    - `cells`, `bounces`, `keep`, `change`, `motion`, `method`: as for
        [`jaxcell.bounce.plan`][].
    - `store`: a folder such as `plans.zarr` to write the plans to as they are found, and to read
        them from, for spaces whose plans do not fit the memory. By default plans stay in memory.
    - `progress`: called with the number of solved entries, and the number of all entries.

    **Returns:** [`jaxcell.bounce.AllPlans`][].

    **Raises:** `ValueError` as [`jaxcell.bounce.plan`][]; `MemoryError` if the plans do not fit the
    free memory and there is no store; `FileNotFoundError` if the parent folder of the store does
    not exist.

    What the plans from all six cells of a corridor to cell 0 cost:

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
        # Costs, layers and turns, and once more where the parts are joined.
        state = roadmap.number.itemsize + roadmap.small.itemsize * (1 + len(roadmap.bounces))
        memory.check(
            2.0 * state * roadmap.entry.size * roadmap.walls,
            f"plans from {roadmap.walls:,} walls to {roadmap.entry.size:,} entries",
            "write them to a store, or use larger cells or fewer directions",
        )

    def solved() -> Iterator[Routes]:
        for some in _blocks(roadmap):
            yield solve(roadmap, some)
            if progress is not None:
                progress(int(some[-1]) + 1, roadmap.entry.size)

    if store is not None:
        write_plans(store, roadmap, solved())
        return AllPlans(cells, roadmap, Path(store))
    return AllPlans(cells, roadmap, Routes.joined(list(solved())))


def _blocks(roadmap: Roadmap) -> list[Int[np.ndarray, "some"]]:
    """The entries in blocks that are best solved at once."""
    size = block_size(roadmap)
    entries = np.arange(roadmap.entry.size)
    return [entries[i : i + size] for i in range(0, entries.size, size)]


def _angles_used(
    roadmap: Roadmap, routes: Routes, entries: Int[np.ndarray, "entries"]
) -> Integer[np.ndarray, "entries walls"]:
    """How many angles the routes use, found by doubling: after r rounds those of 2^r bumps."""
    some, angles, walls = routes.turn.shape
    turn = routes.turn.astype(np.int32)
    wall = np.arange(walls)
    cell = roadmap.turned[turn, wall]
    layer = turn if roadmap.method == "exact" else np.arange(angles, dtype=np.int32)[:, None]
    over = (turn < 0) | roadmap.runs_through(cell, roadmap.entry[entries][:, None, None])
    end = angles * walls
    onward = np.where(over, end, layer * walls + roadmap.wall[cell]).reshape(some, -1)
    onward = np.pad(onward, ((0, 0), (0, 1)), constant_values=end)
    turn = np.pad(turn.reshape(some, -1), ((0, 0), (0, 1)), constant_values=-1)
    used = [turn == k for k in range(angles)]
    for _ in range(end.bit_length() + 1):
        if (onward == end).all():
            break
        for one in used:
            one |= np.take_along_axis(one, onward, axis=1)
        onward = np.take_along_axis(onward, onward, axis=1)
    else:
        raise ValueError("the plans do not lead to their goals; their store was altered")
    first = routes.layer.astype(np.int32) * walls + wall
    count = sum(np.take_along_axis(one, first, axis=1).astype(routes.turn.dtype) for one in used)
    return np.asarray(count)
