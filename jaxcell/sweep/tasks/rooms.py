"""Rooms with obstacles at random places, told by a seed and the number of the room."""

import functools
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from jaxtyping import Bool

from .parameters import Parameter, angle, members, one_of, whole
from .results import but, dataset, together


DIRECTIONS = 360
"Directions in the environments of Figure 2.7."
ROOM = np.ones((125, 200), bool)
"The free cells of their room: 200 x 125, with the static obstacle [70, 100] x [0, 20]."
ROOM[:20, 70:100] = False
_SQUARE = np.ones((25, 25), bool)
_RECTANGLE = np.ones((18, 40), bool)
_RECTILINEAR = np.ones((30, 36), bool)
_RECTILINEAR[12:, 12:] = False
_SIDES = (10, 50)
_MOST_ATTEMPTS = 1000


def _scaled_square(rng: np.random.Generator) -> Bool[np.ndarray, "side side"]:
    side = rng.integers(*_SIDES, endpoint=True)
    return np.ones((side, side), bool)


ENVIRONMENTS: dict[str, Callable[[np.random.Generator], list[np.ndarray]]] = {
    "E1": lambda rng: [_SQUARE],
    "E2": lambda rng: [_SQUARE, _RECTANGLE],
    "E3": lambda rng: [_SQUARE, _RECTANGLE, _RECTILINEAR],
    "E4": lambda rng: [_scaled_square(rng)],
}
"The obstacles of the environments of Figure 2.7 of Alam 2018, section 2.5.1."


class Placement(NamedTuple):
    """A room of Figure 2.7."""

    free: Bool[np.ndarray, "rows columns"]
    "Its free cells."
    corners: list[tuple[int, int]]
    "Lower left corner (x, y) of each obstacle."
    side: int
    "Side of the square."


def place(seed: int, environment: str, run: int) -> Placement:
    """Puts obstacles into the room of Figure 2.7, uniformly over all ways in which they do not
    overlap.

    Section 2.5.1 changes the obstacles of "the environment E of Figure 2.6", which has a static
    obstacle at its boundary, so that obstacle stands in all of

    - E1: a square at a random place inside,
    - E2: a square and a rectangle,
    - E3: a square, a rectangle and a rectilinear obstacle (an L),
    - E4: a square of random size.

    The source gives no sizes of obstacles; ours are those of `data/maps/room_200x125.json`, and
    sides of 10 to 50 in E4. Random obstacles keep a cell from the boundary and do not overlap.

    **Arguments:**

    - `seed`: of the study.
    - `environment`: E1, E2, E3 or E4.
    - `run`: number of the placement, from 0.
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
    """The free cells of a room with rectangles at random places, all of it in one piece.

    Sides of rectangles are a fifth to a twentieth of the room's, at least a cell; they may overlap
    and stand at walls. Rooms whose free cells are not connected by their edges are drawn anew.

    **Arguments:**

    - `seed`: of the study.
    - `number`: of the room, from 0.
    - `columns`, `rows`: size of the room in cells.
    - `obstacles`: number of rectangles.

    **Raises:** `ValueError` where such a room is too rarely in one piece.
    """
    import scipy.ndimage

    rng = np.random.default_rng([seed, number, columns, rows, obstacles])
    for _ in range(_MOST_ATTEMPTS):
        free = np.ones((rows, columns), bool)
        for _ in range(obstacles):
            width, height = (_side(rng, size) for size in (columns, rows))
            x, y = int(rng.integers(columns - width + 1)), int(rng.integers(rows - height + 1))
            free[y : y + height, x : x + width] = False
        if scipy.ndimage.label(free)[1] == 1:
            return free
    raise ValueError(
        f"obstacles: expected so few that a room of {columns} x {rows} cells stays in one piece, "
        f"got {obstacles}"
    )


def _side(rng: np.random.Generator, size: int) -> int:
    return int(rng.integers(max(1, size // 20), max(1, size // 5), endpoint=True))


PARAMETERS = {
    "room": Parameter(whole(0)),
    "bounce": Parameter(angle),
    "environment": Parameter(one_of("random", *ENVIRONMENTS), "random"),
    "columns": Parameter(whole(1, 10_000), 50),
    "rows": Parameter(whole(1, 10_000), 45),
    "obstacles": Parameter(whole(0, 1000), 6),
    "directions": Parameter(whole(1, 3600), DIRECTIONS),
    "collision": Parameter(one_of("swept", "endpoint"), "swept"),
}


def room_of(
    parameters: Mapping[str, Any], seed: int
) -> tuple[Bool[np.ndarray, "rows columns"], dict[str, Any]]:
    """The free cells of the room of one member, and all its parameters, those by default too."""
    batch = {name: np.array([value]) for name, value in parameters.items()}
    (member,) = members("rooms", PARAMETERS, batch, {})
    return _free(seed, member), member


def _free(seed: int, member: Mapping[str, Any]) -> Bool[np.ndarray, "rows columns"]:
    number, environment = member["room"], member["environment"]
    if environment == "random":
        sizes = (member[name] for name in ("columns", "rows", "obstacles"))
        return random_room(seed, number, *sizes)
    return place(seed, environment, number).free


def rooms(batch: Mapping[str, np.ndarray], fixed: Mapping[str, Any], seed: int) -> xr.Dataset:
    """Periodic groups, and the filter of a robot that knows its heading, in random rooms.

    Parameters: `room`, a number from 0; `bounce`, in degrees; `environment`, `random` or one of E1
    to E4 of Figure 2.7; `columns`, `rows` and `obstacles` of a random room; `directions`;
    `collision`. Chunks with many angles of one room are the fastest.
    """
    found = members("rooms", PARAMETERS, batch, fixed)
    return dataset(_RESULTS, together(found, but("bounce"), functools.partial(_rows, seed)))


def _rows(seed: int, some: list[dict[str, Any]]) -> list[list[int]]:
    from ...bounce import bounce_shift, heading_filter_sizes, wall_groups, walls

    member, bounces = some[0], np.radians([one["bounce"] for one in some])
    free = _free(seed, member)
    shift, which = np.unique(bounce_shift(bounces, member["directions"]), return_inverse=True)
    known = walls(free[None], member["directions"], collision=member["collision"])
    groups = wall_groups(known, shift)
    columns = [
        np.full((1, shift.size), free.sum()),
        groups.count,
        groups.longest_transient,
        groups.longest_period,
        groups.periodic_cells,
        groups.largest_basin,
        heading_filter_sizes(known, shift),
    ]
    rows: list[list[int]] = np.concatenate(columns).T[which].tolist()
    return rows


_RESULTS = {
    "positions": ("free cells of the room", "1"),
    "groups": ("number of periodic groups", "1"),
    "longest_transient": ("longest transient", "mappings"),
    "longest_period": ("longest period", "mappings"),
    "periodic_cells": ("cells of periodic groups", "1"),
    "largest_basin": ("cells that reach the same group, at most", "1"),
    "filter_states": ("states of the filter of a robot that starts in direction 0", "1"),
}
