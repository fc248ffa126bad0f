import math

import numpy as np
from jaxtyping import Bool, Float, Int

from .cells import TOLERANCE


# Pairs of a step and a wall that are tested at once.
STEPS_AT_ONCE = 2**21


def displacement(direction: int, directions: int, step: float) -> tuple[float, float]:
    """Compute the end of a step from the origin, rounded to be the same on all platforms."""
    angle = 2 * math.pi * direction / directions
    return round(step * math.cos(angle), 9), round(step * math.sin(angle), 9)


def crossed_squares(
    dx: float, dy: float, offset: tuple[int, int]
) -> tuple[tuple[tuple[int, int], ...], tuple[tuple[tuple[int, int], tuple[int, int]], ...]]:
    """List the squares that a step from the centre of a square crosses.

    The step moves by `dx` and `dy` squares, and ends in the square `offset`. Squares are `(row,
    column)` relative to the start. **Returns:** the squares whose interior the step crosses,
    including the last square; and, for each corner that the step passes, the two squares beside the
    corner.
    """
    crossed, beside = {offset: None}, []
    east, north = int(math.copysign(1, dx)), int(math.copysign(1, dy))
    # The step meets the lines between columns at x = 1/2, 3/2, ... from its start, and rows
    # likewise.
    to_column = [(m + 0.5) / abs(dx) for m in range(int(abs(dx) + 0.5))] if dx else []
    to_row = [(m + 0.5) / abs(dy) for m in range(int(abs(dy) + 0.5))] if dy else []
    row = column = 0
    while to_column or to_row:
        next_column, next_row = (to_column or [math.inf])[0], (to_row or [math.inf])[0]
        if abs(next_column - next_row) < TOLERANCE:
            corner = (row, column + east), (row + north, column)
            row, column = row + north, column + east
            to_column, to_row = to_column[1:], to_row[1:]
            # A corner at the end is not passed, unless the end square lies beyond it.
            if next_row < 1 - TOLERANCE or (row, column) == offset:
                beside.append(corner)
        elif next_column < next_row:
            column, to_column = column + east, to_column[1:]
        else:
            row, to_row = row + north, to_row[1:]
        if min(next_column, next_row) < 1 - TOLERANCE:
            crossed[row, column] = None
    return tuple(crossed), tuple(beside)


def meets_wall(
    walls: Float[np.ndarray, "walls 3 2"],
    centres: Float[np.ndarray, "positions 2"],
    steps: Float[np.ndarray, "directions 2"],
    near: Int[np.ndarray, "pairs"],
    wall: Int[np.ndarray, "pairs"],
) -> tuple[Int[np.ndarray, "near"], Bool[np.ndarray, "near directions"]]:
    """Find the steps that meet a wall.

    `walls` are those of [`jaxcell.space.CellSpace.walls`][]; centres and steps have the same units.
    `near[i]` and `wall[i]` are the indices of a centre and of a wall that is at most a step away.
    Returns each index in `near` once, and a mask of the steps from its centre that meet a wall.
    """
    order = np.argsort(near, kind="stable")
    near, wall = near[order], wall[order]
    places, first = np.unique(near, return_index=True)
    corner, passes, leaves = _corners(walls, steps)
    length = np.linalg.norm(steps, axis=1)
    unit = steps / length[:, None]
    # A corner at the end is not passed, unless the end cell is the upper right one, beyond it.
    beyond = (np.abs((steps + 0.5) % 1) < TOLERANCE).all(axis=1) & (steps > 0).all(axis=1)
    reach = length + np.where(beyond, TOLERANCE, -TOLERANCE)

    blocked = np.empty((len(places), len(steps)), bool)
    chunks = -(-len(near) * len(steps) // STEPS_AT_ONCE)
    for part in np.array_split(np.arange(len(places)), chunks) if chunks else ():
        pairs = slice(first[part[0]], first[part[-1] + 1] if part[-1] + 1 < len(first) else None)
        centre, w = centres[near[pairs]], wall[pairs]
        a, b = walls[w, 1] - centre, walls[w, 2] - centre
        along = (b - a) / np.linalg.norm(b - a, axis=1, keepdims=True)
        # Signed distances: of both ends of the step from the line of the wall, positive on its free
        # side, and of both ends of the wall from the line of the step.
        start = -cross(along, a)[:, None]
        stop = start + cross(along[:, None], steps)
        side_a, side_b = cross(unit, a[:, None]), cross(unit, b[:, None])
        meets = _opposite(start, stop) & _opposite(side_a, side_b)
        # A centre on a wall may not step through it. From a corner the step has to be into the free
        # side.
        on_corner = (np.hypot(*a.T) < TOLERANCE)[:, None]
        on_wall = (np.abs(start) < TOLERANCE) & (np.vecdot(a, b)[:, None] < -TOLERANCE)
        meets |= on_wall & (stop < -TOLERANCE)
        meets |= on_corner & ~leaves[corner[w]]
        # The step has to pass corners on their free side.
        distance = a @ unit.T
        on_way = (distance > TOLERANCE) & (distance < reach)
        meets |= on_way & (np.abs(side_a) < TOLERANCE) & ~passes[corner[w]]
        blocked[part] = np.logical_or.reduceat(meets, first[part] - first[part[0]], axis=0)
    return places, blocked


def _opposite(
    u: Float[np.ndarray, "*#shape"], v: Float[np.ndarray, "*#shape"]
) -> Bool[np.ndarray, "*shape"]:
    return (np.minimum(u, v) < -TOLERANCE) & (np.maximum(u, v) > TOLERANCE)


def _corners(
    walls: Float[np.ndarray, "walls 3 2"], steps: Float[np.ndarray, "directions 2"]
) -> tuple[
    Int[np.ndarray, "walls"],
    Bool[np.ndarray, "corners directions"],
    Bool[np.ndarray, "corners directions"],
]:
    """Find the corner where each wall starts, and the steps that may pass it or start there.

    The free space at the start of a wall is the wedge that opens counter-clockwise from this wall
    to the next wall that ends at the same corner. If obstacles meet in a point, several wedges
    share the corner, and a robot has to stay in one wedge.

    Returns the corner of each wall, a mask of the steps that may pass each corner, and a mask of
    the steps that may start there.
    """
    before, start, end = np.moveaxis(walls, 1, 0)
    _, corner = np.unique(np.round(start, 9), axis=0, return_inverse=True)
    corner = corner.reshape(-1)
    opens, closes = _angle(end - start), _angle(before - start)
    wedge = _turn(closes - opens)
    for wall in np.flatnonzero(np.bincount(corner)[corner] > 1):
        wedge[wall] = _turn(closes[corner == corner[wall]] - opens[wall]).min()
    wedge, into = wedge[:, None], _turn(_angle(steps) - opens[:, None])
    inside = into <= wedge + TOLERANCE
    # Passing takes the free half plane on one side of the step.
    left, right = into + np.pi <= wedge + TOLERANCE, into >= np.pi - TOLERANCE
    passes, leaves = np.zeros((2, corner.max() + 1, len(steps)), bool)
    np.logical_or.at(passes, corner, inside & (left | right))
    np.logical_or.at(leaves, corner, inside)
    return corner, passes, leaves


def _angle(vector: Float[np.ndarray, "*shape 2"]) -> Float[np.ndarray, "*shape"]:
    return np.arctan2(vector[..., 1], vector[..., 0])


def _turn(angle: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    """Reduce angles to [0, 2 pi). A full turn minus a rounding error becomes 0."""
    angle = angle % (2 * np.pi)
    return np.where(angle > 2 * np.pi - TOLERANCE, 0.0, angle)


def cross(
    u: Float[np.ndarray, "*#shape 2"], v: Float[np.ndarray, "*#shape 2"]
) -> Float[np.ndarray, "*shape"]:
    return u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]
