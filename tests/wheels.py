"""Robots in maps, and the filters of maps, for the tests of `jaxcell.robot`."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from jaxcell.automata import Filter, subset_construction
from jaxcell.robot.emulation.body import Body, bumper_give
from jaxcell.robot.emulation.simulated import SimulatedCreate
from jaxcell.robot.walker import Drivable, Walker, cell_strides
from jaxcell.space import CellSpace, Workspace, free_steps


MAPS = Path(__file__).parents[1] / "data" / "maps"


def map_cells(name: str, **sizes: float) -> CellSpace:
    workspace = Workspace.load(MAPS / name)
    cell, directions = sizes.get("cell", workspace.cell), sizes.get("directions")
    return CellSpace.of(workspace, cell, int(directions or workspace.directions))


def bounce_tables(cells: CellSpace, bounce_deg: float) -> tuple[np.ndarray, np.ndarray]:
    """The image of every cell, and whether the robot bumps there (Alam 2018, Eq. 2.4)."""
    target = free_steps(cells)
    here = np.arange(cells.positions)
    direction = np.arange(cells.directions)[:, None]
    turned = (direction + round(bounce_deg * cells.directions / 360)) % cells.directions
    bumped = target == here
    image = np.where(bumped, turned, direction) * cells.positions + target
    return image.ravel().astype(np.int32), bumped.ravel()


def orbit(cells: CellSpace, bounce_deg: float, cell: int, steps: int) -> tuple[str, list[int]]:
    """The observations of some steps from a cell, and the cells after them."""
    image, bumped = bounce_tables(cells, bounce_deg)
    visited = [cell]
    for _ in range(steps):
        visited.append(int(image[visited[-1]]))
    return "".join(str(int(bumped[z])) for z in visited[:-1]), visited[1:]


def bounce_filter(cells: CellSpace, bounce_deg: float, **fields) -> Filter:
    return Filter.of(subset_construction(*bounce_tables(cells, bounce_deg)), **fields)


def pose_of(cells: CellSpace, cell: int) -> tuple[float, float, float]:
    x, y, theta = cells.centre(cell)
    return float(x), float(y), float(theta)


def body_in(cells: CellSpace, cell: int, **fields) -> Body:
    """A body as `jaxcell robot run --simulate` makes it, unless said otherwise."""
    return Body(cells.workspace, pose_of(cells, cell), **{"give": bumper_give(cells.cell)} | fields)


def walker_in(
    cells: CellSpace, cell: int, *, robot: Callable[[Body], Drivable] = SimulatedCreate, **fields
) -> tuple[Walker, Body]:
    """A walker with the driver and the emulated robot, or another, and the body that this moves."""
    body = body_in(cells, cell, **fields)
    strides = cell_strides(cells.directions, cells.cell, cells.cell)
    direction = cell // cells.positions
    return Walker(robot(body), cells.cell, strides=strides, direction=direction), body


def place_of(cells: CellSpace, body: Body) -> int | None:
    """The cell where a body is, if any."""
    try:
        return int(cells.index(*body.pose))
    except ValueError:
        return None
