import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Int

from ..space import CellSpace
from .dynamics import Moves


# Larger offsets are clipped, because their squares overflow 32 bits; such robots never meet.
_FAR = 2**14


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class JointImage:
    """The result of one step of several robots."""

    image: Int[Array | np.ndarray, "*batch robots"]
    "The cell of each robot after the step."
    bumped: Bool[Array | np.ndarray, "*batch robots"]
    "A mask of the robots that stayed and turned."
    collided: Bool[Array | np.ndarray, "*batch robots"]
    "A mask of the robots that collided with another robot."
    collisions: Int[Array | np.ndarray, "*batch"]
    "Number of pairs of robots that collided."


def squares_of(cells: CellSpace) -> Int[np.ndarray, "2 positions"]:
    """Find the column and the row of each position."""
    row, column = np.divmod(cells.square, cells.free.shape[1])
    return np.stack([column, row])


@jax.jit
def joint_image(
    moves: Moves,
    squares: Int[Array, "2 positions"],
    shift: Int[Array, "robots"],
    state: Int[Array, "robots"],
) -> JointImage:
    """Compute one step of several robots at once: the joint bounce map (Alam 2018, Eq. 3.9).

    All robots set out together, straight and at the same pace, from the centre of their cell to the
    centre of the next. A robot bumps if

    - a wall blocks its step, as in [`jaxcell.bounce.bounce_map`][];
    - it would meet another robot: both steps end in the same cell, the robots change places, their
        diagonals cross, or, if steps are several cells long, they meet on the way;
    - its step leads to or through the position of a robot that bumps. In a queue, each robot that
        bumps blocks the robot behind it.

    A robot that bumps stays in its position, and turns by its bouncing angle once, even if it meets
    several robots and walls. So two robots are never in one position, and the order of the robots
    makes no difference. Two robots *collide* if they would meet, or if a robot that bumps blocks
    the step of the other robot. Robots are points: discs wider than a cell are not kept apart.

    The function works under `jit`, and under `vmap` over any of the arguments.

    **Arguments:** the moves; the columns and rows of [`squares_of`][]; the turn of each robot as a
    number of directions; and the cells of the robots, no two in one position.
    """
    directions, positions = moves.way.shape[0], moves.target.shape[1]
    direction, position = state // positions, state % positions
    target = moves.target[moves.way[direction], position]

    here = squares[:, position]
    motion = squares[:, target] - here
    offset = jnp.clip(here[:, None] - here[:, :, None], -_FAR, _FAR)
    # Seen from one robot, another comes along the straight line of their relative motion.
    meet = _vanishes(offset, motion[:, None] - motion[:, :, None])
    on_way = _vanishes(offset, -motion[:, :, None])

    def queue(_, bumped):  # type: ignore[no-untyped-def]
        return bumped | (on_way & bumped[None]).any(axis=1)

    bumped = (target == position) | meet.any(axis=1)
    bumped = jax.lax.fori_loop(0, state.shape[0] - 1, queue, bumped)
    into_bumped = on_way & bumped[None]
    collide = meet | into_bumped | into_bumped.T
    turned = (direction + shift) % directions
    return JointImage(
        image=jnp.where(bumped, turned * positions + position, direction * positions + target),
        bumped=bumped,
        collided=collide.any(axis=1),
        collisions=jnp.sum(collide, dtype=jnp.int32) // 2,
    )


def _vanishes(
    offset: Int[Array, "2 robots robots"], change: Int[Array, "2 robots #robots"]
) -> Bool[Array, "robots robots"]:
    """Test whether a vector `offset + t * change` is 0 for a `t` in (0, 1], but not at `t = 0`."""
    (x, y), (dx, dy) = offset, change
    square, along, across = x * x + y * y, x * dx + y * dy, x * dy - y * dx
    return (square > 0) & (across == 0) & (square + along <= 0)


@functools.partial(jax.jit, static_argnames="steps")
def joint_orbits(
    moves: Moves,
    squares: Int[Array, "2 positions"],
    shift: Int[Array, "robots"],
    states: Int[Array, "lanes robots"],
    *,
    steps: int,
) -> JointImage:
    """Follow the orbits of joint states, rows of `states`; the result has axes `steps, lanes`."""
    images = jax.vmap(functools.partial(joint_image, moves, squares, shift))

    def step(states, _):  # type: ignore[no-untyped-def]
        joint = images(states)
        return joint.image, joint

    return jax.lax.scan(step, states, length=steps)[1]
