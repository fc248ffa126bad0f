import math
from collections.abc import Callable, Sequence
from typing import Any, Literal, TypeAlias

import jax
import numpy as np
import numpy.typing as npt
from jaxtyping import Float

from ..base.precision import require_x64
from ..mapping import persistent_groups
from ..markov import limiting_distribution
from ..optimize import mixture
from ..space import CELL_BY_CELL, CellSpace, Motion, estimates
from ..space.extent import Extent
from .covered import CoveragePolicy
from .dynamics import moves as moves_of
from .imprecise import noisy_chain, noisy_turns


Target: TypeAlias = npt.ArrayLike | Callable[[Any, Any], Any] | None


def coverage_policy(
    cells: CellSpace,
    bounces: Sequence[float] | Float[np.ndarray, "angles"],
    error: float,
    reliability: float,
    target: Target = None,
    *,
    weights: Literal["basin", "size"] = "basin",
    motion: Motion = CELL_BY_CELL,
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
    - `motion`: how the robot moves.
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
        lambda e: estimates.coverage(e, motion, angles=len(turns), branches=len(turns[0][0])),
        "coverage",
        motion.step,
    )
    possible = moves_of(cells, motion=motion)
    groups, limiting, coverage = [], [], []
    for turn, probability in turns:
        chain = noisy_chain(possible, turn, probability)
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
        coverage=jax.device_put(np.stack(coverage)),
        mixture=found.value,
        target=jax.device_put(wanted),
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
        >>> from jaxcell import bounce, examples
        >>> cells = examples.corridor()
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
