"""Runs of emulated robots that slip, for the experiments with estimators."""

from collections.abc import Iterator

import numpy as np

from jaxcell.robot import Walker, cell_strides
from jaxcell.robot.create.driver import RobotStopped
from jaxcell.robot.emulation.body import Body
from jaxcell.robot.emulation.direct import DirectBody
from jaxcell.robot.emulation.simulated import SimulatedCreate
from jaxcell.space import CellSpace


Run = list[tuple[int, tuple[float, float, float]]]
"Each observation of a run, with the pose after it."


def robot(
    cells: CellSpace, noise: float, seed: int, *, driver: bool = False
) -> tuple[Walker, Body]:
    """A robot at the centre of a random cell, in whose direction it takes itself to look."""
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
    """A run from a random cell, shorter if the driver stops the robot."""
    walker, body = robot(cells, noise, seed, driver=driver)
    return list(_steps(walker, body, bounce, limit))


def _steps(
    walker: Walker, body: Body, bounce: float, limit: int
) -> Iterator[tuple[int, tuple[float, float, float]]]:
    for _ in range(limit):
        try:
            bumped = walker.step()
            if bumped:
                walker.rotate(bounce)
        except RobotStopped:
            return
        yield int(bumped), body.pose
