import math

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int

from .cells import TOLERANCE, CellSpace
from .stencils import displacement


# Steps that are tested with a wall at once.
STEPS_AT_ONCE = 2**21
# Squares in a row of a block.
_BLOCK = 32


def blocked_steps(
    cells: CellSpace, step: float, collision: str
) -> tuple[Int[np.ndarray, "near"], Bool[np.ndarray, "near directions"]]:
    """The steps that walls of any shape are in the way of.

    Walls in reach of a centre are tested exactly, to a tolerance of 1e-9 of a cell.

    **Arguments:**

    - `cells`: the cell space.
    - `step`: length of a step in cells.
    - `collision`: `"swept"` or `"endpoint"`.

    **Returns:** the free squares within a step of a wall, and in which directions a wall is in the
    way of a step from the centre of each. Elsewhere it is only the end that has to be free.

    **Raises:** `ValueError` for a space made from a grid, which has no walls of other shapes.
    """
    rows, columns = cells.free.shape
    steps = _displacements(cells, step)
    reach = float(np.linalg.norm(steps[0])) + TOLERANCE
    tree = shapely.STRtree(shapely.linestrings(cells.walls))
    # Blocks of squares are tested, which are far fewer, and then the squares of those near walls.
    blocks = np.zeros((-(-rows // _BLOCK), -(-columns // _BLOCK)), bool)
    bottom, left = np.indices(blocks.shape).reshape(2, -1) * _BLOCK
    boxes = shapely.box(left, bottom, left + _BLOCK, bottom + _BLOCK)
    blocks.flat[tree.query(boxes, predicate="dwithin", distance=reach)[0]] = True
    around = blocks.repeat(_BLOCK, 0).repeat(_BLOCK, 1)[:rows, :columns]
    square = np.argwhere(cells.free & around)
    centres = square[:, ::-1] + 0.5
    near, wall = tree.query(shapely.points(centres), predicate="dwithin", distance=reach)
    if collision == "endpoint":
        near = np.unique(near)
        blocked = _end_outside(cells, centres[near], steps)
    else:
        near, blocked = meets_wall(cells.walls, centres, steps, near, wall)
    return square[near] @ (columns, 1), blocked


def _displacements(cells: CellSpace, step: float) -> Float[np.ndarray, "directions 2"]:
    # All longer ones lead off the map too.
    step = min(step, math.hypot(*cells.free.shape) + 1)
    return np.array([displacement(k, cells.directions, step) for k in range(cells.directions)])


def _end_outside(
    cells: CellSpace,
    centres: Float[np.ndarray, "near 2"],
    steps: Float[np.ndarray, "directions 2"],
) -> Bool[np.ndarray, "near directions"]:
    assert cells.workspace is not None
    closed = cells.workspace.free_space.buffer(TOLERANCE * cells.cell, join_style="mitre")
    shapely.prepare(closed)
    ends = (centres[:, None] + steps) * cells.cell + np.array(cells.origin)
    return ~shapely.contains_xy(closed, ends[..., 0], ends[..., 1])


def meets_wall(
    walls: Float[np.ndarray, "walls 3 2"],
    centres: Float[np.ndarray, "positions 2"],
    steps: Float[np.ndarray, "directions 2"],
    near: Int[np.ndarray, "pairs"],
    wall: Int[np.ndarray, "pairs"],
) -> tuple[Int[np.ndarray, "near"], Bool[np.ndarray, "near directions"]]:
    """Whether each step meets a wall; `near` and `wall` are the pairs in reach.

    All is in units of a cell from the origin, and `walls` as those of the cell space.
    """
    order = np.argsort(near, kind="stable")
    near, wall = near[order], wall[order]
    places, first = np.unique(near, return_index=True)
    corner, passes, leaves = _corners(walls, steps)
    length = np.linalg.norm(steps, axis=1)
    unit = steps / length[:, None]
    # A corner at the end is not passed, unless the end cell lies beyond it: the upper right one of
    # four.
    beyond = (np.abs((steps + 0.5) % 1) < TOLERANCE).all(axis=1) & (steps > 0).all(axis=1)
    reach = length + np.where(beyond, TOLERANCE, -TOLERANCE)

    blocked = np.empty((len(places), len(steps)), bool)
    chunks = -(-len(near) * len(steps) // STEPS_AT_ONCE)
    for some in np.array_split(np.arange(len(places)), chunks) if chunks else ():
        pairs = slice(first[some[0]], first[some[-1] + 1] if some[-1] + 1 < len(first) else None)
        centre, w = centres[near[pairs]], wall[pairs]
        a, b = walls[w, 1] - centre, walls[w, 2] - centre
        along = (b - a) / np.linalg.norm(b - a, axis=1, keepdims=True)
        # Signed distances: of both ends of the step from the line of the wall, positive on its free
        # side, and of both ends of the wall from the line of the step.
        start = -cross(along, a)[:, None]
        stop = start + cross(along[:, None], steps)
        side_a, side_b = cross(unit, a[:, None]), cross(unit, b[:, None])
        meets = _opposite(start, stop) & _opposite(side_a, side_b)
        # A centre on a wall may not step through it, one on a corner has to step into the free
        # side.
        on_corner = (np.hypot(*a.T) < TOLERANCE)[:, None]
        on_wall = (np.abs(start) < TOLERANCE) & (np.vecdot(a, b)[:, None] < -TOLERANCE)
        meets |= on_wall & (stop < -TOLERANCE)
        meets |= on_corner & ~leaves[corner[w]]
        # A corner on the way has to be passed on its free side.
        distance = a @ unit.T
        on_way = (distance > TOLERANCE) & (distance < reach)
        meets |= on_way & (np.abs(side_a) < TOLERANCE) & ~passes[corner[w]]
        blocked[some] = np.logical_or.reduceat(meets, first[some] - first[some[0]], axis=0)
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
    """The corner where each wall starts, and in which directions each can be passed and left.

    The free space at the start of a wall is the wedge that opens counter-clockwise from this wall
    to the next one that ends there. Where obstacles meet in a point, several wedges share it, and a
    robot has to stay in one of them.
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
    # Passing takes the free half plane on one side of the way.
    left, right = into + np.pi <= wedge + TOLERANCE, into >= np.pi - TOLERANCE
    passes, leaves = np.zeros((2, corner.max() + 1, len(steps)), bool)
    np.logical_or.at(passes, corner, inside & (left | right))
    np.logical_or.at(leaves, corner, inside)
    return corner, passes, leaves


def _angle(vector: Float[np.ndarray, "*shape 2"]) -> Float[np.ndarray, "*shape"]:
    return np.arctan2(vector[..., 1], vector[..., 0])


def _turn(angle: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    """The angle in [0, 2 pi); what is a rounding error short of a full turn is none."""
    angle = angle % (2 * np.pi)
    return np.where(angle > 2 * np.pi - TOLERANCE, 0.0, angle)


def cross(
    u: Float[np.ndarray, "*#shape 2"], v: Float[np.ndarray, "*#shape 2"]
) -> Float[np.ndarray, "*shape"]:
    return u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]
