import math
from typing import Any

import numpy as np
from jaxtyping import Float

from ..base.wide import namespace


# A target at a larger angle lies behind the robot, which reaches it in reverse.
BEHIND = math.radians(170.0)


def cell_strides(
    directions: int, cell: float | Any, step: float | Any
) -> Float[Any, "directions 2"]:
    """Compute the displacement from the centre of a cell to that of the cell where a step ends.

    **Arguments:** the number of directions, and the side of a cell and the length of a step in
    metres. **Returns:** for each direction, the distance in metres ahead and to the left. It works
    under `jit` and `vmap`.

    To the East, and to the North East, where the step ends short of the centre of a cell:

        >>> from jaxcell import space
        >>> space.cell_strides(8, 1.0, 1.0)[:2].round(3).tolist()
        [[1.0, 0.0], [1.414, 0.0]]
    """
    xp = namespace(cell, step)
    angle = 2 * np.pi * np.arange(directions) / directions
    heading = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    # As in the cell space, ties go to the upper and right cell on every platform.
    hop = xp.floor(xp.round(xp.round(step / cell * heading, 9) + 0.5, 9)) * cell
    left = np.stack([-heading[:, 1], heading[:, 0]], axis=1)
    return xp.stack([(hop * heading).sum(axis=1), (hop * left).sum(axis=1)], axis=1)


def stride_legs(directions: int, cell: float, step: float) -> Float[np.ndarray, "directions 3"]:
    """Compute the straight stretches of a step that ends at the centre of a cell.

    **Arguments:** as for [`cell_strides`][]. **Returns:** for each direction the length of the
    first stretch in metres, the angle of the turn after it in radians, and the length of the second
    stretch, negative in reverse. Without a second stretch its length and the angle are 0.

    To the East one stretch is enough; 15 degrees to the left a second stretch leads to the centre:

        >>> from jaxcell import space
        >>> space.stride_legs(24, 1.0, 1.0)[:2].round(3).tolist()
        [[1.0, 0.0, 0.0], [1.0, -1.702, 0.261]]
    """
    strides = cell_strides(directions, cell, step)
    legs = np.zeros((directions, 3))
    for leg, (forward, left) in zip(legs, strides.tolist(), strict=True):
        if abs(left) < 1e-9 and forward >= step - 1e-9:
            leg[0] = forward
            continue
        rest, turn = math.hypot(forward - step, left), math.atan2(left, forward - step)
        if abs(turn) > BEHIND:
            rest, turn = -rest, math.remainder(turn + math.pi, 2 * math.pi)
        leg[:] = step, turn, rest
    return legs
