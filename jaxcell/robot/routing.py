"""Find shortest paths through a grid with Lee's wave routing."""

from collections.abc import Collection

import numpy as np
from jaxtyping import Bool, Int


def grid_steps(
    free: Bool[np.ndarray, "rows columns"], closed: Collection[tuple[int, int]] = ()
) -> Int[np.ndarray, "4 positions"]:
    """Find the position after a step in each direction from each free square of a grid.

    A step into a square that is not free ends where it began.

    **Arguments:** a mask of free squares, whose row 0 is the lowest, and the `closed` steps between
    free squares, as pairs of a position and a direction: 0 East, 1 North, 2 West or 3 South. A
    closed step is blocked in both directions.

    **Returns:** a row for each of the four directions. The positions are the free squares, counted
    row by row, as in [`jaxcell.space.CellSpace`][].

    Two free squares, one above the other:

        >>> import numpy as np
        >>> from jaxcell import robot
        >>> robot.grid_steps(np.array([[True], [True]])).tolist()
        [[0, 1], [1, 1], [0, 1], [0, 0]]
    """
    position = np.full(np.add(free.shape, 2), -1, np.int32)
    inner = position[1:-1, 1:-1]
    inner[free] = np.arange(np.count_nonzero(free), dtype=np.int32)
    across = [position[1:-1, 2:], position[2:, 1:-1], position[1:-1, :-2], position[:-2, 1:-1]]
    here = inner[free]
    steps = np.stack([np.where(there[free] < 0, here, there[free]) for there in across])
    for at, way in closed:
        _check(steps, at, "closed")
        if not 0 <= way < 4:
            raise ValueError(f"closed: expected a direction from 0 to 3, got {way}")
        close(steps, at, way)
    return steps


def close(steps: Int[np.ndarray, "4 positions"], position: int, way: int) -> None:
    """Change `steps` to block the step from a position in the direction `way`, and its reverse."""
    there = int(steps[way, position])
    if there != position:
        steps[way, position], steps[(way + 2) % 4, there] = position, there


def wave(steps: Int[np.ndarray, "4 positions"], goal: int) -> Int[np.ndarray, "positions"]:
    """Count the steps from each position to a goal (Lee 1961).

    A wave starts at the goal and spreads to all neighbours at once. **Arguments:** the steps of
    [`grid_steps`][], and the position of the goal. **Returns:** the number of steps; -1 if the goal
    cannot be reached.

    A row of four squares with a wall between the last two:

        >>> import numpy as np
        >>> from jaxcell import robot
        >>> steps = robot.grid_steps(np.ones((1, 4), bool), closed=[(2, 0)])
        >>> robot.wave(steps, 0).tolist()
        [0, 1, 2, -1]
    """
    _check(steps, goal, "goal")
    distance = np.full(steps.shape[1], -1, np.int32)
    front = np.array([goal])
    count = 0
    while front.size:
        distance[front] = count
        front = np.unique(steps[:, front])
        front = front[distance[front] < 0]
        count += 1
    return distance


def next_way(
    steps: Int[np.ndarray, "4 positions"],
    distance: Int[np.ndarray, "positions"],
    position: int,
    ahead: int,
) -> int:
    """Choose the direction of the next step on a shortest path.

    `distance` is the result of [`wave`][] for the goal. If several steps lead nearer to the goal, a
    step in the direction `ahead` is preferred, because turns take time and cost precision. The
    robot must not be at the goal, and a path to the goal must exist.
    """
    nearer = distance[steps[:, position]] == distance[position] - 1
    return ahead if nearer[ahead] else int(nearer.argmax())


def _check(steps: Int[np.ndarray, "4 positions"], position: int, name: str) -> None:
    if not 0 <= position < steps.shape[1]:
        raise ValueError(
            f"{name}: position {position} does not exist; positions are 0 to {steps.shape[1] - 1}"
        )
