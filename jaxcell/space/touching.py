"""The steps of a robot that touch a wall, without being blocked.

In the model a robot may touch a corner or drive along a wall, but a real robot leaves its path by
millimetres, and may bump there.
"""

import numpy as np
import shapely
from jaxtyping import Bool

from .cells import CellSpace, free_space_in_cells
from .motion import CELL_BY_CELL, Motion
from .occupancy import TOLERANCE
from .segments import displacement
from .steps import Steps


MOST_STEPS = 1_000_000
"The largest number of steps that are tested."


def touching_steps(
    cells: CellSpace, motion: Motion = CELL_BY_CELL
) -> Bool[np.ndarray, "directions positions"]:
    """Compute a mask of the steps from the centres of cells that touch a wall, but are not blocked.

    The mask is empty for more than `MOST_STEPS` cells.
    """
    touches = np.zeros((cells.directions, cells.positions), bool)
    if touches.size > MOST_STEPS:
        return touches
    steps = Steps.of(cells, motion)
    walls = free_space_in_cells(cells).boundary
    shapely.prepare(walls)
    row, column = np.divmod(cells.square, cells.position_of_square.shape[1])
    centres = np.stack([column, row], axis=1) + 0.5
    moved = (steps.targets(cells) != np.arange(cells.positions))[steps.way]
    length = motion.in_cells(cells.cell)
    for direction, touch in enumerate(touches):
        begin = centres[moved[direction]]
        step = displacement(direction, cells.directions, length)
        parts = motion.rule.part(np.stack([begin, begin + step], axis=1))
        touch[moved[direction]] = shapely.dwithin(parts, walls, TOLERANCE)
    return touches
