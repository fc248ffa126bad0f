import itertools
import math

import numpy as np
import scipy.sparse
import shapely
from jaxtyping import Bool, Float, Int, Shaped

from ...automata import Bounded
from ...base import memory
from ...space import Slip, stride_legs
from ..dynamics import bounce_shift
from .fine_cells import FineCells


# A step is divided into parts of this length, in cells of the map; each part is in a box.
_PART = 0.1
# Tolerance in squares: boxes that only touch do not overlap.
_TOUCH = 1e-9
# Bytes per fine cell.
_BYTES = 1500


def bounded_map(
    cells: FineCells, bounce: float, slip: Slip, *, step: float | None = None
) -> Bounded:
    """For each cell, find the cells where a robot with bounded errors may be one step later.

    The map contains all possible moves. At each time of a step, a box contains all points where the
    robot may be. A bump is possible unless all boxes are free, and certain only if a box lies
    wholly in a wall. So the robot is always in the set of possible cells if the error of its
    heading is at most `cells.reach` fine directions.

    **Arguments:** the fine cells; the bouncing angle in radians, counter-clockwise; the slip, whose
    numbers are bounds of the errors; and the length of a step in metres, by default one cell.

    **Returns:** the set-valued map. The robot starts at the centre of any cell of the map, and may
    later be anywhere in its fine cells. For each observation there are three matrices, which are
    applied in this order: moves along x, which may end in walls; moves along y, which end in free
    squares; and changes of the heading.

    In a corridor of three cells, a robot without errors may go from a point of the first cell to
    the edge of this cell, or to the next cell:

        >>> import numpy as np
        >>> from jaxcell import bounce, examples, space
        >>> corridor = examples.corridor(directions=4)
        >>> cells = bounce.FineCells.of(corridor, squares=1, directions=9, reach=0)
        >>> sets = bounce.bounded_map(cells, 0.0, space.Slip())
        >>> sets.observe(np.array([0]), 0).tolist()
        [0, 1]
    """
    coarse, fine = cells.cells, cells.fine
    size = cells.size
    memory.check(_BYTES * size, f"a bounded map of {size} cells", "use fewer cells")
    felt = coarse.room.free_space.buffer(slip.give, join_style="mitre")
    # The bumper feels a wall somewhere between these two.
    inner, outer = (felt.buffer(by, join_style="mitre") for by in (-slip.bumper, slip.bumper))
    legs = stride_legs(coarse.directions, coarse.cell, coarse.cell if step is None else step)
    shift = int(bounce_shift(bounce, coarse.directions))
    turned = abs(math.remainder(bounce, 2 * math.pi)) * slip.turn
    # The robot may be over the edge of the free squares, in the give of a wall.
    half = fine.cell / 2 + slip.give + (0.0 if fine.gridded else fine.cell)
    bin_ = 2 * math.pi / fine.directions
    centre = np.stack(fine.centre(np.arange(fine.positions))[:2], axis=1)
    width = 2 * cells.reach + 1
    right: tuple[list[np.ndarray], list[np.ndarray]] = [], []
    up: tuple[list[np.ndarray], list[np.ndarray]] = [], []
    rows = coarse.directions * width
    turns = np.zeros((2, rows, rows), bool)
    for row in range(rows):
        direction, off = row // width, row % width - cells.reach
        theta = direction * 2 * math.pi / coarse.directions + off * bin_
        first, turn, second = legs[direction].tolist()
        drift = slip.heading * (first + abs(second))
        aside = 2 * abs(turn) * slip.turn
        path = _path(theta, bin_ / 2, (first, turn, second), slip, _PART * coarse.cell)
        moves, bumps = _possible(centre, path, half, inner, outer)
        _add_moves(cells, row, moves, path[-1], half, right[0], up[0])
        turns[0, row, _rows(cells, direction, off, bin_ / 2 + drift + aside)] = True
        # The drive back ends at the start except for the errors of both drives.
        run = (first + abs(second)) * (1 + slip.step)
        gap = run * (2 * slip.step / max(1 - slip.step, 1e-9) + 4 * drift + aside)
        gap += run * abs(slip.bump_turn) + slip.bump_skid
        spread = bin_ / 2 + drift * (2 + slip.step) + aside + turned + abs(slip.bump_turn)
        back = np.array([-gap, -gap, gap, gap])
        _add_moves(cells, row, bumps, back, half, right[1], up[1])
        facing = (direction + shift) % coarse.directions
        turns[1, row, _rows(cells, facing, off, spread)] = True
    between = rows * fine.free.size
    images = [
        (
            _pattern(right[i], (size, between)),
            _pattern(up[i], (between, size)),
            scipy.sparse.csr_array(turns[i]),
        )
        for i in (0, 1)
    ]
    return Bounded((images[0], images[1]), cells.coarse, cells.centres)


def _path(
    theta: float, half: float, legs: tuple[float, float, float], slip: Slip, part: float
) -> Float[np.ndarray, "times 4"]:
    """Compute boxes that contain a robot at successive times of a step, relative to its start.

    The first box is the start. The heading `theta` has an error of at most `half`, in radians, and
    `legs` is a row of [`jaxcell.space.stride_legs`][]. From box to box the robot drives at most
    `part` metres. A box is a row with its left, bottom, right and top, in metres.
    """
    first, turn, second = legs
    boxes = [np.zeros((1, 4))]
    for length, angle, off in (
        (first, theta, half + slip.heading * first),
        (second, theta + turn, half + slip.heading * (first + abs(second)) + abs(turn) * slip.turn),
    ):
        if length:
            gone = np.linspace(0, 1, math.ceil(abs(length) / part) + 1)[1:]
            boxes.append(boxes[-1][-1] + _sector(gone * length, angle, off, slip))
    return np.concatenate(boxes)


def _sector(
    gone: Float[np.ndarray, "times"], angle: float, off: float, slip: Slip
) -> Float[np.ndarray, "times 4"]:
    """Compute boxes around the possible positions after `gone` metres along `angle`.

    The heading differs from `angle` by at most `off`, in radians.
    """
    if gone[-1] < 0:
        gone, angle = -gone, angle + math.pi
    # The chord of a bent path is shorter than the path.
    least, most = gone * (1 - slip.step) * max(math.cos(off), 0.0), gone * (1 + slip.step)
    quarters = np.arange(-8, 9) * math.pi / 2
    turns = math.remainder(angle, 2 * math.pi) + np.array([-off, 0.0, off])
    inside = quarters[(quarters > turns[0]) & (quarters < turns[2])]
    angles = np.concatenate([turns, inside])
    x, y = (np.stack([f(angles) * r[:, None] for r in (least, most)]) for f in (np.cos, np.sin))
    return np.stack([x.min((0, 2)), y.min((0, 2)), x.max((0, 2)), y.max((0, 2))], axis=1)


def _possible(
    centre: Float[np.ndarray, "squares 2"],
    path: Float[np.ndarray, "times 4"],
    half: float,
    inner: shapely.Geometry,
    outer: shapely.Geometry,
) -> tuple[Bool[np.ndarray, "squares"], Bool[np.ndarray, "squares"]]:
    """Find the squares from which a robot may make a step, and those from which it may bump.

    `path` contains the boxes of a step, which are enlarged by `half` on all sides. The bumper feels
    a wall after the robot leaves the space `inner`, and before it leaves the space `outer`.
    """
    moves, bumps = np.ones(len(centre), bool), np.zeros(len(centre), bool)
    shapely.prepare(inner)
    shapely.prepare(outer)
    for before, after in itertools.pairwise(path):
        moves[moves] = shapely.intersects(outer, _boxes_at(centre[moves], after, half))
        hull = np.concatenate([np.minimum(before, after)[:2], np.maximum(before, after)[2:]])
        bumps[~bumps] = ~shapely.covers(inner, _boxes_at(centre[~bumps], hull, half))
    return moves, bumps


def _boxes_at(
    centre: Float[np.ndarray, "squares 2"], box: Float[np.ndarray, "4"], half: float
) -> Shaped[np.ndarray, "squares"]:
    """Return a copy of `box` around the centre of each square, enlarged by `half` on all sides."""
    x, y = centre.T
    around = half - _TOUCH
    left, bottom, right, top = box + np.array([-around, -around, around, around])
    return np.asarray(shapely.box(x + left, y + bottom, x + right, y + top))


def _add_moves(
    cells: FineCells,
    row: int,
    possible: Bool[np.ndarray, "squares"],
    box: Float[np.ndarray, "4"],
    half: float,
    right: list[np.ndarray],
    up: list[np.ndarray],
) -> None:
    """Add the moves from the squares `possible` with one heading, that of a row of fine cells.

    A robot may move to any square in `box`, which is relative to its square and is enlarged by
    `half`. A move is divided into a move along x to any square of the grid, which is added to
    `right`, and a move along y to a free square, which is added to `up`.
    """
    fine = cells.fine
    height, width = fine.free.shape
    low = np.ceil((box[:2] - half) / fine.cell - 0.5 + _TOUCH).astype(int)
    high = np.floor((box[2:] + half) / fine.cell + 0.5 - _TOUCH).astype(int)
    first = np.array([[row * fine.positions], [row * fine.free.size]])
    begin = np.flatnonzero(possible)
    square, end = fine.square[begin], np.arange(fine.positions)
    for aside in range(low[0], high[0] + 1):
        inside = (square % width + aside >= 0) & (square % width + aside < width)
        right.append(first + np.stack([begin[inside], square[inside] + aside]))
    for above in range(low[1], high[1] + 1):
        line = fine.square // width - above
        inside = (line >= 0) & (line < height)
        up.append(first[::-1] + np.stack([(fine.square - above * width)[inside], end[inside]]))


def _rows(cells: FineCells, facing: int, off: int, spread: float) -> Int[np.ndarray, "rows"]:
    """Find the rows of fine cells whose headings differ from a heading by at most `spread` radians.

    This heading is the direction `facing` plus the error `off`, in fine directions.
    """
    fine = cells.fine
    more = math.ceil(spread * fine.directions / (2 * math.pi) + 0.5 - _TOUCH) - 1
    # Around the whole circle each direction comes once.
    offs = off + np.arange(-more, more + 1)
    if cells.reach >= fine.directions // 2:
        offs = (offs + cells.reach) % fine.directions - cells.reach
    width = 2 * cells.reach + 1
    return facing * width + cells.reach + np.clip(offs, -cells.reach, cells.reach)


def _pattern(edges: list[np.ndarray], shape: tuple[int, int]) -> scipy.sparse.csr_array:
    row, column = np.concatenate(edges, axis=1)
    return scipy.sparse.coo_array((np.ones(row.size, bool), (row, column)), shape=shape).tocsr()
