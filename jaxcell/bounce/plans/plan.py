import dataclasses
from collections.abc import Mapping, Sequence
from typing import Annotated, ClassVar

import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ...base.formatting import configuration, counted
from ...base.quantities import Checks, Result, derived, from_part, quantity
from ...space import CELL_BY_CELL, CellSpace, Motion
from ..dynamics import Place, bounce_shift, cell_of, motion_violations, moves, robots_over_time
from .roadmap import Method, Roadmap
from .routes import Routes, costs, solve


@dataclasses.dataclass(frozen=True, eq=False)
class Plan(Result):
    """The actions of a robot that goes from one cell to another (Alam 2018, Alg. 3.1)."""

    title: ClassVar[str] = "Plan of a bouncing robot"
    tables: ClassVar[Mapping[str, str]] = {"leg": "legs"}

    cells: CellSpace
    roadmap: Roadmap
    "The roadmap, with the costs and the angles of the plan."
    start: Annotated[int, quantity("", "start", kind="cell")]
    goal: Annotated[int, quantity("", "goal", kind="cell")]
    cost: Annotated[int | float, quantity("", "cost of the plan, -1 if there is no path")]
    actions: Annotated[
        Float[np.ndarray, "steps"],
        quantity(
            "move",
            "0 for a step, the angle to turn by at a bump",
            "rad",
            sense="counter-clockwise",
            source="Alam 2018, section 3.4.1",
        ),
    ]
    visited: Annotated[
        Int[np.ndarray, "steps+1"],
        quantity("time", "cells that the robot visits", kind="cell", listed=True),
    ]
    "The visited cells; only the start if there is no path."
    reaching: Bool[np.ndarray, "cells"]
    "A mask of the cells from which the goal can be reached, including the goal."

    def __repr__(self) -> str:
        return f"<Plan: {self.answer[0]}>"

    @property
    def answered(self) -> bool:
        return self.found

    @property
    def answer(self) -> tuple[str, ...]:
        start, goal = (configuration(self.cells, z) for z in (self.start, self.goal))
        if not self.found:
            return (f"There is no path from {start} to {goal}.",)
        angles = dict.fromkeys(np.rad2deg(self.turns).round(9).tolist())
        turns = f", turns by {', '.join(f'{angle:g}°' for angle in angles)}," if angles else ""
        moves = f"{counted(self.steps, 'step')} and {counted(self.bumps, 'bump')}{turns}"
        return (f"{moves} lead from {start} to {goal}.",)

    @property
    def turns(self) -> Float[np.ndarray, "bumps"]:
        """The angles of the bumps in `actions`."""
        return self.actions[self.actions != 0]

    @derived("", "whether there is a path", kind="flag")
    def found(self) -> bool:
        return self.cost >= 0

    @derived("", "steps forward", kind="count")
    def steps(self) -> int:
        return int((self.actions == 0).sum())

    bumps = from_part("turns.size", "", "bumps", kind="count")

    @derived("", "different angles that are used", kind="count")
    def angles_used(self) -> int:
        return np.unique(self.turns).size

    @derived("", "bumps with another angle than the bump before", kind="count")
    def changes(self) -> int:
        return int(np.count_nonzero(np.diff(self.turns)))

    @derived("", "cells that can reach the goal", kind="count")
    def cells_that_reach_the_goal(self) -> int:
        return int(self.reaching.sum())

    @derived("move", "actions", "degree", listed=True)
    def actions_deg(self) -> Float[np.ndarray, "steps"]:
        return np.rad2deg(self.actions).round(9)

    time, robot_x, robot_y, robot_theta = robots_over_time("visited", "time")

    @derived("direction position", "whether the goal can be reached from the cell", kind="flag")
    def reaches(self) -> Bool[np.ndarray, "directions positions"]:
        return self.reaching.reshape(self.cells.directions, self.cells.positions)

    @derived("leg", "in cell", kind="cell")
    def leg_cell(self) -> Int[np.ndarray, "legs"]:
        return self.visited[self._legs]

    @derived("leg", "turn at each bump, 0 for steps", "degree")
    def leg_turn_deg(self) -> Float[np.ndarray, "legs"]:
        return self.actions_deg[self._legs]

    @derived("leg", "steps or bumps", kind="count")
    def leg_length(self) -> Int[np.ndarray, "legs"]:
        return np.diff(self._legs, append=self.actions.size)

    @property
    def _legs(self) -> Int[np.ndarray, "legs"]:
        """The indices of the actions that differ from the previous action."""
        return np.flatnonzero(np.diff(self.actions, prepend=np.nan))

    def checks(self) -> Checks:
        turn = np.rint(self.actions * self.cells.directions / (2 * np.pi)).astype(int)
        bumped = self.actions != 0
        wrong = motion_violations(self.cells, self.visited[:, None], bumped[:, None], turn)
        checks: dict[str, tuple[float | int, float | int]] = {
            "actions_that_lead_elsewhere": (int(wrong.sum()), 0)
        }
        if not self.found:
            return checks
        ends = int(self.visited[0] != self.start) + int(self.visited[-1] != self.goal)
        checks["ends_missed"] = (ends, 0)
        lost = np.count_nonzero(~self.reaching[self.visited])
        checks["cells_that_do_not_reach"] = (int(lost), 0)
        if self.roadmap.method == "exact":
            keep, change = self.roadmap.keep, self.roadmap.change
            sums = keep * (self.actions.size - self.changes) + change * self.changes
            error = abs(self.cost - float(sums))
            checks["cost_minus_that_of_actions"] = (error, 1e-9 * max(1.0, self.cost))
        return checks


def plan(
    cells: CellSpace,
    bounces: Float[np.ndarray, "angles"] | Array | Sequence[float],
    start: Place,
    goal: Place,
    keep: int | float = 1,
    change: int | float = 100,
    *,
    motion: Motion = CELL_BY_CELL,
    method: Method = "exact",
) -> Plan:
    """Find a cheapest plan from one cell to another (Alam 2018, Alg. 3.1).

    It runs on the host, because the search depends on the values.

    At each bump the robot may turn by any of the angles. A step forward costs `keep`, and so does a
    bump with the same angle as the previous bump. A bump with another angle costs `change`. The
    first bump of a plan costs `keep` with any angle, because in the dissertation a path may start
    in the graph of any angle.

    The dissertation searches one graph for each angle, in which a turn by this angle costs `keep`
    and any other turn `change`, whatever the previous turn was. With `method="layered"` the plan is
    the cheapest path in any of these graphs. The methods differ for plans with three or more bumps.
    In the layered search, turns by A, B, A cost `2 keep + change`, and turns by A, A, B, B cost
    `2 keep + 2 change`. In the exact search they cost `keep + 2 change` and `3 keep + change`.

    **Arguments:** a cell space, the angles to choose from in radians, counter-clockwise, the start
    and the goal, the two costs, a motion and a method. Start and goal are cells, or poses `(x, y,
    heading)` in metres and radians, where the heading is one of the directions, and by default 0.

    **Returns:** the plan. Its cost is -1 if there is no path, and whole if both costs are whole.

    A corridor of three squares, whose cells 0, 1, 2 look East and 3, 4, 5 West; a bump turns the
    robot around:

        >>> import math
        >>> from jaxcell import bounce, examples
        >>> cells = examples.corridor()
        >>> plan = bounce.plan(cells, [math.pi], start=0, goal=4)
        >>> plan.cost, plan.visited.tolist()
        (4, [0, 1, 2, 5, 4])
        >>> bounce.plan(cells, [math.pi], start=(0.5, 0.5), goal=(1.5, 0.5, math.pi)).cost
        4
    """
    roadmap = Roadmap.of(cells, bounces, keep, change, motion=motion, method=method)
    start, goal = cell_of(cells, start), cell_of(cells, goal, "goal")
    return read_plan(cells, roadmap, solve(roadmap, roadmap.entry_of[[goal]]), start, goal)


def read_plan(cells: CellSpace, roadmap: Roadmap, routes: Routes, start: int, goal: int) -> Plan:
    """Assemble the plan between two cells from the `routes` to the last entry before the goal."""
    cost = costs(roadmap, routes.cost, np.array([goal]))[:, 0]
    path, actions = [np.array([start], np.int32)], [np.empty(0)]
    if cost[start] >= 0:
        cell, wall = start, roadmap.wall[start]
        layer = routes.layer[0, wall]
        while not roadmap.runs_through(cell, goal):
            if len(path) > 2 * roadmap.turned.size:
                raise ValueError("the plans do not lead to the goal; their store was altered")
            run = roadmap.line(cell, roadmap.wall_cell[wall].item())
            turn = routes.turn[0, layer, wall].item()
            cell = roadmap.turned[turn, wall].item()
            path += [run, np.array([cell])]
            actions += [np.zeros(run.size), roadmap.bounces[[turn]]]
            wall = roadmap.wall[cell]
            layer = turn if roadmap.method == "exact" else layer
        run = roadmap.line(cell, goal)
        path.append(run)
        actions.append(np.zeros(run.size))
    return Plan(
        cells=cells,
        roadmap=roadmap,
        start=start,
        goal=goal,
        cost=cost[start].item(),
        visited=np.concatenate(path).astype(np.int32),
        actions=np.concatenate(actions),
        reaching=cost >= 0,
    )


def replay(
    cells: CellSpace,
    start: Place,
    actions: Float[np.ndarray, "steps"] | Sequence[float],
    *,
    motion: Motion = CELL_BY_CELL,
) -> Int[np.ndarray, "visited"]:
    """Simulate a bouncing robot that executes an action string.

    **Arguments:** a cell space, a first cell or pose, and actions: 0 for a step forward, and an
    angle in radians for a bump. **Returns:** the visited cells.

    **Raises:** `ValueError` if an action is not possible in its cell.

    A robot goes to the end of a corridor of three squares, turns around, and goes one step back:

        >>> import math
        >>> from jaxcell import bounce, examples
        >>> cells = examples.corridor()
        >>> bounce.replay(cells, 0, [0.0, 0.0, math.pi, 0.0]).tolist()
        [0, 1, 2, 5, 4]
    """
    first = cell_of(cells, start)
    direction, position = divmod(first, cells.positions)
    possible = moves(cells, motion=motion)
    target = np.asarray(possible.target)[np.asarray(possible.way)]
    path = [first]
    for i, action in enumerate(actions):
        ahead = target[direction, position].item()
        if (action != 0) != (ahead == position):
            wrong = "cannot go forward" if action == 0 else "does not bump, so it cannot turn"
            raise ValueError(f"actions[{i}]: in cell {path[-1]} the robot {wrong}")
        direction += bounce_shift(action, cells.directions, f"actions[{i}]").item()
        direction, position = direction % cells.directions, ahead
        path.append(direction * cells.positions + position)
    return np.array(path, np.int32)
