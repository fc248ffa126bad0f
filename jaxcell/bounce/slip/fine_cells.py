import dataclasses
import functools
import itertools
import math
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse
from jaxtyping import Array, Float, Int
from scipy.special import ndtri
from scipy.stats import qmc

from ...automata import HiddenMap
from ...base import memory
from ...base.shown import Shown
from ...space import CellSpace, Slip, felt_walls, nearest_cell, slipping_step, stride_legs
from ...space.slip import ERRORS, TURNING, to_wall
from ..dynamics import bounce_shift


SAMPLES = 128
"""Number of samples per fine cell, a power of two. Each sample has its own pose and errors."""
# Number of squares that are sampled at once.
_CHUNK = 2048
MAX_CELLS = 100_000
"The default limit on the number of fine cells if the error of a step is 2 % or more."
# Assumptions of `FineCells.within`: the drift of a heading in standard deviations, the steps during
# which it drifts, the turn after a bump in radians, and the cells along one heading.
_DRIFT, _STEPS, _TURN, _WAY = 2.5, 40, 2.4, 1.5
# The largest numbers of squares along the side of a cell, and of fine directions, that are tried.
_MAX_SQUARES, _MAX_DIRECTIONS = 31, 64
# Bytes per fine cell, for the entries of its row while a matrix is made.
_BYTES = 1000


@dataclasses.dataclass(frozen=True, eq=False)
class FineCells(Shown):
    """The finer cells of a map, for the belief of a robot that slips.

    A robot that slips believes that its heading is a direction of the map, the *believed*
    direction. The length of its steps depends on this direction. So a fine cell is a square, a
    believed direction, and the error `off` of the heading, from `-reach` to `reach` fine
    directions: `z = row * squares + square`, where `row = direction * (2 reach + 1) + reach + off`.
    The number of fine squares along the side of a cell is odd, so one of them is at its centre.

        >>> import numpy as np
        >>> from jaxcell import bounce, examples
        >>> corridor = examples.corridor(directions=4)
        >>> cells = bounce.FineCells.of(corridor, squares=3, directions=2, reach=1)
        >>> cells.size, int(np.count_nonzero(cells.centres))
        (324, 12)
    """

    cells: CellSpace
    "The cells of the map."
    fine: CellSpace
    "The fine squares, and the fine directions."
    reach: int
    "The largest error of a heading to either side, in fine directions; larger errors are clipped."

    @classmethod
    def of(cls, cells: CellSpace, *, squares: int, directions: int, reach: int) -> "FineCells":
        """Divide the cells of a map.

        `squares` is the odd number of fine squares across a cell, `directions` the number of fine
        directions per direction of the map, and `reach` the largest error of a heading.
        """
        if squares < 1 or squares % 2 == 0:
            raise ValueError(f"squares: expected an odd number from 1, got {squares}")
        if directions < 1:
            raise ValueError(f"directions: expected at least 1, got {directions}")
        if reach < 0:
            raise ValueError(f"reach: expected a number from 0, got {reach}")
        number = cells.directions * directions
        fine = CellSpace.of(cells.room, cells.cell / squares, number)
        return cls(cells, fine, min(reach, number // 2))

    @classmethod
    def within(cls, cells: CellSpace, slip: Slip, most: int | None = None) -> "FineCells":
        """Choose the fine cells that locate a robot most precisely.

        The sizes of squares and of fine directions limit the precision: a belief does not
        distinguish points of one square, nor headings of one fine direction, though these drift
        apart. The fine directions reach as far as the heading is likely to drift, and are no finer
        than half the error of a turn.

        There are at most `most` cells. The default is 100,000 for errors of 2 % or more, and rises
        to 400,000 for errors of 0.5 % or less. There is at least one fine cell per cell of the map.
        """
        most = most_cells(slip.step) if most is None else most
        pose = np.stack(cells.centre(np.arange(cells.size)), axis=1)
        legs = np.repeat(stride_legs(cells.directions, cells.cell, cells.cell), cells.positions, 0)
        walls, exact = felt_walls(cells.room, slip.give), np.zeros((cells.size, ERRORS))
        bumps = _STEPS * slipping_step(pose, legs, 0.0, exact, walls, slip)[1].mean()
        drift = _DRIFT * math.hypot(
            math.sqrt(_STEPS) * slip.heading, _TURN * math.sqrt(bumps) * slip.turn
        )
        best, least = (1, 1, 0), math.inf
        for squares in range(1, _MAX_SQUARES + 1, 2):
            for directions in range(1, _MAX_DIRECTIONS + 1):
                number = cells.directions * directions
                bin_ = 2 * math.pi / number
                reach = min(max(1, math.ceil(drift / bin_ - 0.5)), number // 2)
                size = cells.positions * squares**2 * cells.directions * (2 * reach + 1)
                blur = 1 / squares**2 + (_WAY * max(bin_, _TURN * slip.turn / 2)) ** 2
                if size <= most and blur < least:
                    best, least = (squares, directions, reach), blur
        return cls.of(cells, squares=best[0], directions=best[1], reach=best[2])

    @property
    def size(self) -> int:
        """Number of fine cells."""
        return self.cells.directions * (2 * self.reach + 1) * self.fine.positions

    @functools.cached_property
    def poses(self) -> Float[np.ndarray, "fine 3"]:
        """The pose at the centre of each cell: x and y in metres, the heading in radians."""
        row, square = np.divmod(np.arange(self.size), self.fine.positions)
        direction, off = np.divmod(row, 2 * self.reach + 1)
        x, y, _ = self.fine.centre(square)
        turn = 2 * np.pi / self.fine.directions
        theta = direction * (2 * np.pi / self.cells.directions) + (off - self.reach) * turn
        return np.stack([x, y, theta], axis=1)

    @functools.cached_property
    def believed(self) -> Int[np.ndarray, "fine"]:
        """The believed direction of each fine cell."""
        return np.arange(self.size) // self.fine.positions // (2 * self.reach + 1)

    @functools.cached_property
    def coarse(self) -> Int[np.ndarray, "fine"]:
        """The cell of the map that contains each fine cell, or the nearest cell."""
        return nearest_cell(self.cells, *self.poses.T)

    @functools.cached_property
    def centres(self) -> Float[np.ndarray, "fine"]:
        """The uniform distribution of a robot over the centres of all cells of the map."""
        return self.at(np.arange(self.cells.size))

    def at(self, cell: Int[np.ndarray, "..."] | int) -> Float[np.ndarray, "fine"]:
        """Return the uniform distribution of a robot over the centres of some cells of the map."""
        cell = np.atleast_1d(cell)
        pose = np.stack(self.cells.centre(cell), axis=-1)
        where = self.index(pose, cell // self.cells.positions)
        return np.bincount(where, minlength=self.size) / where.size

    def index(
        self, pose: Float[np.ndarray, "*batch 3"], believed: Int[np.ndarray, "..."] | int
    ) -> Int[np.ndarray, "*batch"]:
        """Find the fine cell of each pose and believed direction, or the nearest fine cell."""
        square = nearest_cell(self.fine, pose[..., 0], pose[..., 1], 0.0)
        turn, number = 2 * np.pi / self.fine.directions, self.fine.directions
        theta = pose[..., 2] - believed * (2 * np.pi / self.cells.directions)
        off = np.floor(np.round(theta / turn + 0.5, 9)).astype(np.int64)
        off = (off + number // 2) % number - number // 2
        off = np.clip(off, -self.reach, self.reach)
        row = believed * (2 * self.reach + 1) + self.reach + off
        return np.asarray(row * self.fine.positions + square, np.int32)


def slip_map(
    cells: FineCells, bounces: Sequence[float], slip: Slip, *, step: float | None = None
) -> HiddenMap:
    """Build the generalized map of a robot that slips, with the observations of its bump sensor.

    Robots make one [`jaxcell.space.slipping_step`][] from sample poses in each cell, each with its
    own errors (Hsu's generalized cell mapping by sampling). The samples are the same points of a
    Sobol sequence in every cell, so the map is reproducible.

    **Arguments:** the fine cells; bouncing angles in radians, counter-clockwise; the slip; and the
    length of a step in metres, by default one cell of the map. **Returns:** a hidden Markov model,
    in which the robot starts at the centre of a random cell.

    In a corridor of three cells, a robot in the middle that looks East moves on:

        >>> from jaxcell import bounce, examples, space
        >>> corridor = examples.corridor(directions=4)
        >>> cells = bounce.FineCells.of(corridor, squares=1, directions=1, reach=0)
        >>> hidden = bounce.slip_map(cells, [0.0], space.Slip())
        >>> hidden.moves[[1]].indices.tolist(), hidden.moves[[1]].data.tolist()
        ([2], [1.0])
    """
    coarse, fine = cells.cells, cells.fine
    size = cells.size
    memory.check(
        needed(size, len(bounces)),
        f"a map of {size} cells for a robot that slips",
        "use fewer cells",
    )
    points = qmc.Sobol(3 + ERRORS, seed=0).random(SAMPLES)
    offsets = (points[:, :3] - 0.5) * [fine.cell, fine.cell, 2 * np.pi / fine.directions]
    errors = _normal(points[:, 3:])
    length = coarse.cell if step is None else step
    # The offset of a heading in its fine direction decides its next fine direction, but not the end
    # of the step: drawn at each step, it would scatter a robot whose heading does not change.
    turned = np.zeros_like(offsets)
    turned[:, 2] = offsets[:, 2] * _spread(cells, slip, length, points[:, 2] - 0.5, errors[:, 1])
    offsets[:, 2] = 0
    legs = stride_legs(coarse.directions, coarse.cell, length)
    walls = felt_walls(coarse.room, slip.give)
    shifts = bounce_shift(np.asarray(bounces, float), coarse.directions).tolist()
    parts: list[list[scipy.sparse.csr_array]] = [[] for _ in range(1 + len(shifts))]
    squares = np.stack(fine.centre(np.arange(fine.positions)), axis=1)
    chunk = min(_CHUNK, fine.positions)
    for row, begin in itertools.product(
        range(size // fine.positions), range(0, fine.positions, chunk)
    ):
        cell = row * fine.positions
        believed = int(cells.believed[cell])
        start = offsets + np.array([0.0, 0.0, cells.poses[cell, 2]])
        # Chunks have one shape; the surplus of the last chunk is dropped.
        here = np.minimum(np.arange(begin, begin + chunk), fine.positions - 1)
        count = min(chunk, fine.positions - begin)
        after, bumped = map(
            np.asarray, _drive(squares[here], start, legs[believed], errors, walls, slip)
        )
        after = after + turned
        begun, sample = np.nonzero(~bumped[:count])
        image = cells.index(after[begun, sample], believed)
        parts[0].append(_shares(begun, image, count, size))
        begun, sample = np.nonzero(bumped[:count])
        for shift, part in zip(shifts, parts[1:], strict=True):
            pose = after[begun, sample]
            turn = math.remainder(shift * 2 * math.pi / coarse.directions, 2 * math.pi)
            pose[:, 2] += turn * (1 + slip.turn * errors[sample, TURNING])
            image = cells.index(pose, (believed + shift) % coarse.directions)
            part.append(_shares(begun, image, count, size))
    moves, *bumps = (scipy.sparse.vstack(part, format="csr") for part in parts)
    return HiddenMap.of(moves, bumps, cells.coarse, cells.centres)


def _spread(
    cells: FineCells,
    slip: Slip,
    length: float,
    offset: Float[np.ndarray, "samples"],
    error: Float[np.ndarray, "samples"],
) -> float:
    """Choose the share, at most 1, of a fine direction over which samples of headings are spread.

    If headings drift little, but are spread over a whole fine direction, too many of them change to
    another fine direction. The share is the smallest for which the variance of these changes (in
    fine directions) is not below two others. One is that of the drift. The other is that of the
    sideways displacement (in squares) of robots whose headings are uniform in one fine direction.

    **Arguments:** the cells and the slip; the length of a step in metres; the offsets of headings
    in their direction, -0.5 to 0.5; and their drifts along a step, in standard deviations.
    """
    turn = 2 * math.pi / cells.fine.directions
    drift = slip.heading * math.sqrt(length) / turn
    least = max(drift**2, (turn * length / cells.fine.cell) ** 2 / 12)
    parts = np.linspace(0, 1, 65)
    variance = (np.rint(drift * error + parts[:, None] * offset) ** 2).mean(axis=1)
    enough = np.flatnonzero(variance >= least)
    return float(parts[enough[0]]) if enough.size else 1.0


def _shares(
    row: Int[np.ndarray, "entries"], image: Int[np.ndarray, "entries"], rows: int, size: int
) -> scipy.sparse.csr_array:
    """Build rows of a transition matrix from the row and the image of each sample."""
    share = np.full(row.size, 1 / SAMPLES)
    return scipy.sparse.coo_array((share, (row, image)), shape=(rows, size)).tocsr()


def _normal(shares: Float[np.ndarray, "samples errors"]) -> Float[np.ndarray, "samples errors"]:
    """Turn uniform numbers into normal numbers with exactly the mean 0 and the variance 1."""
    normal = ndtri(np.clip(shares, 1e-9, 1 - 1e-9))
    normal = normal - normal.mean(axis=0)
    return np.asarray(normal / normal.std(axis=0))


def most_cells(error: float) -> int:
    """Choose the limit on the number of fine cells, which is larger for small errors of a step."""
    return int(MAX_CELLS * min(max(1.0, 0.02 / max(error, 1e-9)), 4.0))


def needed(cells: int, angles: int = 1) -> int:
    """Estimate the bytes of the map of a robot that slips, for a number of bouncing angles."""
    return _BYTES * (1 + angles) * cells


@functools.partial(jax.jit, static_argnames="slip")
def _drive(
    squares: Float[Array, "squares 3"],
    start: Float[Array, "samples 3"],
    leg: Float[Array, "3"],
    errors: Float[Array, "samples errors"],
    walls: Float[Array, "walls 2 2"],
    slip: Slip,
) -> tuple[Float[Array, "squares samples 3"], Array]:
    """Move the samples of each square by a step, and return their poses and a mask of the bumps.

    `start` is the pose of each sample relative to the centre of its square. Only the walls differ
    between squares, so everything else is computed once.
    """

    def around(middle: Float[Array, "1 3"]) -> tuple[Array, Array]:
        # A loop keeps the compiled program small, however many walls there are.
        def ahead_of(walls, place, heading):  # type: ignore[no-untyped-def]
            place, ux, uy = middle[:, :2] + place, jnp.cos(heading), jnp.sin(heading)

            def nearer(nearest, wall):  # type: ignore[no-untyped-def]
                return jnp.minimum(nearest, to_wall(wall, place, ux, uy)), None

            return jax.lax.scan(nearer, jnp.full(place.shape[:-1], jnp.inf), walls)[0]

        legs = jnp.broadcast_to(leg, start.shape)
        after, bumped = slipping_step(start, legs, 0.0, errors, walls, slip, ahead_of=ahead_of)
        return after + middle, bumped

    return jax.vmap(around)(squares[:, None])
