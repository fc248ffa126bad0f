import dataclasses
import functools
import math
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..mapping import SimpleMap
from ..space import CELL_BY_CELL, ENDPOINT as ENDPOINT, CellSpace, Motion, estimates, stencil
from ..space.extent import Extent
from ..space.steps import Steps


_Ints: TypeAlias = Int[Array, "..."] | Int[np.ndarray, "..."]


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Moves:
    """Where one step leads from every position in every direction, whatever the bouncing angle.

    Directions in which all positions have the same target share a *way*: on a grid, 360 directions
    make 16 ways, and what depends on the walls alone is computed once for a way.
    """

    target: Int[Array, "ways positions"]
    "The position that holds the end of the step, or the same position where the robot bumps."
    way: Int[Array, "directions"]
    "The way of each direction."
    free: Bool[Array, "positions"]
    "Which positions are free: all, unless the positions are the squares of a grid with obstacles."


@functools.lru_cache(maxsize=4)
def moves(cells: CellSpace, *, motion: Motion = CELL_BY_CELL) -> Moves:
    """Where one step leads from the centre of every cell. The last few answers are kept.

    **Arguments:**

    - `cells`: the cell space.
    - `motion`: how the robot moves.

    **Returns:** [`Moves`][].

    **Raises:** `ValueError` for a step that is too short or not finite; `MemoryError` where the
    moves would not fit the free memory.

    A corridor of three squares, with the directions East and West:

        >>> from jaxcell import bounce, examples
        >>> cells = examples.corridor()
        >>> moves = bounce.moves(cells)
        >>> moves.target[moves.way].tolist()
        [[1, 2, 2], [0, 0, 1]]
    """
    estimates.check(
        Extent.of(cells), lambda e: estimates.moves(e, motion), "moves of all cells", motion.step
    )
    steps = Steps.of(cells, motion)
    # Under `jit` too this is a constant.
    with jax.ensure_compile_time_eval():
        free = np.ones(cells.positions, bool)
        return Moves(*jax.device_put((steps.targets(cells), steps.way, free)))


def grid_moves(
    free: Bool[Array, "rows columns"],
    directions: int,
    *,
    motion: Motion = CELL_BY_CELL,
) -> Moves:
    """Where one step leads on a grid whose blocked squares are the obstacles.

    Works under `jit` and `vmap` over `free`.

    All squares are positions here, row by row from the lowest, so that grids of one shape with
    different obstacles are arrays of one shape; `Moves.free` marks the free ones.

    **Arguments:**

    - `free`: which squares are free; row 0 is the lowest.
    - `directions`: number of directions.
    - `motion`: how the robot moves; the side of a square is 1 m.

    **Returns:** [`Moves`][].

    A corridor of three squares whose last is blocked, with the directions East and West:

        >>> import jax.numpy as jnp
        >>> from jaxcell import bounce
        >>> moves = bounce.grid_moves(jnp.array([[True, True, False]]), directions=2)
        >>> moves.target[moves.way].tolist()
        [[1, 1, 2], [0, 0, 2]]
    """
    shape = stencil(directions, motion, free.shape)
    return _grid_moves(free, shape.way, *shape.looks)


@jax.jit
def _grid_moves(
    free: Bool[Array, "rows columns"],
    way: Int[Array, "directions"],
    relative: Int[Array, "looks 2"],
    crossed: Int[Array, "ways crossings"],
    beside: Int[Array, "ways corners 2"],
    offset: Int[Array, "ways 2"],
) -> Moves:
    rows, columns = free.shape
    square = jnp.arange(rows * columns, dtype=jnp.int32)
    row = square[None] // columns + relative[:, :1]
    column = square[None] % columns + relative[:, 1:]
    inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
    is_free = inside & free.ravel()[row * columns + column]
    passes = free.ravel()[None]
    # One after the other: together they would not fit the memory where steps are long.
    for on_the_way in crossed.T:
        passes = passes & is_free[on_the_way]
    for left, right in beside.transpose(1, 2, 0):
        passes = passes & (is_free[left] | is_free[right])
    hop = offset[:, :1] * columns + offset[:, 1:]
    target = square[None] + jnp.where(passes, hop, 0)
    return Moves(target, way, free.ravel())


def bounce_shift(
    bounce: Float[np.ndarray, "..."] | Array | float | int, directions: int
) -> Int[np.ndarray, "..."]:
    """A bouncing angle as a number of directions.

    **Arguments:**

    - `bounce`: angles in radians, counter-clockwise.
    - `directions`: number of directions in a full turn.

    **Returns:** the numbers of directions, at least 0 and less than `directions`.

    **Raises:** `ValueError` for an angle that is not a whole number of directions.

    Of eight directions, three make 135 degrees:

        >>> import math
        >>> from jaxcell import bounce
        >>> int(bounce.bounce_shift(math.radians(135), directions=8))
        3
    """
    shift = np.asarray(bounce, float) * directions / (2 * math.pi)
    whole = np.round(shift)
    # Infinity less itself is no number, and beyond 2^53 every float64 is whole.
    with np.errstate(invalid="ignore"):
        wrong = ~((np.abs(shift - whole) < 1e-6) & (np.abs(shift) < 2**53))
    if wrong.any():
        degrees = np.rad2deg(np.asarray(bounce, float)[wrong].flat[0])
        raise ValueError(
            f"bounce: {degrees:g} deg is not a whole number of the {directions} directions, "
            f"which are {360 / directions:g} deg apart"
        )
    return np.asarray(whole.astype(np.int64) % directions, np.int32)


def bounce_map(
    cells: CellSpace,
    bounce: Float[np.ndarray, "*batch"] | Array | float | int,
    *,
    motion: Motion = CELL_BY_CELL,
) -> SimpleMap:
    """The image of every cell, for a robot that goes straight and turns at a wall.

    From the centre of a cell the robot makes one step along its direction. Where it can, the image
    is the cell that holds the end, in the same direction (observation 0); where it cannot, the
    robot turns in place: the image is the same position in the direction `bounce` farther
    (observation 1). Eq. 2.4 of Alam 2018.

    **Arguments:**

    - `cells`: the cell space.
    - `bounce`: bouncing angle in radians, counter-clockwise; an array of angles makes a batch of
        maps.
    - `motion`: how the robot moves.

    **Returns:** [`jaxcell.mapping.SimpleMap`][] with arrays over the cells.

    **Raises:** `ValueError` for an angle that is not a whole number of directions; `MemoryError`
    where the images would not fit the free memory; else as [`moves`][].

    A corridor of three squares; cells 0, 1, 2 look East and 3, 4, 5 West:

        >>> import math
        >>> from jaxcell import bounce, examples
        >>> cells = examples.corridor()
        >>> there_and_back = bounce.bounce_map(cells, math.pi)
        >>> there_and_back.image.tolist(), there_and_back.bumped.astype(int).tolist()
        ([1, 2, 5, 0, 3, 4], [0, 0, 1, 1, 0, 0])
    """
    shift = bounce_shift(bounce, cells.directions)
    possible = moves(cells, motion=motion)
    estimates.check(
        Extent.of(cells),
        lambda e: estimates.IMAGE * e.size * shift.size,
        "images of all cells",
        motion.step,
    )
    target, way = np.asarray(possible.target), np.asarray(possible.way)
    maps = zip(*(_images(target, way, one) for one in shift.ravel().tolist()), strict=True)
    # One alone is not copied.
    both = (each[0] if len(each) == 1 else np.concatenate(each) for each in maps)
    return SimpleMap(*jax.device_put([each.reshape(*shift.shape, -1) for each in both]))


@jax.jit
def bounce_image(moves: Moves, shift: Int[Array, ""] | int) -> SimpleMap:
    """The bounce map of known moves; works under `jit` and `vmap` over both arguments.

    **Arguments:**

    - `moves`: where a step leads.
    - `shift`: directions that the robot turns by at a bump.

    **Returns:** [`jaxcell.mapping.SimpleMap`][].

    A corridor of three squares; cells 0, 1, 2 look East and 3, 4, 5 West:

        >>> from jaxcell import bounce, examples
        >>> cells = examples.corridor()
        >>> bounce.bounce_image(bounce.moves(cells), 1).image.tolist()
        [1, 2, 5, 0, 3, 4]
    """
    image, bumped = _images(moves.target, moves.way, shift)
    return SimpleMap(image.ravel(), bumped.ravel())


def _images(target: _Ints, way: _Ints, shift: _Ints | int) -> tuple[Any, Any]:
    """The images of all cells, and where the robot bumps; of NumPy, or traced."""
    xp = target.__array_namespace__()
    directions, positions = way.shape[0], target.shape[1]
    direction = xp.arange(directions, dtype=xp.int32)
    turned = (direction + shift) % directions
    bumped = target == xp.arange(positions, dtype=xp.int32)[None]
    # A bump adds as much to the cells of all directions, but of those that turn past the last one.
    bump = bumped.astype(xp.int32)
    turns = xp.stack([target + bump * (by * positions) for by in (shift, shift - directions)])
    image = turns[(turned < direction).astype(xp.int32), way]
    image += (direction * positions)[:, None]
    return image, bumped[way]


def motion_violations(
    cells: CellSpace,
    path: Int[np.ndarray, "times robots"],
    bumped: Bool[np.ndarray, "times-1 robots"],
    turn: Int[np.ndarray, "times-1"] | None = None,
) -> Bool[np.ndarray, "times-1 robots"]:
    """Whether a robot does not keep its direction in a move, or its position where it bumps.

    **Arguments:**

    - `cells`: the cell space.
    - `path`: the cells of each robot over time.
    - `bumped`: whether the robot turned in place.
    - `turn`: by how many directions; `None` if that is not known.
    """
    direction, position = np.divmod(path, cells.positions)
    stays = position[1:] == position[:-1]
    by = (direction[1:] - direction[:-1]) % cells.directions
    right = stays if turn is None else stays & (by == turn[:, None] % cells.directions)
    return ~np.where(bumped, right, ~stays & (by == 0))
