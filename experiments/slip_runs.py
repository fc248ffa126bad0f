"""Runs of emulated robots that slip, for the experiments with estimators."""

import math
from collections.abc import Iterator

import numpy as np

from jaxcell.robot import Walker, cell_strides
from jaxcell.robot.create.driver import RobotStopped
from jaxcell.robot.create.motion import Moved
from jaxcell.robot.create.packets import WHEEL_BASE
from jaxcell.robot.emulation.body import Body, Noise, bumper_give
from jaxcell.robot.emulation.simulated import SimulatedCreate
from jaxcell.space import CellSpace


# Metres and radians between two looks at the bumper.
_TICK, _TURN = 0.05, math.radians(15)


class DirectBody:
    """The body of an emulated robot, driven without commands, frames, speeds or rounding."""

    def __init__(self, body: Body) -> None:
        self.body = body

    def forward(self, distance: float, *, tolerance: float) -> Moved:
        ticks = max(1, math.ceil(abs(distance) / _TICK))
        before = self.body.travelled.copy()
        bumped = False
        for _ in range(ticks):
            self.body.advance(distance / ticks, distance / ticks, 1.0)
            if distance > 0 and (self.body.bump_left or self.body.bump_right):
                bumped = True
                break
        return Moved(float((self.body.travelled - before).mean()), 0.0, bumped)

    def turn(self, angle: float, *, tolerance: float) -> Moved:
        ticks = max(1, math.ceil(abs(angle) / _TURN))
        wheel = angle / ticks * WHEEL_BASE / 2
        for _ in range(ticks):
            self.body.advance(-wheel, wheel, 1.0)
        # So that the next stretch is a new one.
        self.body.advance(0.0, 0.0, 1.0)
        return Moved(0.0, angle, False)


Run = list[tuple[int, tuple[float, float, float]]]
"Each observation of a run, with the pose after it."


def run(
    cells: CellSpace, bounce: float, noise: float, seed: int, *, limit: int, driver: bool
) -> Run:
    """A run from a random cell, shorter if the driver stops the robot."""
    assert cells.workspace is not None
    rng = np.random.default_rng([17, seed])
    start = int(rng.integers(cells.size))
    x, y, theta = cells.centre(start)
    body = Body(
        cells.workspace,
        (float(x), float(y), float(theta)),
        give=bumper_give(cells.cell),
        noise=Noise(distance=noise, rotation=noise, veer=noise),
        rng=rng,
    )
    strides = cell_strides(cells.directions, cells.cell, cells.cell)
    robot = SimulatedCreate(body) if driver else DirectBody(body)
    walker = Walker(robot, cells.cell, strides=strides, direction=start // cells.positions)
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
