"""Draw rooms with obstacles at random places, determined by a seed and a room number."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool


DIRECTIONS = 360
"Number of directions in the environments of Figure 2.7."
ROOM = np.ones((125, 200), bool)
"The free cells of the room of Figure 2.7: 200 x 125 cells minus an obstacle at its boundary."
ROOM[:20, 70:100] = False
_SQUARE = np.ones((25, 25), bool)
_RECTANGLE = np.ones((18, 40), bool)
_RECTILINEAR = np.ones((30, 36), bool)
_RECTILINEAR[12:, 12:] = False
_SIDES = (10, 50)
_MAX_ATTEMPTS = 1000


ENVIRONMENTS: dict[str, Callable[[np.random.Generator], list[np.ndarray]]] = {
    "E1": lambda rng: [_SQUARE],
    "E2": lambda rng: [_SQUARE, _RECTANGLE],
    "E3": lambda rng: [_SQUARE, _RECTANGLE, _RECTILINEAR],
    "E4": lambda rng: [np.ones((rng.integers(*_SIDES, endpoint=True),) * 2, bool)],
}
"Functions that draw the obstacles of the environments of Figure 2.7 (Alam 2018, section 2.5.1)."


class Placement(NamedTuple):
    """A room of Figure 2.7 with obstacles at random places."""

    free: Bool[np.ndarray, "rows columns"]
    corners: list[tuple[int, int]]
    "Lower left corner (x, y) of each obstacle."
    side: int
    "Side of the square obstacle, in cells."


def place(seed: int, environment: str, run: int) -> Placement:
    """Put obstacles into the room of Figure 2.7, uniformly over all placements without overlap.

    All environments of Alam 2018, section 2.5.1, have one fixed obstacle at the boundary. The
    obstacles at random places are

    - E1: a square,
    - E2: a square and a rectangle,
    - E3: a square, a rectangle and a rectilinear obstacle (an L),
    - E4: a square of random size.

    The dissertation gives no sizes of obstacles. Here they have the sizes in
    `data/maps/room_200x125.json`, and sides of 10 to 50 in E4. Random obstacles are at least one
    cell away from the boundary. The placement depends on the seed and on the number `run`.
    """
    # Each placement has a stream of its own, so a longer study begins with the shorter one.
    rng = np.random.default_rng([seed, int(environment[1:]), run])
    obstacles = ENVIRONMENTS[environment](rng)
    while True:
        free, corners = ROOM.copy(), []
        for obstacle in obstacles:
            x, y = (
                int(rng.integers(1, outer - inner))
                for outer, inner in zip(ROOM.shape[::-1], obstacle.shape[::-1], strict=True)
            )
            window = free[y : y + obstacle.shape[0], x : x + obstacle.shape[1]]
            if not window[obstacle].all():
                break
            window[obstacle] = False
            corners.append((x, y))
        else:
            return Placement(free, corners, len(obstacles[0]))


def random_room(
    seed: int, number: int, columns: int, rows: int, obstacles: int
) -> Bool[np.ndarray, "rows columns"]:
    """Draw the free cells of a room with rectangular obstacles at random places.

    The sides of an obstacle are a twentieth to a fifth of the sides of the room, at least one cell.
    Obstacles may overlap and touch walls. A room is drawn again, at most a thousand times, until
    all free cells are connected through shared edges. The room depends on the seed and on `number`.
    """
    rng = np.random.default_rng([seed, number, columns, rows, obstacles])
    for _ in range(_MAX_ATTEMPTS):
        free = np.ones((rows, columns), bool)
        for _ in range(obstacles):
            width, height = (
                int(rng.integers(max(1, size // 20), max(1, size // 5), endpoint=True))
                for size in (columns, rows)
            )
            x, y = int(rng.integers(columns - width + 1)), int(rng.integers(rows - height + 1))
            free[y : y + height, x : x + width] = False
        if _is_connected(free):
            return free
    raise ValueError(
        f"obstacles: {obstacles} obstacles leave a room of {columns} x {rows} cells in several "
        "pieces; expected fewer"
    )


def _is_connected(free: Bool[np.ndarray, "rows columns"]) -> bool:
    """Check that a robot can go from every free cell to every other one."""
    # The number of the run of free cells in each row and in each column.
    rows, columns = (
        np.cumsum(np.pad(~grid, ((0, 0), (1, 0)), constant_values=True)).reshape(len(grid), -1)
        for grid in (free, free.T)
    )
    reached = np.zeros_like(free)
    reached.flat[np.argmax(free)] = free.any()
    count = -1
    while count != (count := int(reached.sum())):
        for run in (rows[:, 1:], columns[:, 1:].T):
            hit = np.zeros(int(run.max()) + 1, bool)
            hit[run[reached]] = True
            reached = free & hit[run]
    return 0 < count == int(free.sum())
