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

from ...automata import HiddenMap
from ...base import memory
from ...space import CellSpace, Slip, felt_walls, nearest_cell, slipping_step, stride_legs
from ...space.slip import ERRORS, TURNING, to_wall
from ..dynamics import bounce_shift


# Configurations and errors that are tried in each cell, a power of two.
_SAMPLES = 128
# Squares that are sampled at once.
_CHUNK = 2048
MAX_CELLS = 100_000
"How many fine cells a map is cut into at most, unless told otherwise."
# By how many standard deviations a heading may drift in so many steps, by how many radians a bump
# turns the robot, and how many cells it goes along one heading.
_DRIFT, _STEPS, _TURN, _WAY = 2.5, 40, 2.4, 1.5
# The most squares along the side of a cell, and the most fine directions of one, that are tried.
_MAX_SQUARES, _MAX_DIRECTIONS = 31, 64
# Bytes of a cell: the entries of its row in a matrix, while it is made.
_BYTES = 1000


@dataclasses.dataclass(frozen=True, eq=False)
class FineCells:
    """The cells of a map cut into finer ones, among which a robot that slips is followed.

    A robot that slips looks another way than it takes itself to, and how it makes a step depends on
    the latter. So a fine cell is a square, a direction of the map, which the robot believes, and by
    how many fine directions its heading is off: `z = row * squares + square`, where
    `row = direction * (2 reach + 1) + reach + off`. An odd number of fine squares lie along the
    side of a cell, so that its centre is that of one.

        >>> import numpy as np
        >>> from jaxcell import bounce, examples
        >>> corridor = examples.corridor(directions=4)
        >>> cells = bounce.FineCells.of(corridor, squares=3, directions=2, reach=1)
        >>> cells.size, int(np.count_nonzero(cells.centres))
        (324, 12)
    """

    cells: CellSpace
    "The cells of the map, which the robot believes itself to step through."
    fine: CellSpace
    "The fine squares, and the fine directions."
    reach: int
    "By how many fine directions a heading may be off to either side; what is off more counts so."

    @classmethod
    def of(cls, cells: CellSpace, *, squares: int, directions: int, reach: int) -> "FineCells":
        """**Arguments:**

        - `cells`: the cell space of a map.
        - `squares`: how many fine squares lie along the side of a cell; an odd number.
        - `directions`: how many fine directions each direction is cut into.
        - `reach`: as the field.

        **Raises:** `ValueError` for a number that is even or not positive, or for a cell space that
        has no map.
        """
        if squares < 1 or squares % 2 == 0:
            raise ValueError(f"squares: expected an odd number from 1, got {squares}")
        if directions < 1:
            raise ValueError(f"directions: expected at least 1, got {directions}")
        if reach < 0:
            raise ValueError(f"reach: expected a number from 0, got {reach}")
        if cells.workspace is None:
            raise ValueError("cells: expected those of a map, got those of a grid without one")
        number = cells.directions * directions
        fine = CellSpace.of(cells.workspace, cells.cell / squares, number)
        return cls(cells, fine, min(reach, number // 2))

    @classmethod
    def within(cls, cells: CellSpace, slip: Slip, most: int | None = None) -> "FineCells":
        """The cells, at most so many, that blur least where a robot is.

        A square hides where in it the robot is, and a fine direction how far aside it gets.
        Directions reach as far as the heading may drift, and are no finer than half the error of a
        turn.

        **Arguments:**

        - `cells`: the cell space of a map.
        - `slip`: how large the errors are, which decides how far off the heading may be.
        - `most`: how many cells at most, by default `MAX_CELLS`; if one for each cell of the map
            is more, these are taken.

        **Returns:** the fine cells.
        """
        assert cells.workspace is not None
        pose = np.stack(cells.centre(np.arange(cells.size)), axis=1)
        legs = np.repeat(stride_legs(cells.directions, cells.cell, cells.cell), cells.positions, 0)
        walls, exact = felt_walls(cells.workspace, slip.give), np.zeros((cells.size, ERRORS))
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
                if size <= (MAX_CELLS if most is None else most) and blur < least:
                    best, least = (squares, directions, reach), blur
        return cls.of(cells, squares=best[0], directions=best[1], reach=best[2])

    @property
    def size(self) -> int:
        """Number of fine cells."""
        return self.cells.directions * (2 * self.reach + 1) * self.fine.positions

    @functools.cached_property
    def poses(self) -> Float[np.ndarray, "fine 3"]:
        """The configuration of the centre of each cell, in metres and radians."""
        row, square = np.divmod(np.arange(self.size), self.fine.positions)
        direction, off = np.divmod(row, 2 * self.reach + 1)
        x, y, _ = self.fine.centre(square)
        turn = 2 * np.pi / self.fine.directions
        theta = direction * (2 * np.pi / self.cells.directions) + (off - self.reach) * turn
        return np.stack([x, y, theta], axis=1)

    @functools.cached_property
    def believed(self) -> Int[np.ndarray, "fine"]:
        """The direction that the robot believes to look in, in each cell."""
        return np.arange(self.size) // self.fine.positions // (2 * self.reach + 1)

    @functools.cached_property
    def coarse(self) -> Int[np.ndarray, "fine"]:
        """The cell of the map that each fine cell is in, or nearest to."""
        return nearest_cell(self.cells, *self.poses.T)

    @functools.cached_property
    def centres(self) -> Float[np.ndarray, "fine"]:
        """The distribution of a robot at the centre of a cell of the map, any of them."""
        return self.at(np.arange(self.cells.size))

    def at(self, cell: Int[np.ndarray, "..."] | int) -> Float[np.ndarray, "fine"]:
        """The distribution of a robot at the centre of any of some cells of the map."""
        cell = np.atleast_1d(cell)
        pose = np.stack(self.cells.centre(cell), axis=-1)
        where = self.index(pose, cell // self.cells.positions)
        return np.bincount(where, minlength=self.size) / where.size

    def index(
        self, pose: Float[np.ndarray, "*batch 3"], believed: Int[np.ndarray, "..."] | int
    ) -> Int[np.ndarray, "*batch"]:
        """The fine cell of configurations with believed directions, or the nearest one."""
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
    """The generalized map of a robot that slips, with what its bump sensor says on the way.

    Configurations are drawn evenly in each cell, each with errors of its own, and each driven a
    step as [`jaxcell.space.slipping_step`][] says (Hsu's generalized cell mapping by sampling).
    The points are those of a Sobol sequence, the same in each cell, so that a map is the same each
    time.

    **Arguments:**

    - `cells`: the fine cells.
    - `bounces`: the bouncing angle, or those to choose from, in radians, counter-clockwise.
    - `slip`: how large the errors are.
    - `step`: length of a step in metres, by default one cell of the map.

    **Returns:** the hidden map of the fine cells, which nothing leaves; it starts at the centre of
    any cell.

    **Raises:** `MemoryError` where the map would not fit the free memory.

    In a corridor of three cells, a robot in the middle that looks East moves on:

        >>> from jaxcell import bounce, examples, space
        >>> corridor = examples.corridor(directions=4)
        >>> cells = bounce.FineCells.of(corridor, squares=1, directions=1, reach=0)
        >>> hidden = bounce.slip_map(cells, [0.0], space.Slip())
        >>> hidden.moves[[1]].indices.tolist(), hidden.moves[[1]].data.tolist()
        ([2], [1.0])
    """
    # Slow to import.
    from scipy.stats import qmc

    coarse, fine = cells.cells, cells.fine
    assert coarse.workspace is not None
    size = cells.size
    memory.check(
        needed(size, len(bounces)),
        f"a map of {size} cells for a robot that slips",
        "use fewer cells",
    )
    points = qmc.Sobol(3 + ERRORS, seed=0).random(_SAMPLES)
    offsets = (points[:, :3] - 0.5) * [fine.cell, fine.cell, 2 * np.pi / fine.directions]
    errors = _normal(points[:, 3:])
    length = coarse.cell if step is None else step
    # Where in its direction a heading is decides in which it is next, not where the step leads:
    # drawn anew at each step, it would scatter a robot whose heading stays what it is.
    turned = np.zeros_like(offsets)
    turned[:, 2] = offsets[:, 2] * _spread(cells, slip, length, points[:, 2] - 0.5, errors[:, 1])
    offsets[:, 2] = 0
    legs = stride_legs(coarse.directions, coarse.cell, length)
    walls = felt_walls(coarse.workspace, slip.give)
    shifts = bounce_shift(np.asarray(bounces, float), coarse.directions).tolist()
    parts: list[list[scipy.sparse.csr_array]] = [[] for _ in range(1 + len(shifts))]
    squares = np.stack(fine.centre(np.arange(fine.positions)), axis=1)
    chunk = min(_CHUNK, fine.positions)
    for row, begin in itertools.product(
        range(size // fine.positions), range(0, fine.positions, chunk)
    ):
        cell = row * fine.positions
        told = int(cells.believed[cell])
        start = offsets + np.array([0.0, 0.0, cells.poses[cell, 2]])
        # Chunks have one shape; what the last has too many is dropped.
        here = np.minimum(np.arange(begin, begin + chunk), fine.positions - 1)
        count = min(chunk, fine.positions - begin)
        after, bumped = map(
            np.asarray, _drive(squares[here], start, legs[told], errors, walls, slip)
        )
        after = after + turned
        begun, sample = np.nonzero(~bumped[:count])
        image = cells.index(after[begun, sample], told)
        parts[0].append(_shares(begun, image, count, size))
        begun, sample = np.nonzero(bumped[:count])
        for shift, found in zip(shifts, parts[1:], strict=True):
            pose = after[begun, sample]
            turn = math.remainder(shift * 2 * math.pi / coarse.directions, 2 * math.pi)
            pose[:, 2] += turn * (1 + slip.turn * errors[sample, TURNING])
            image = cells.index(pose, (told + shift) % coarse.directions)
            found.append(_shares(begun, image, count, size))
    moves, *bumps = (scipy.sparse.vstack(part, format="csr") for part in parts)
    return HiddenMap.of(moves, bumps, cells.coarse, cells.centres)


def _spread(
    cells: FineCells,
    slip: Slip,
    length: float,
    offset: Float[np.ndarray, "samples"],
    error: Float[np.ndarray, "samples"],
) -> float:
    """Of how much of its fine direction a heading is drawn anew, at most of all of it.

    Drawn from all of it, one that drifts by a small part of a direction would go to the next too
    often. It is drawn from so much that the variance of its changes is that of the drift, but no
    less than that of how far aside, in squares, the headings of one direction lead.

    **Arguments:**

    - `cells`, `slip`: the fine cells, and how large the errors are.
    - `length`: length of a step, in metres.
    - `offset`: where in its direction a heading is, -0.5 to 0.5.
    - `error`: of its drift along a step, standard normal numbers.
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
    """The samples of some rows as a part of a matrix."""
    share = np.full(row.size, 1 / _SAMPLES)
    return scipy.sparse.coo_array((share, (row, image)), shape=(rows, size)).tocsr()


def _normal(shares: Float[np.ndarray, "samples errors"]) -> Float[np.ndarray, "samples errors"]:
    """Standard normal numbers from even ones; their mean is 0 and their variance 1 exactly."""
    from scipy.special import ndtri

    found = ndtri(np.clip(shares, 1e-9, 1 - 1e-9))
    found = found - found.mean(axis=0)
    return np.asarray(found / found.std(axis=0))


def needed(cells: int = MAX_CELLS, angles: int = 1) -> int:
    """Bytes of the map of a robot that slips, among so many fine cells."""
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
    """Where samples around the middle of each square are after a step, and whether they bump.

    All but the walls is the same around each square, so that it is computed once.
    """

    def around(middle: Float[Array, "1 3"]) -> tuple[Array, Array]:
        after, bumped = slipping_step(
            start,
            jnp.broadcast_to(leg, start.shape),
            0.0,
            errors,
            walls,
            slip,
            ahead_of=lambda walls, place, heading: jax_free_ahead(
                walls, middle[:, :2] + place, heading
            ),
        )
        return after + middle, bumped

    return jax.vmap(around)(squares[:, None])


def jax_free_ahead(
    walls: Float[Array, "walls 2 2"],
    place: Float[Array, "*batch 2"],
    heading: Float[Array, "*batch"],
) -> Float[Array, "*batch"]:
    """[`jaxcell.space.free_ahead`][] in one loop that is compiled once for any number of walls."""
    ux, uy = jnp.cos(heading), jnp.sin(heading)

    def nearer(nearest, wall):  # type: ignore[no-untyped-def]
        return jnp.minimum(nearest, to_wall(wall, place, ux, uy)), None

    return jax.lax.scan(nearer, jnp.full(place.shape[:-1], jnp.inf), walls)[0]
