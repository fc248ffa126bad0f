import dataclasses
import functools
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from ...base.documents import Fields, about, refused
from ...space import CellSpace, free_steps
from ..routing import grid_steps, wave
from .task import Task, common_fields, robot_fields, write_task


@dataclasses.dataclass(frozen=True)
class PatrolTask(Task):
    """The task of a robot that patrols the cells of a map by a random walk."""

    kind = "patrol"
    robot: int
    "The index of this robot in the file."
    robots: int
    "The number of robots on patrol."
    cells: CellSpace
    "The squares of the map, with the four directions in which the robot drives."
    closed: tuple[tuple[int, int], ...]
    """The steps that a wall between two free squares blocks, as pairs of a position and a
    direction, from 0 for East to 3 for South."""
    image: Int[np.ndarray, "branches states"]
    """The possible next states of each state. A state is a position or, for a robot with memory,
    `m * positions + position`, where `m` is the number of its memory state."""
    probability: Float[np.ndarray, "branches states"]
    "The probability of each next state."
    start: int
    "The position at the start."
    reach: float
    "The largest distance at which the robot sees, in metres."

    @functools.cached_property
    def ways(self) -> Int[np.ndarray, "4 positions"]:
        """The position after a step in each direction, from [`jaxcell.robot.grid_steps`][]."""
        return grid_steps(self.cells.free, self.closed)

    @property
    def header(self) -> dict[str, Any]:
        return {**super().header, "robot": self.robot, "start": self.start}


def save_patrols(
    path: str | os.PathLike[str],
    cells: CellSpace,
    walks: Sequence[tuple[Int[np.ndarray, "_ states"], Float[np.ndarray, "_ states"]]],
    starts: Sequence[int],
    reach: float,
    **about: Any,
) -> None:
    """Write the random walks of robots on a map to a file for [`jaxcell.robot.load_task`][].

    **Arguments:**

    - `path`: the file, which is replaced if it exists.
    - `cells`: the cell space of a map; its directions have no effect.
    - `walks`: the `image` and `probability` of the walk of each robot, as in
        [`PatrolTask`][jaxcell.robot.PatrolTask].
    - `starts`: the position of each robot at the start.
    - `reach`: the largest distance at which a robot sees, in metres.
    - `about`: further fields to write to the file, such as the name of the map.

    A robot that patrols between the ends of a corridor:

        >>> import numpy as np
        >>> from jaxcell import examples, robot
        >>> walk = np.int32([[2, 1, 0]]), np.ones((1, 3))
        >>> path = examples.folder() / "patrol.json"
        >>> robot.save_patrols(path, examples.corridor(directions=4), [walk], [0], 1.5)
        >>> robot.load_task(path).image.tolist()
        [[2, 1, 0]]
    """
    plane = CellSpace(cells.room, cells.cell, 4, cells.origin, cells.free)
    open_, grid = free_steps(plane), grid_steps(cells.free)
    way, position = np.nonzero(open_ != grid)
    write_task(
        path,
        PatrolTask.kind,
        **about,
        cell_m=cells.cell,
        directions=4,
        step_m=cells.cell,
        robot_radius_m=cells.room.robot_radius,
        range_m=reach,
        origin_m=list(cells.origin),
        free=["".join(".#"[not square] for square in row) for row in cells.free],
        closed=np.stack([position, way], axis=1).tolist(),
        robots=[
            {
                "start": int(start),
                "image": np.asarray(image).tolist(),
                "probability": np.asarray(probability).tolist(),
            }
            for (image, probability), start in zip(walks, starts, strict=True)
        ],
    )


def read_patrol(path: Path, values: dict[str, Any], robot: int) -> PatrolTask:
    """Read the task of one robot from the parsed contents of a patrol file."""
    fields = Fields(values, f"{path}: ")
    own = robot_fields(path, fields, robot)
    common = common_fields(path, fields)
    if common["directions"] != 4:
        raise refused(
            f"{path}: directions", "4: a patrol drives along the grid", common["directions"]
        )
    rows = fields.get("free")
    if not isinstance(rows, list) or not all(isinstance(row, str) for row in rows):
        raise fields.refused("free", "a list of rows of . and #")
    if len({len(row) for row in rows}) != 1 or set("".join(rows)) not in ({"."}, {".", "#"}):
        raise fields.refused("free", "rows of . and #, of one length, with a . or more")
    free = np.array([list(row) for row in rows]) == "."
    x, y = fields.numbers("origin_m", (2,), whole=False).tolist()
    cells = CellSpace.of_grid(free, 4, cell=common["cell"], origin=(x, y))
    closed = fields.get("closed") and fields.numbers("closed", (-1, 2), whole=True).tolist()
    image = own.numbers("image", (-1, -1), whole=True)
    states = image.shape[1]
    if states == 0 or states % cells.positions:
        raise own.refused("image", f"rows of {cells.positions} states, or a multiple with memory")
    probability = own.numbers("probability", image.shape, whole=False)
    if image.min() < 0 or image.max() >= states:
        raise own.refused("image", f"states from 0 to {states - 1}")
    if probability.min() < 0 or np.abs(probability.sum(axis=0) - 1).max() > 1e-6:
        raise own.refused("probability", "from 0, with the sum 1 at each state")
    task = PatrolTask(
        **common,
        robot=robot,
        robots=len(values["robots"]),
        cells=cells,
        closed=tuple((position, way) for position, way in closed or ()),
        image=image,
        probability=probability,
        start=own.whole("start", 0, cells.positions - 1),
        reach=fields.number("range_m", 0.0),
    )
    _check_ways(task)
    return task


def _check_ways(task: PatrolTask) -> None:
    """Raise `ValueError` if the walk visits a position that the robot cannot reach on the grid."""
    drawn = np.zeros(task.image.shape[1], bool)
    front = np.array([task.start])
    while front.size:
        drawn[front] = True
        after = task.image[:, front][task.probability[:, front] > 0]
        front = np.unique(after[~drawn[after]])
    with about(task.path):
        away = wave(task.ways, task.start) < 0
        cut_off = np.flatnonzero(drawn.reshape(-1, away.size).any(axis=0) & away)
    if cut_off.size:
        x, y, _ = task.cells.centre(int(cut_off[0]))
        raise ValueError(
            f"{task.path}: robots[{task.robot}] walks to position {cut_off[0]}, ({x:g} m, "
            f"{y:g} m), which no path along the grid reaches from its start"
        )
