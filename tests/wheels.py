"""A robot without a serial line, and the filters of maps, for the tests of `jaxcell.robot`."""

import math
from pathlib import Path

import numpy as np

from jaxcell.automata import Filter, subset_construction
from jaxcell.robot.body import Body
from jaxcell.robot.create import Moved
from jaxcell.robot.driver import RobotStopped
from jaxcell.robot.packets import WHEEL_BASE
from jaxcell.space import CellSpace, Workspace, free_steps


MAPS = Path(__file__).parents[1] / "data" / "maps"


def map_cells(name: str, **sizes: float) -> CellSpace:
    workspace = Workspace.load(MAPS / name)
    cell, directions = sizes.get("cell", workspace.cell), sizes.get("directions")
    return CellSpace.of(workspace, cell, int(directions or workspace.directions))


def bounce_tables(cells: CellSpace, bounce_deg: float) -> tuple[np.ndarray, np.ndarray]:
    """The image of every cell, and whether the robot bumps there (Alam 2018, Eq. 2.4)."""
    target = free_steps(cells, 1.0, "swept")
    here = np.arange(cells.positions)
    direction = np.arange(cells.directions)[:, None]
    turned = (direction + round(bounce_deg * cells.directions / 360)) % cells.directions
    bumped = target == here
    image = np.where(bumped, turned, direction) * cells.positions + target
    return image.ravel().astype(np.int32), bumped.ravel()


def bounce_filter(cells: CellSpace, bounce_deg: float, **fields) -> Filter:
    return Filter.of(subset_construction(*bounce_tables(cells, bounce_deg)), **fields)


class Wheels:
    """Drives a body itself, tick by tick, as `Create` does through the line."""

    def __init__(self, body: Body, seconds: float = 0.02) -> None:
        self.body, self._seconds = body, seconds

    def forward(self, distance: float, *, tolerance: float) -> Moved:
        start = self._sensed()
        while abs(rest := distance - (self._sensed()[0] - start[0])) > tolerance / 2:
            speed = math.copysign(min(1.0, max(0.002, 20 * abs(rest))), rest)
            before = self._sensed()
            self.body.advance(speed, speed, self._seconds)
            if distance < 0 and self._sensed() == before:
                raise RobotStopped("it has backed into a wall")
            if distance > 0 and (self.body.bump_left or self.body.bump_right):
                return self._moved(start, True)
        return self._moved(start, False)

    def turn(self, angle: float, *, tolerance: float) -> Moved:
        start = self._sensed()
        while abs(rest := angle - (self._sensed()[1] - start[1])) > tolerance / 2:
            speed = math.copysign(min(0.5, max(0.002, 3 * abs(rest))), rest)
            self.body.advance(-speed, speed, self._seconds)
        return self._moved(start, False)

    def _sensed(self) -> tuple[float, float]:
        left, right = self.body.travelled
        return (left + right) / 2, (right - left) / WHEEL_BASE

    def _moved(self, start: tuple[float, float], bumped: bool) -> Moved:
        distance, angle = self._sensed()
        return Moved(distance - start[0], angle - start[1], bumped)
