import math
from collections.abc import Callable, Sequence
from typing import Any, Literal, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jaxtyping import Array, Float, Int

from ..base.precision import require_x64
from ..mapping import Chain, persistent_groups
from ..markov import limiting_distribution
from ..optimize import mixture
from ..space import CellSpace, estimates
from ..space.extent import Extent
from .covered import CoveragePolicy
from .dynamics import Collision, Moves, bounce_shift, moves as moves_of


Target: TypeAlias = npt.ArrayLike | Callable[[Any, Any], Any] | None


def noisy_bounce_map(
    cells: CellSpace,
    bounce: float,
    error: float,
    reliability: float,
    *,
    step: float | None = None,
    collision: Collision = "swept",
) -> Chain:
    """The generalized map of a robot that turns imprecisely at a wall (Alam 2018, section 3.3.3).

    It moves as in [`jaxcell.bounce.bounce_map`][]. At a wall it turns by the bouncing angle with
    probability `reliability`; else by another angle that differs from it by at most `error`, all
    whole directions with equal probability (Alg. 3.3).

    **Arguments:**

    - `cells`: the cell space.
    - `bounce`: bouncing angle in radians, counter-clockwise.
    - `error`: the largest error in radians, a whole number of directions.
    - `reliability`: the probability of a turn without error, above 0 and at most 1.
    - `step`, `collision`: as for [`jaxcell.bounce.bounce_map`][].

    **Returns:** [`jaxcell.mapping.Chain`][], which nothing leaves.

    **Raises:** `ValueError` for angles that are not whole numbers of directions, an error so large
    that it reaches one direction twice, a reliability out of range, or one below 1 where the error
    is 0; else as [`jaxcell.bounce.bounce_map`][]. `RuntimeError` where JAX is set to 32 bits.

    The image of cell 1, at the East end of a corridor of two squares. Of ten turns, eight are right
    about, and one each to the North and the South:

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
    return _chain(moves_of(cells, step=step, collision=collision), turns, probability)


def noisy_turns(
    bounce: float, error: float, reliability: float, directions: int
) -> tuple[Int[np.ndarray, "branches"], Float[np.ndarray, "branches"]]:
    """The turns at a wall, in directions, the one without error first, and their probabilities.

    **Arguments:**

    - `bounce`, `error`, `reliability`: as for [`noisy_bounce_map`][].
    - `directions`: number of directions in a full turn.

    **Returns:** the turns, and the probability of each.

    **Raises:** as [`noisy_bounce_map`][].

    Mostly to the left, one in ten times a direction farther, and one in ten times one less:

        >>> import math
        >>> from jaxcell import bounce
        >>> turns, chance = bounce.noisy_turns(math.pi / 2, math.pi / 4, 0.8, directions=8)
        >>> turns.tolist(), chance.round(6).tolist()
        ([2, 3, 1], [0.8, 0.1, 0.1])
    """
    shift = int(bounce_shift(bounce, directions))
    spacing = 360 / directions
    bins = error * directions / (2 * math.pi)
    if not (math.isfinite(bins) and bins >= 0 and abs(bins - round(bins)) < 1e-6):
        raise ValueError(
            f"error: {math.degrees(error):g} deg is not a whole number of the {directions} "
            f"directions, which are {spacing:g} deg apart"
        )
    bins = round(bins)
    if 2 * bins + 1 > directions:
        raise ValueError(
            f"error: +-{math.degrees(error):g} deg are {2 * bins + 1} turns, more than the "
            f"{directions} directions; expected at most {spacing * ((directions - 1) // 2):g} deg"
        )
    if not 0 < reliability <= 1:
        raise ValueError(f"reliability: expected more than 0 and at most 1, got {reliability:g}")
    if bins == 0 and reliability < 1:
        raise ValueError(
            f"reliability: {reliability:g} leaves a chance of an error, but the error is 0 deg; "
            "expected 1, or a larger error"
        )
    errors = [0, *(sign * k for k in range(1, bins + 1) for sign in (1, -1))]
    share = (1 - reliability) / max(1, 2 * bins)
    return (
        np.array([(shift + e) % directions for e in errors], np.int32),
        np.array([reliability, *[share] * (2 * bins)]),
    )


def _chain(
    moves: Moves, turns: Int[np.ndarray, "branches"], probability: Float[np.ndarray, "branches"]
) -> Chain:
    return Chain(*_slots(moves, jnp.asarray(turns), jnp.asarray(probability)))


@jax.jit
def _slots(
    moves: Moves, turns: Int[Array, "branches"], probability: Float[Array, "branches"]
) -> tuple[Int[Array, "branches cells"], Float[Array, "branches cells"]]:
    directions, positions = moves.way.shape[0], moves.free.shape[0]
    direction = jnp.arange(directions, dtype=jnp.int32)[:, None]
    position = jnp.arange(positions, dtype=jnp.int32)[None]
    target = moves.target[moves.way]
    bumped = target == position

    def slot(turn, share, first):  # type: ignore[no-untyped-def]
        turned = (direction + turn) % directions * positions + position
        # On a run only the first slot is used; the others stay on the cell itself.
        ahead = direction * positions + jnp.where(first, target, position)
        image = jnp.where(bumped, turned, ahead)
        return image.ravel(), jnp.where(bumped, share, first.astype(share.dtype)).ravel()

    first = jnp.arange(turns.shape[0]) == 0
    return jax.vmap(slot)(turns, probability, first)


def coverage_policy(
    cells: CellSpace,
    bounces: Sequence[float] | Float[np.ndarray, "angles"],
    error: float,
    reliability: float,
    target: Target = None,
    *,
    weights: Literal["basin", "size"] = "basin",
    step: float | None = None,
    collision: Collision = "swept",
    progress: Callable[[int], None] | None = None,
) -> CoveragePolicy:
    """The mixture of bouncing policies whose coverage is nearest to a target (Alam 2018, Alg. 3.3).

    For each angle: the noisy map, its persistent groups, its limiting distribution, and the
    coverage of the positions, summed over the directions. Then the least squares of Eq. 3.8.

    **Arguments:**

    - `cells`: the cell space.
    - `bounces`: bouncing angles in radians, counter-clockwise, no two the same.
    - `error`, `reliability`: as for [`noisy_bounce_map`][].
    - `target`: as for [`coverage_target`][].
    - `weights`: what the persistent groups of one angle weigh, as for
        [`jaxcell.markov.limiting_distribution`][].
    - `step`, `collision`: as for [`jaxcell.bounce.bounce_map`][].
    - `progress`: called with the number of angles that are done.

    **Returns:** [`CoveragePolicy`][].

    **Raises:** `ValueError` for no angles, two that are the same, a bad target, or as
    [`noisy_bounce_map`][]; `RuntimeError` if a solve stalls, or where JAX is set to 32 bits;
    `MemoryError` where the noisy maps would not fit the free memory.

    A room of two by two squares is covered evenly by any policy:

        >>> import math
        >>> import numpy as np
        >>> from jaxcell import bounce, space
        >>> cells = space.CellSpace.of_grid(np.ones((2, 2), bool), directions=4)
        >>> policy = bounce.coverage_policy(cells, [math.pi], error=math.pi / 2, reliability=0.8)
        >>> policy.mixture.round(6).tolist()
        [0.25, 0.25, 0.25, 0.25]
    """
    require_x64("coverage_policy")
    turns = [noisy_turns(float(b), error, reliability, cells.directions) for b in bounces]
    if not turns:
        raise ValueError("bounces: expected at least one angle, got none")
    shifts = [int(turn[0]) for turn, _ in turns]
    for i, shift in enumerate(shifts):
        if shift in shifts[:i]:
            raise ValueError(
                f"bounces: {math.degrees(bounces[i]):g} deg comes twice, as angles {i} and "
                f"{shifts.index(shift)}"
            )
    wanted = coverage_target(cells, target)
    estimates.check(
        Extent.of(cells),
        lambda e: estimates.coverage(
            e, step, collision, angles=len(turns), branches=len(turns[0][0])
        ),
        "coverage",
        step,
    )
    possible = moves_of(cells, step=step, collision=collision)
    groups, limiting, coverage = [], [], []
    for turn, probability in turns:
        chain = _chain(possible, turn, probability)
        groups.append(persistent_groups(chain))
        limiting.append(limiting_distribution(chain, groups[-1], weights))
        value = np.asarray(limiting[-1].value)
        coverage.append(value.reshape(cells.directions, cells.positions).sum(axis=0))
        if progress is not None:
            progress(len(coverage))
    found = mixture(np.stack(coverage, axis=1), wanted)
    return CoveragePolicy(
        cells=cells,
        bounce=np.asarray(bounces, float),
        alpha=found.weights,
        coverage=jnp.asarray(np.stack(coverage)),
        mixture=found.value,
        target=jnp.asarray(wanted),
        distance=found.distance,
        certificate=found.certificate,
        groups=tuple(groups),
        limiting=tuple(limiting),
    )


def coverage_target(cells: CellSpace, target: Target = None) -> Float[np.ndarray, "positions"]:
    """A target for coverage, as a distribution over the positions.

    **Arguments:**

    - `cells`: the cell space.
    - `target`: how much each position is worth, in any unit: `None` for all the same; a function
        of arrays `x, y` of centres in metres; an array over the positions; or an image `[rows,
        columns]`, its first row at the top, which is stretched over all squares of the map and read
        at the centres.

    **Returns:** the shares, which sum to 1.

    **Raises:** `ValueError` for a target of another shape, one that is negative or not finite
    at some position, or that is 0 at all of them.

    The last of three squares is worth twice as much as the others:

        >>> import numpy as np
        >>> from jaxcell import bounce, space
        >>> cells = space.CellSpace.of_grid(np.ones((1, 3), bool), directions=2)
        >>> bounce.coverage_target(cells, np.array([1, 1, 2])).tolist()
        [0.25, 0.25, 0.5]
    """
    x, y, _ = cells.centre(np.arange(cells.positions))
    worth: np.ndarray
    if target is None:
        worth = np.ones(cells.positions)
    elif callable(target):
        worth = np.asarray(target(x, y), float)
    else:
        worth = np.asarray(target, float)
    if worth.ndim == 2 and worth.size:
        rows, columns = worth.shape
        height, width = cells.free.shape
        right = (x - cells.origin[0]) / (width * cells.cell)
        up = (y - cells.origin[1]) / (height * cells.cell)
        # Rounded, so that a centre on an edge between pixels is in the same one on every platform.
        column, row = (np.floor(np.round(v, 9)).astype(int) for v in (right * columns, up * rows))
        worth = worth[rows - 1 - row, column]
    if worth.shape != (cells.positions,):
        raise ValueError(
            f"target: expected {cells.positions} numbers, one a position, or an image, got shape "
            f"{worth.shape}"
        )
    wrong = np.flatnonzero(~(np.isfinite(worth) & (worth >= 0)))
    if wrong.size:
        at = wrong[0]
        raise ValueError(
            f"target: {worth[at]:g} at position {at} ({x[at]:g} m, {y[at]:g} m); expected a finite "
            "number from 0"
        )
    if not worth.any():
        raise ValueError("target: it is 0 at all positions; expected some share for one of them")
    # First by the largest, so that the sum cannot overflow.
    worth = worth / worth.max()
    return worth / worth.sum()
