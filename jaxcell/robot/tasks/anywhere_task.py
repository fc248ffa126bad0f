import dataclasses
import functools
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ...base.documents import Fields, refused
from ...space import Workspace
from ...walls import Aim, Errors, Homing, StartRegion, WallFilter
from ..anywhere import AnywhereSettings
from .task import Task, angles, common_fields, write_task


@dataclasses.dataclass(frozen=True)
class AnywhereTask(Task):
    """The task of a robot that starts at an unknown pose, to localize itself or reach a goal."""

    kind = "anywhere"
    headings: int | None
    "The number of equally spaced headings that are possible at the start; `None` for any heading."
    start: StartRegion | None
    "The region where the robot starts; `None` for anywhere."
    build: Callable[[], AnywhereSettings]
    "A function that builds the settings; the call may take seconds."

    @functools.cached_property
    def settings(self) -> AnywhereSettings:
        """The settings of this task for [`jaxcell.robot.run_anywhere`][]."""
        return self.build()

    @property
    def strides(self) -> None:
        return None


def save_anywhere(path: str | os.PathLike[str], workspace: Workspace, **fields: Any) -> None:
    """Write the task of a robot that starts at an unknown pose to a file.

    The file contains the map and all `fields`. `cell_m`, `directions`, `step_m` and `bounce_deg`
    describe the robot. `headings`, `slices`, `errors` (as a dictionary) and `counted_m` are for the
    arguments `headings`, `slices`, `errors` and `step` of `WallFilter.of`. `known_m`, `aim` and
    `ahead` are for the fields `radius`, `aim` and `ahead` of [`AnywhereSettings`][]. `goal_m` and
    `goal_radius_m` are the centre and radius of a goal; without a goal the robot localizes itself.
    `from` (as a dictionary) is the region where the robot starts; without it, it starts anywhere.
    `outliers` is the number of bumps that may not be on the map, by default 0.
    """
    write_task(
        path,
        AnywhereTask.kind,
        boundary=workspace.boundary.tolist(),
        obstacles=[ring.tolist() for ring in workspace.obstacles],
        robot_radius_m=workspace.robot_radius,
        name=workspace.name,
        **fields,
    )


def read_anywhere(path: Path, values: dict[str, Any]) -> AnywhereTask:
    """Create the task from `values`, the parsed contents of a file that `save_anywhere` wrote."""
    fields = Fields(values, f"{path}: ")
    common = common_fields(path, fields)
    boundary, errors = fields.numbers("boundary", (-1, 2), whole=False), fields.get("errors")
    bounces = angles(path, fields, "bounce_deg", "anywhere", 1)
    headings = fields.whole("headings", 2, 10_000) if values.get("headings") is not None else None
    slices, counted = fields.whole("slices", 2, 100_000), fields.number("counted_m", 0.0)
    goal = None
    if values.get("goal_m") is not None:
        x, y = fields.numbers("goal_m", (2,), whole=False).tolist()
        goal = (x, y), fields.number("goal_radius_m", 0.0)
    obstacles, name = fields.get("obstacles") or (), str(values.get("name", ""))
    try:
        workspace = Workspace(boundary, obstacles, common["radius"], name)
        if not isinstance(errors, dict):
            raise refused("errors", "an object of bounds", errors)
        bounds = Errors(**{name: float(value) for name, value in errors.items()})
        start = None if (region := fields.get("from")) is None else _region(region)
        if start is not None:
            start.check(workspace)
    except (ValueError, TypeError) as error:
        raise ValueError(f"{path}: {error}") from None
    radius = fields.number("known_m", 0.0)
    aim: Aim = "worst" if values.get("aim") == "worst" else "mean"
    ahead = fields.whole("ahead", 1, 3) if "ahead" in values else 1
    outliers = fields.whole("outliers", 0, 3) if "outliers" in values else 0

    def build() -> AnywhereSettings:
        filter = WallFilter.of(
            workspace,
            headings=headings,
            slices=slices,
            errors=bounds,
            step=counted,
            start=start,
        )
        homing = None if goal is None else Homing(filter, *goal, bounces)
        return AnywhereSettings(filter, bounces, radius, homing, aim, ahead, outliers=outliers)

    return AnywhereTask(**common, headings=headings, start=start, build=build)


def _region(value: Any) -> StartRegion:
    if not isinstance(value, dict) or not {"place", "heading", "radius"} == value.keys():
        raise refused("from", "an object with `place`, `heading` and `radius`", value)
    (x, y), heading = value["place"], value["heading"]
    place = float(x), float(y)
    return StartRegion(place, None if heading is None else float(heading), float(value["radius"]))
