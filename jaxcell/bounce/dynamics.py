import dataclasses
import functools
import math
import operator
from collections.abc import Callable, Sequence
from typing import Annotated, Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Real

from ..base.certificate import Numbers
from ..base.documents import about
from ..base.indices import as_array
from ..base.quantities import derived, quantity
from ..base.shown import Shown
from ..base.units import SAME_ANGLE
from ..base.wide import traced
from ..mapping import SimpleMap
from ..space import CELL_BY_CELL, ENDPOINT as ENDPOINT, CellSpace, Motion, estimates
from ..space.steps import Steps


Bounces: TypeAlias = Annotated[
    Float[Numbers, "angles"],
    quantity("bounce", "bouncing angle", "rad", kind="coordinate", sense="counter-clockwise"),
]
# A compiled program is made for a cell space and a motion: its tables depend on both.
jax.tree_util.register_static(CellSpace)
jax.tree_util.register_static(Motion)
Place: TypeAlias = int | np.integer | Sequence[float | int] | Real[np.ndarray, "numbers"]
"""A cell: its number, or the pose `(x, y, heading)` in metres and radians of a point in it, where
the heading is one of the directions, and by default 0, which is East."""
_Ints: TypeAlias = Int[Array, "..."] | Int[np.ndarray, "..."]


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Moves(Shown):
    """The end of one step from every position in every direction, for any bouncing angle.

    Directions form a class, called a *way*, if from each position their steps have the same end. On
    a grid, 360 directions with steps of one cell form 16 ways.
    """

    target: Int[Array, "ways positions"]
    "The position where the step ends; the position of the start if the robot bumps."
    way: Int[Array, "directions"]
    "For each direction, the number of its way (class of directions), which is a row of `target`."


@functools.lru_cache(maxsize=4)
def moves(cells: CellSpace, *, motion: Motion = CELL_BY_CELL) -> Moves:
    """Find the end of one step from the centre of every cell. The last few results are cached.

    **Arguments:** a cell space and a motion. **Returns:** [`Moves`][], for any bouncing angle.

    A corridor of three squares, with the directions East and West:

        >>> from jaxcell import bounce, examples
        >>> cells = examples.corridor()
        >>> moves = bounce.moves(cells)
        >>> moves.target[moves.way].tolist()
        [[1, 2, 2], [0, 0, 1]]
    """
    estimates.check_cells(cells, motion, estimates.moves, "moves of all cells")
    steps = Steps.of(cells, motion)
    # The result is a constant, under `jit` too.
    with jax.ensure_compile_time_eval():
        return Moves(*jax.device_put((steps.targets(cells), steps.way)))


def bounce_shift(
    bounce: Float[np.ndarray, "..."] | Array | float | int, directions: int, name: str = "bounce"
) -> Int[Any, "..."]:
    """Convert bouncing angles to numbers of directions.

    **Arguments:** angles in radians, counter-clockwise, and the number of directions in a full
    turn; `name` names the angles in errors. **Returns:** numbers from 0 to `directions - 1`.
    **Raises:** `ValueError` for an angle that is not a whole number of directions to 0.01 degree,
    which is the rounding of `1.5708` and the like. Under `jit` and
    `vmap`, where angles have no values, it stands for the nearest whole number.

    Of eight directions, three make 135 degrees:

        >>> import math
        >>> from jaxcell import bounce
        >>> int(bounce.bounce_shift(math.radians(135), directions=8))
        3
    """
    if traced(bounce):
        nearest = jnp.round(jnp.asarray(bounce, float) * directions / (2 * math.pi))
        return (nearest % directions).astype(jnp.int32)
    angles = np.asarray(as_array(bounce, name), float)
    if (infinite := ~np.isfinite(angles)).any():
        wrong = np.rad2deg(angles[infinite].flat[0])
        raise ValueError(f"{name}: {wrong:g} deg is not finite; expected an angle such as 45 deg")
    shift = angles * directions / (2 * math.pi)
    whole = np.round(shift)
    # Beyond 2^53 every float64 is whole.
    apart = np.abs(shift - whole) * (2 * math.pi / directions)
    wrong = ~((apart < SAME_ANGLE) & (np.abs(shift) < 2**53))
    if wrong.any():
        degrees, near = np.rad2deg(angles[wrong].flat[0]), whole[wrong].flat[0] / directions
        raise ValueError(
            f"{name}: {degrees:g} deg is not a whole number of the {directions} directions, "
            f"which are {360 / directions:g} deg apart; the nearest is {360 * near:g} deg"
        )
    return np.asarray(whole.astype(np.int64) % directions, np.int32)


def bounce_map(
    cells: CellSpace,
    bounce: Float[np.ndarray, "*batch"] | Array | float | int,
    *,
    motion: Motion = CELL_BY_CELL,
) -> SimpleMap:
    """Compute the image of every cell, for a robot that goes straight and turns at a wall.

    From the centre of a cell the robot makes one step along its direction. If the step is possible,
    the image is the cell that holds its end, in the same direction (observation 0). Otherwise the
    robot turns in place by the angle `bounce`: the image is a cell of the same position
    (observation 1). This is Eq. 2.4 of Alam 2018.

    **Arguments:** a cell space, bouncing angles in radians, counter-clockwise, and a motion. Angles
    may be traced by `jit` and `vmap`. **Returns:** the map; a batch of maps for an array of angles.

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
    estimates.check_cells(
        cells, motion, lambda e, _: estimates.IMAGE * e.size * shift.size, "images of all cells"
    )
    if isinstance(shift, jax.Array):
        return of_each(functools.partial(bounce_image, possible), shift)
    target, way = np.asarray(possible.target), np.asarray(possible.way)
    maps = zip(*(_images(target, way, one) for one in shift.ravel().tolist()), strict=True)
    # The arrays of a single map are not copied.
    both = (each[0] if len(each) == 1 else np.concatenate(each) for each in maps)
    return SimpleMap(*jax.device_put([each.reshape(*shift.shape, -1) for each in both]))


def of_each(function: Callable[[Any], Any], array: Any) -> Any:
    """Apply a function of a number to each number of an array that JAX traces."""
    for _ in jnp.shape(array):
        function = jax.vmap(function)
    return function(jnp.asarray(array))


@jax.jit
def bounce_image(moves: Moves, shift: Int[Array, ""] | int) -> SimpleMap:
    """Compute the bounce map from the moves.

    The function works under `jit`, and under `vmap` over both arguments.

    **Arguments:** the moves, and the number of directions by which the robot turns at a bump.
    **Returns:** a map over all cells.

    A corridor of three squares; cells 0, 1, 2 look East and 3, 4, 5 West:

        >>> from jaxcell import bounce, examples
        >>> cells = examples.corridor()
        >>> bounce.bounce_image(bounce.moves(cells), 1).image.tolist()
        [1, 2, 5, 0, 3, 4]
    """
    image, bumped = _images(moves.target, moves.way, shift)
    return SimpleMap(image.ravel(), bumped.ravel())


def _images(target: _Ints, way: _Ints, shift: _Ints | int) -> tuple[Any, Any]:
    """Compute the images and bumps of [`bounce_image`][], a row per direction, in NumPy or JAX."""
    xp = target.__array_namespace__()
    directions, positions = way.shape[0], target.shape[1]
    direction = xp.arange(directions, dtype=xp.int32)
    turned = (direction + shift) % directions
    bumped = target == xp.arange(positions, dtype=xp.int32)[None]
    # A bump adds the same number to all cells, unless they turn past the last direction.
    bump = bumped.astype(xp.int32)
    turns = xp.stack([target + bump * (by * positions) for by in (shift, shift - directions)])
    image = turns[(turned < direction).astype(xp.int32), way]
    image += (direction * positions)[:, None]
    return image, bumped[way]


def check_cell(cell: int, size: int, name: str = "start") -> int:
    """Return `cell`, or raise `ValueError` about the argument `name` if there is no such cell."""
    if not 0 <= cell < size:
        raise ValueError(f"{name}: cell {cell} does not exist; cells are 0 to {size - 1}")
    return int(cell)


def cell_of(cells: CellSpace, place: Place, name: str = "start") -> int:
    """Return the number of a cell, or raise `ValueError` about the argument `name`."""
    expected = "a cell, or a pose x, y, heading in metres and radians"
    numbers = np.asarray(as_array(place, name, f"; expected {expected}"))
    if numbers.ndim == 0 and float(numbers).is_integer():
        return check_cell(int(numbers), cells.size, name)
    if numbers.shape not in ((2,), (3,)):
        raise ValueError(f"{name}: expected {expected}, got {place!r}")
    direction = bounce_shift(numbers[2:].sum(), cells.directions, f"{name}: heading").item()
    with about(name):
        position = int(cells.index(numbers[0], numbers[1]))
    return direction * cells.positions + position


def robots_over_time(path: str, dims: str) -> tuple[Any, Any, Any, Any]:
    """Define four properties of a class of results: the time, and x, y and heading of its robots.

    `path` is the attribute of a result that contains the cells of the robots over time, and `dims`
    are its dimensions, such as `"time robot"`.
    """
    visited, centre = operator.attrgetter(path), _centres(path)
    heading = derived(dims, "heading of the robot", "rad", sense="counter-clockwise")
    return (
        derived("time", "mappings since the start", "mappings", kind="coordinate")(
            lambda result: np.arange(len(visited(result)), dtype=np.int32)
        ),
        derived(dims, "x of the robot", "m")(lambda result: centre(result)[0]),
        derived(dims, "y of the robot", "m")(lambda result: centre(result)[1]),
        heading(lambda result: centre(result)[2]),
    )


def candidate_poses(path: str) -> tuple[Any, Any, Any]:
    """Define three properties of a class of results: x, y and heading of the possible cells.

    `path` is the attribute of a result that contains these cells.
    """
    centre = _centres(path)
    return (
        derived("candidate", "x", "m")(lambda result: centre(result)[0]),
        derived("candidate", "y", "m")(lambda result: centre(result)[1]),
        derived("candidate", "heading", "degree")(lambda result: np.rad2deg(centre(result)[2])),
    )


def _centres(path: str) -> Callable[[Any], tuple[Any, Any, Any]]:
    cells = operator.attrgetter(path)
    return lambda result: result.cells.centre(cells(result))


def motion_violations(
    cells: CellSpace,
    path: Int[np.ndarray, "times robots"],
    bumped: Bool[np.ndarray, "times-1 robots"],
    turn: Int[np.ndarray, "times-1"] | None = None,
) -> Bool[np.ndarray, "times-1 robots"]:
    """Find the moves that break the rules: a bump turns a robot in place, and a step is straight.

    `path` contains the cells of the robots at each time, and `turn` the number of directions by
    which they turn at a bump, or `None` if it is unknown.
    """
    direction, position = np.divmod(path, cells.positions)
    stays = position[1:] == position[:-1]
    by = (direction[1:] - direction[:-1]) % cells.directions
    right = stays if turn is None else stays & (by == turn[:, None] % cells.directions)
    return ~np.where(bumped, right, ~stays & (by == 0))
