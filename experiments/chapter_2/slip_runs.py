"""Run emulated robots that slip, for the experiments with estimators."""

import contextlib

import numpy as np

from jaxcell.robot import Walker, cell_strides
from jaxcell.robot.create.driver import RobotStopped
from jaxcell.robot.emulation.body import Body
from jaxcell.robot.emulation.direct import DirectBody
from jaxcell.robot.emulation.simulated import SimulatedCreate
from jaxcell.space import CellSpace


Run = list[tuple[int, tuple[float, float, float]]]
"The observations of a run, each with the pose `(x, y, heading)` after it."


def robot(
    cells: CellSpace, noise: float, seed: int, *, driver: bool = False
) -> tuple[Walker, Body]:
    """Place a robot at the centre of a random cell, and return its walker and its body.

    The walker assumes that the robot has the direction of the cell.
    """
    rng = np.random.default_rng([17, seed])
    start = int(rng.integers(cells.size))
    body = Body.in_cell(cells, start, noise, rng)
    strides = cell_strides(cells.directions, cells.cell, cells.cell)
    driven = SimulatedCreate(body) if driver else DirectBody(body)
    direction = start // cells.positions
    return Walker(driven, cells.cell, strides=strides, direction=direction), body


def run(
    cells: CellSpace, bounce: float, noise: float, seed: int, *, limit: int, driver: bool
) -> Run:
    """Make `limit` observations from a random cell; fewer if the driver stops the robot."""
    walker, body = robot(cells, noise, seed, driver=driver)
    steps: Run = []
    with contextlib.suppress(RobotStopped):
        for _ in range(limit):
            bumped = walker.step()
            if bumped:
                walker.rotate(bounce)
            steps.append((int(bumped), body.pose))
    return steps
