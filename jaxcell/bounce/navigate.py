import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..space import CellSpace
from .dynamics import Collision, bounce_shift, moves
from .roadmap import Method, Roadmap
from .ways import Ways, costs, solve


@dataclasses.dataclass(frozen=True, eq=False)
class Plan:
    """What a robot does to get from one cell to another (Alam 2018, Alg. 3.1)."""

    start: int
    goal: int
    cost: int | float
    "-1 if there is no path."
    actions: Float[np.ndarray, "steps"]
    "The action string: 0 for a step forward, and at a bump the angle to turn by, in radians."
    cells: Int[np.ndarray, "steps+1"]
    "The cells that the robot visits; the start alone if there is no path."
    reaching: Bool[np.ndarray, "cells"]
    "The cells from which the goal can be reached, itself among them."

    @property
    def found(self) -> bool:
        """Whether there is a path."""
        return self.cost >= 0

    @property
    def bumps(self) -> Float[np.ndarray, "bumps"]:
        """The angles of the action string."""
        return self.actions[self.actions != 0]

    @property
    def angles_used(self) -> int:
        """How many different angles the robot uses."""
        return np.unique(self.bumps).size

    @property
    def changes(self) -> int:
        """How many bumps use another angle than the bump before."""
        return int(np.count_nonzero(np.diff(self.bumps)))


def plan(
    cells: CellSpace,
    bounces: Float[np.ndarray, "angles"] | Array | Sequence[float],
    start: int,
    goal: int,
    keep: int | float = 1,
    change: int | float = 100,
    *,
    step: float | None = None,
    collision: Collision = "swept",
    method: Method = "exact",
) -> Plan:
    """A cheapest plan from one cell to another (Alam 2018, Alg. 3.1).

    At each bump the robot may turn by any of the angles. A step forward costs `keep`, as does a
    bump with the same angle as the bump before; a bump with another angle costs `change`. The first
    bump of a plan changes nothing, and costs `keep` by whatever angle: in the dissertation a path
    may start in the graph of any angle.

    The dissertation searches one graph for each angle. Within it a turn by that angle costs `keep`
    and any other `change`, whatever the bump before was. `method="layered"` does so, and takes the
    cheapest of all graphs. It differs from three bumps on: turns by A, B, A cost `2 keep + change`
    there and `keep + 2 change` here; turns by A, A, B, B cost `2 keep + 2 change` there and `3 keep
    + change` here. (Were the graphs joined into one at their cells, as in the pseudo-code, an edge
    could not tell what the bump before it was.)

    **Arguments:**

    - `cells`: the cell space.
    - `bounces`: the angles to choose from, in radians, counter-clockwise.
    - `start`, `goal`: cells.
    - `keep`, `change`: the costs. Plans of whole costs cost whole numbers.
    - `step`, `collision`: as for [`jaxcell.bounce.moves`][].
    - `method`: `"exact"`, or `"layered"` as the dissertation does.

    **Returns:** [`jaxcell.bounce.Plan`][]. If there is no path, its cost is -1.

    **Raises:** `ValueError` for a cell that does not exist; for no angles, one that is not a whole
    number of directions, one that turns the robot to the same direction as another or not at all;
    for costs that are not finite and above 0, or a change that costs less than none; `MemoryError`
    where the roadmap would not fit the free memory; and as [`jaxcell.bounce.moves`][].

    A corridor of three squares, whose cells 0, 1, 2 look East and 3, 4, 5 West; to turn takes one
    bump:

        >>> import math
        >>> import numpy as np
        >>> from jaxcell import bounce, space
        >>> cells = space.CellSpace.of_grid(np.ones((1, 3), bool), directions=2)
        >>> way = bounce.plan(cells, [math.pi], start=0, goal=4)
        >>> way.cost, way.cells.tolist()
        (4, [0, 1, 2, 5, 4])
    """
    roadmap = Roadmap.of(
        cells, bounces, keep, change, step=step, collision=collision, method=method
    )
    start, goal = roadmap.check_cell(start, "start"), roadmap.check_cell(goal, "goal")
    return read_plan(roadmap, solve(roadmap, roadmap.entry_of[[goal]]), start, goal)


def read_plan(roadmap: Roadmap, ways: Ways, start: int, goal: int) -> Plan:
    """The plan from a cell to a goal.

    **Arguments:**

    - `roadmap`: the roadmap.
    - `ways`: the ways to the entry of the goal.
    - `start`, `goal`: cells.
    """
    cost = costs(roadmap, ways.cost, np.array([goal]))[:, 0]
    path, actions = [np.array([start], np.int32)], [np.empty(0)]
    if cost[start] >= 0:
        cell, wall = start, roadmap.wall[start]
        layer = ways.layer[0, wall]
        while not roadmap.runs_through(cell, goal):
            if len(path) > 2 * roadmap.turned.size:
                raise ValueError("the plans do not lead to the goal; their file was altered")
            run = roadmap.line(cell, roadmap.wall_cell[wall].item())
            turn = ways.turn[0, layer, wall].item()
            cell = roadmap.turned[turn, wall].item()
            path += [run, np.array([cell])]
            actions += [np.zeros(run.size), roadmap.bounces[[turn]]]
            wall = roadmap.wall[cell]
            layer = turn if roadmap.method == "exact" else layer
        run = roadmap.line(cell, goal)
        path.append(run)
        actions.append(np.zeros(run.size))
    return Plan(
        start=start,
        goal=goal,
        cost=cost[start].item(),
        cells=np.concatenate(path).astype(np.int32),
        actions=np.concatenate(actions),
        reaching=cost >= 0,
    )


def replay(
    cells: CellSpace,
    start: int,
    actions: Float[np.ndarray, "steps"] | Sequence[float],
    *,
    step: float | None = None,
    collision: Collision = "swept",
) -> Int[np.ndarray, "visited"]:
    """Runs an action string in the bounce dynamics.

    **Arguments:**

    - `cells`: the cell space.
    - `start`: the cell of the robot.
    - `actions`: 0 for a step forward, an angle in radians for a bump.
    - `step`, `collision`: as for [`jaxcell.bounce.moves`][].

    **Returns:** the cells that the robot visits.

    **Raises:** `ValueError` if the start does not exist, and for an action that is not possible
    where the robot is, which it names.

    To the end of a corridor of three squares, right about, and one step back:

        >>> import math
        >>> import numpy as np
        >>> from jaxcell import bounce, space
        >>> cells = space.CellSpace.of_grid(np.ones((1, 3), bool), directions=2)
        >>> bounce.replay(cells, 0, [0.0, 0.0, math.pi, 0.0]).tolist()
        [0, 1, 2, 5, 4]
    """
    if not 0 <= start < cells.size:
        raise ValueError(f"start: cell {start} does not exist; cells are 0 to {cells.size - 1}")
    possible = moves(cells, step=step, collision=collision)
    target = np.asarray(possible.target)[np.asarray(possible.way)]
    direction, position = divmod(start, cells.positions)
    path = [start]
    for i, action in enumerate(actions):
        ahead = target[direction, position].item()
        if (action != 0) != (ahead == position):
            wrong = "cannot go forward" if action == 0 else "does not bump, so it cannot turn"
            raise ValueError(f"actions[{i}]: in cell {path[-1]} the robot {wrong}")
        try:
            direction = (
                direction + bounce_shift(action, cells.directions).item()
            ) % cells.directions
        except ValueError as error:
            raise ValueError(f"actions[{i}]: {error}") from None
        position = ahead
        path.append(direction * cells.positions + position)
    return np.array(path, np.int32)
