from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from ..bounce import Plan
from ..space import CellSpace
from .checks import navigation_checks, with_checks
from .provenance import angle_attributes, cell_coordinates, provenance


def navigation_dataset(
    cells: CellSpace, plan: Plan, *, spec: Mapping[str, Any] | None = None
) -> xr.Dataset:
    """A plan of a bouncing robot as a labelled dataset.

    Over `time`, from the start: the `cell` of the robot with its pose `robot_x`, `robot_y` and
    `robot_theta`. Over `move`, the steps between: the `action`, 0 for a step forward and an angle
    for a bump, in radians, and the same in degrees. Over `direction` and `position`: whether the
    goal can be reached. The `cost` is -1 if there is no path.

    **Arguments:**

    - `cells`: the cell space.
    - `plan`: the plan.
    - `spec`: what was asked for, kept as JSON in the attribute `spec`.

    **Returns:** an `xarray.Dataset` for [`jaxcell.record.save_dataset`][].

    **Raises:** `ValueError` if the plan is not of these cells, or if `spec` is not JSON;
    `RuntimeError` if its actions do not lead where it says.

    A corridor of three cells, and a robot that turns left at a bump:

        >>> import math
        >>> from jaxcell import bounce, record, space
        >>> room = space.Workspace([(0, 0), (3, 0), (3, 1), (0, 1)])
        >>> cells = space.CellSpace.of(room, 1.0, 4)
        >>> plan = bounce.plan(cells, [math.pi / 2], start=0, goal=5)
        >>> dataset = record.navigation_dataset(cells, plan)
        >>> dataset.cell.values.tolist(), dataset.action_deg.values.round().tolist()
        ([0, 1, 2, 5], [0.0, 0.0, 90.0])
    """
    check_plan(cells, plan)
    x, y, theta = cells.centre(plan.cells)
    metres = {"units": "m"}
    action = {"long_name": "0 for a step forward, the angle to turn by at a bump"}
    reaches = plan.reaching.reshape(cells.directions, cells.positions)
    dataset = xr.Dataset(
        {
            "start": ((), np.int32(plan.start), {"long_name": "cell of the start"}),
            "goal": ((), np.int32(plan.goal), {"long_name": "cell of the goal"}),
            "cost": ((), plan.cost, {"long_name": "cost of the plan, -1 if there is no path"}),
            "cell": ("time", plan.cells, {"long_name": "cell that the robot is in"}),
            "robot_x": ("time", x, metres),
            "robot_y": ("time", y, metres),
            "robot_theta": ("time", theta, angle_attributes("heading")),
            "action": ("move", plan.actions, {**angle_attributes("action"), **action}),
            "action_deg": ("move", np.rad2deg(plan.actions), {**action, "units": "degree"}),
            "reaches": (
                ("direction", "position"),
                reaches,
                {"long_name": "whether the goal can be reached from the cell"},
            ),
        },
        coords={
            "time": ("time", np.arange(len(plan.cells), dtype=np.int32), {"units": "mappings"}),
            **cell_coordinates(cells),
        },
        attrs={
            **provenance("Plan of a bouncing robot", cells, spec),
            "source": "jaxcell; after Alam 2018, section 3.4.1",
        },
    )
    return with_checks(dataset, navigation_checks(dataset))


def check_plan(cells: CellSpace, plan: Plan) -> None:
    """Raises `ValueError` if a plan is not of these cells."""
    if plan.reaching.size != cells.size:
        raise ValueError(
            f"plan: it is of {plan.reaching.size} cells, and there are {cells.size}; it is not of "
            "these cells"
        )
