import dataclasses
import functools
import os
from pathlib import Path
from typing import Any

from ...base.documents import Fields, refused
from ...space import Workspace
from ...walls import Aim, Errors, Homing, WallFilter
from ..anywhere import AnywhereSettings
from .task import Task, angles, common_fields, write_task


KIND = "anywhere"


@dataclasses.dataclass(frozen=True)
class AnywhereTask(Task):
    """The task of a robot that starts at an unknown pose, to localize itself or reach a goal."""

    workspace: Workspace
    bounces: tuple[float, ...]
    "The bouncing angles to choose from, in radians."
    headings: int | None
    "The number of equally spaced headings that are possible at the start; `None` for any heading."
    slices: int
    "The number of intervals into which the filter divides the headings."
    errors: Errors
    counted: float
    "The length of a step, in metres, if the robot counts its steps; 0 if it measures its runs."
    known: float
    "The robot counts as localized if its possible places lie within this radius, in metres."
    goal: tuple[float, float] | None
    "The centre of the goal region in metres; `None` without a goal."
    goal_radius: float
    "The radius of the goal region, in metres."
    aim: Aim
    ahead: int
    "The number of bumps that the choice of an angle looks ahead."

    @functools.cached_property
    def settings(self) -> AnywhereSettings:
        """The settings of this task for [`jaxcell.robot.run_anywhere`][]."""
        filter = WallFilter.of(
            self.workspace,
            headings=self.headings,
            slices=self.slices,
            errors=self.errors,
            step=self.counted,
        )
        homing = None
        if self.goal is not None:
            homing = Homing(filter, self.goal, self.goal_radius, self.bounces)
        return AnywhereSettings(filter, self.bounces, self.known, homing, self.aim, self.ahead)

    @property
    def strides(self) -> None:
        return None

    @property
    def header(self) -> dict[str, Any]:
        return {"kind": KIND, **super().header}


def save_anywhere(path: str | os.PathLike[str], workspace: Workspace, **fields: Any) -> None:
    """Write the task of a robot that starts at an unknown pose to a file.

    `fields` are `cell_m`, `directions`, `step_m`, `bounces_deg`, `headings`, `slices`, `errors`,
    `counted_m` and `known_m`; with a goal `goal_m` and `goal_radius_m`, else `aim` and `ahead`.
    """
    write_task(
        path,
        KIND,
        boundary=workspace.boundary.tolist(),
        obstacles=[ring.tolist() for ring in workspace.obstacles],
        robot_radius_m=workspace.robot_radius,
        name=workspace.name,
        **fields,
    )


def read_anywhere(path: Path, values: dict[str, Any]) -> AnywhereTask:
    """Read the task of a robot that starts at an unknown pose."""
    fields = Fields(values, f"{path}: ")
    common = common_fields(path, fields)
    errors, bounces = fields.get("errors"), angles(path, fields, "bounces_deg", "anywhere", 1)
    goal = values.get("goal_m")
    try:
        workspace = Workspace(
            fields.numbers("boundary", (-1, 2), whole=False),
            fields.get("obstacles") or (),
            common["radius"],
            str(values.get("name", "")),
        )
        if not isinstance(errors, dict):
            raise refused("errors", "an object of bounds", errors)
        bounds = Errors(**{name: float(value) for name, value in errors.items()})
    except (ValueError, TypeError) as error:
        raise ValueError(f"{path}: {error}") from None
    headings = values.get("headings")
    return AnywhereTask(
        **common,
        workspace=workspace,
        bounces=bounces,
        headings=None if headings is None else fields.whole("headings", 2, 10_000),
        slices=fields.whole("slices", 2, 100_000),
        errors=bounds,
        counted=fields.number("counted_m", 0.0),
        known=fields.number("known_m", 0.0),
        goal=None if goal is None else tuple(fields.numbers("goal_m", (2,), whole=False).tolist()),
        goal_radius=0.0 if goal is None else fields.number("goal_radius_m", 0.0),
        aim="worst" if values.get("aim") == "worst" else "mean",
        ahead=fields.whole("ahead", 1, 3) if "ahead" in values else 1,
    )
