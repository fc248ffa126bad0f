from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Int

from ..bounce import TeamTrajectory
from ..space import CellSpace
from .checks import team_checks, with_checks
from .provenance import angle_attributes, provenance


def team_dataset(
    cells: CellSpace, team: TeamTrajectory, *, spec: Mapping[str, Any] | None = None
) -> xr.Dataset:
    """A joint trajectory of several robots as a labelled dataset.

    Over `time`, from the start: the `cell` of each `robot` with its `x`, `y` and `theta`, and the
    number of positions `covered` so far. Over `move`, the steps between: `bumped`, `collided` and
    `collisions`. Over `part`: the time when it begins. Over `position`: the time when it is first
    visited, and by which robot.

    **Arguments:**

    - `cells`: the cell space.
    - `team`: the joint trajectory.
    - `spec`: what was asked for, kept as JSON in the attribute `spec`.

    **Returns:** an `xarray.Dataset` for [`jaxcell.record.save_dataset`][].

    **Raises:** `ValueError` if the trajectory is not of these cells, or if `spec` is not JSON;
    `RuntimeError` if it contradicts itself.

    Two robots in a corridor of three cells:

        >>> import math
        >>> from jaxcell import bounce, record, space
        >>> room = space.Workspace([(0, 0), (3, 0), (3, 1), (0, 1)])
        >>> cells = space.CellSpace.of(room, 1.0, 4)
        >>> team = bounce.team_trajectory(cells, starts=[0, 5], bounces=math.pi / 2)
        >>> dataset = record.team_dataset(cells, team)
        >>> dataset.cell.dims, dataset.covered.values.tolist()
        (('time', 'robot'), [2, 3])
    """
    check_team(cells, team)
    x, y, theta = cells.centre(team.path)
    position_x, position_y, _ = cells.centre(np.arange(cells.positions))
    time, robot = first_visits(cells, team)
    metres = {"units": "m"}
    by_robot, by_move = ("time", "robot"), ("move", "robot")
    dataset = xr.Dataset(
        {
            "cell": (by_robot, team.path, {"long_name": "cell that the robot is in"}),
            "x": (by_robot, x, metres),
            "y": (by_robot, y, metres),
            "theta": (by_robot, theta, angle_attributes("heading")),
            "covered": (
                "time",
                team.covered.astype(np.int32),
                {"long_name": "positions visited so far", "units": "positions"},
            ),
            "bumped": (by_move, team.bumped, {"long_name": "whether the robot stayed and turned"}),
            "collided": (by_move, team.collided, {"long_name": "whether it met another robot"}),
            "collisions": ("move", team.collisions, {"long_name": "pairs of robots that collided"}),
            "part_begin": ("part", team.parts.astype(np.int32), {"units": "mappings"}),
            "first_visit": (
                "position",
                time,
                {"long_name": "time of the first visit", "padding": "-1: never visited"},
            ),
            "first_visitor": (
                "position",
                robot,
                {"long_name": "robot that is there first", "padding": "-1: never visited"},
            ),
        },
        coords={
            "time": ("time", np.arange(len(team.path), dtype=np.int32), {"units": "mappings"}),
            "position_x": ("position", position_x, metres),
            "position_y": ("position", position_y, metres),
        },
        attrs={
            **provenance("Joint trajectory of bouncing robots for coverage", cells, spec),
            "source": "jaxcell; after Alam 2018, section 3.4.4",
            "outcome": team.outcome.name.lower(),
            "outcome_meaning": team.outcome.value,
        },
    )
    return with_checks(dataset, team_checks(dataset, cells.directions, cells.positions))


def first_visits(
    cells: CellSpace, team: TeamTrajectory
) -> tuple[Int[np.ndarray, "positions"], Int[np.ndarray, "positions"]]:
    """When each position is first visited, and by which robot; -1 if never."""
    position, first = np.unique(team.path % cells.positions, return_index=True)
    time, robot = np.full((2, cells.positions), -1, np.int32)
    time[position], robot[position] = np.divmod(first, team.path.shape[1])
    return time, robot


def check_team(cells: CellSpace, team: TeamTrajectory) -> None:
    """Raises `ValueError` if a joint trajectory is not of these cells."""
    wrong = np.argwhere((team.path < 0) | (team.path >= cells.size))
    if len(wrong):
        step, robot = wrong[0]
        raise ValueError(
            f"team: path[{step}, {robot}] is cell {team.path[step, robot]}; cells are 0 to "
            f"{cells.size - 1}"
        )
    told = int(team.covered[-1]) + team.uncovered.size
    if told != cells.positions:
        raise ValueError(f"team: it tells of {told} positions, and there are {cells.positions}")
