from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from ...space import CellSpace, Slip, felt_walls, slipping_step, stride_legs
from ...space.slip import ERRORS
from ..dynamics import Place, bounce_shift, cell_of


def plan_runs(
    cells: CellSpace,
    start: Place,
    actions: Sequence[float],
    slip: Slip,
    *,
    runs: int,
    step: float | None = None,
    seed: int = 0,
) -> Float[np.ndarray, "successful 3"]:
    """Simulate runs of a robot that slips and follows a plan, in continuous space.

    **Arguments:** a cell space; the cell or the pose of the start; actions, 0 for a step forward or
    the angle to turn by at a bump, in radians; the slip; the number of runs; the length of a step
    in metres, by default one cell; and a seed.

    **Returns:** the final poses (x and y in metres, the heading in radians) of the robots that
    bumped exactly at the bumps of the plan.

    A robot without errors goes to the end of a corridor and turns there:

        >>> import math
        >>> from jaxcell import bounce, examples, space
        >>> corridor = examples.corridor(directions=4)
        >>> bounce.plan_runs(
        ...     corridor, 1, [0.0, math.pi / 2], space.Slip(), runs=1
        ... ).round(2).tolist()
        [[2.5, 0.5, 1.57]]
    """
    draw = np.random.default_rng(seed)
    legs = stride_legs(cells.directions, cells.cell, cells.cell if step is None else step)
    walls = felt_walls(cells.room, slip.give)
    cell = cell_of(cells, start)
    pose = np.tile(np.stack(cells.centre(np.asarray(cell)), axis=-1), (runs, 1))
    direction = cell // cells.positions
    for action in actions:
        errors = draw.standard_normal((len(pose), ERRORS))
        leg = np.broadcast_to(legs[direction], pose.shape)
        pose, bumped = slipping_step(pose, leg, float(action), errors, walls, slip)
        pose = pose[bumped == (action != 0)]
        if action:
            direction = (direction + int(bounce_shift(action, cells.directions))) % cells.directions
    return pose
