import math

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..base.precision import require_x64
from ..base.wide import traced
from ..mapping import Chain
from ..space import CELL_BY_CELL, CellSpace, Motion
from .dynamics import Moves, bounce_shift, moves as moves_of


# By how much the sum of the probabilities of turns may differ from 1.
_ROUNDING = 1e-12


def noisy_bounce_map(
    cells: CellSpace,
    bounce: float | Array,
    error: float,
    reliability: float | Array | Float[np.ndarray, "branches"],
    *,
    motion: Motion = CELL_BY_CELL,
) -> Chain:
    """Build the generalized map of a robot that turns imprecisely (Alam 2018, section 3.3.3).

    The robot moves as in [`jaxcell.bounce.bounce_map`][]. At a wall it turns by the bouncing angle
    with probability `reliability`. Otherwise it turns to another direction, at most `error` from
    the intended one; all such directions are equally probable (Alg. 3.3).

    **Arguments:** a cell space; the bouncing angle, counter-clockwise, and the largest error, both
    in radians, as multiples of the angle between two directions; a reliability above 0 and at most
    1, or the probability of each turn of [`jaxcell.bounce.noisy_turns`][], in its order; and a
    motion. The angle and the probabilities may be traced by `jit`, `vmap` and `grad`; in a program,
    those that are refused elsewhere make all probabilities NaN. **Returns:** the Markov chain of
    the cells.

    Cell 1 is at the East end of a corridor of two squares. Of ten turns there, eight are by 180
    degrees, one is to the North, and one to the South:

        >>> import math
        >>> import numpy as np
        >>> from jaxcell import bounce, space
        >>> cells = space.CellSpace.of_grid(np.ones((1, 2), bool), directions=4)
        >>> chain = bounce.noisy_bounce_map(cells, math.pi, error=math.pi / 2, reliability=0.8)
        >>> chain.to_scipy().toarray()[1].round(6).tolist()
        [0.0, 0.0, 0.0, 0.1, 0.0, 0.8, 0.0, 0.1]
    """
    require_x64("noisy_bounce_map")
    turns, probability = noisy_turns(bounce, error, reliability, cells.directions)
    return noisy_chain(moves_of(cells, motion=motion), turns, probability)


def noisy_turns(
    bounce: float | Array,
    error: float,
    reliability: float | Array | Float[np.ndarray, "branches"],
    directions: int,
) -> tuple[Int[Array | np.ndarray, "branches"], Float[Array | np.ndarray, "branches"]]:
    """List the possible turns at a wall as numbers of directions; the first turn has no error.

    **Arguments:** as for [`noisy_bounce_map`][]. **Returns:** the turns and their probabilities.

    Of ten turns, eight are by 90 degrees, one is by 45 degrees more, and one by 45 degrees less:

        >>> import math
        >>> from jaxcell import bounce
        >>> turns, chance = bounce.noisy_turns(math.pi / 2, math.pi / 4, 0.8, directions=8)
        >>> turns.tolist(), chance.round(6).tolist()
        ([2, 3, 1], [0.8, 0.1, 0.1])
    """
    shift, _ = bounce_shift(bounce, directions), bounce_shift(error, directions, "error")
    bins, most = round(error * directions / (2 * math.pi)), (directions - 1) // 2
    if not 0 <= bins <= most:
        raise ValueError(
            f"error: expected 0 to {360 / directions * most:g} deg, so that all turns differ, got "
            f"{math.degrees(error):g} deg"
        )
    errors = np.array([0, *(sign * k for k in range(1, bins + 1) for sign in (1, -1))], np.int32)
    xp = jnp if traced(reliability) else np
    chance = xp.asarray(reliability, float)
    if chance.shape not in ((), errors.shape):
        raise ValueError(
            f"reliability: expected a number, or one for each of {errors.size} turns, got shape "
            f"{list(chance.shape)}"
        )
    if chance.ndim:
        probability = chance
    else:
        share = (1 - chance) / max(1, 2 * bins)
        probability = xp.where(errors == 0, chance, share)
    if xp is np:
        _check_probabilities(probability, bins)
    else:
        right = (probability.min() >= 0) & (abs(probability.sum() - 1) < _ROUNDING)
        right &= probability[0] > 0
        probability = jnp.where(right, probability, jnp.nan)
    if traced(bounce):
        probability = jnp.where(jnp.isfinite(bounce), probability, jnp.nan)
    return (shift + errors) % directions, probability


def _check_probabilities(probability: Float[np.ndarray, "branches"], bins: int) -> None:
    reliability = probability[0]
    if not 0 < reliability <= 1:
        raise ValueError(f"reliability: expected more than 0 and at most 1, got {reliability:g}")
    if bins == 0 and reliability < 1:
        raise ValueError(
            f"reliability: {reliability:g} leaves a chance of an error, but the error is 0 deg; "
            "expected 1, or a larger error"
        )
    if not (probability.min() >= 0 and abs(probability.sum() - 1) < _ROUNDING):
        raise ValueError(
            f"reliability: expected probabilities that sum to 1, got {probability.tolist()}"
        )


@jax.jit
def noisy_chain(
    moves: Moves,
    turns: Int[Array | np.ndarray, "branches"],
    probability: Float[Array | np.ndarray, "branches"],
) -> Chain:
    """Build the chain of a robot that turns randomly at a wall; the first turn has no error."""
    directions, positions = moves.way.shape[0], moves.target.shape[1]
    direction = jnp.arange(directions, dtype=jnp.int32)[:, None]
    position = jnp.arange(positions, dtype=jnp.int32)[None]
    target = moves.target[moves.way]
    bumped = target == position

    def slot(turn, share, first):  # type: ignore[no-untyped-def]
        turned = (direction + turn) % directions * positions + position
        # If the robot does not bump, only the first branch is used; the others stay on the cell.
        ahead = direction * positions + jnp.where(first, target, position)
        image = jnp.where(bumped, turned, ahead)
        return image.ravel(), jnp.where(bumped, share, first.astype(share.dtype)).ravel()

    first = jnp.arange(turns.shape[0]) == 0
    return Chain(*jax.vmap(slot)(turns, probability, first))
