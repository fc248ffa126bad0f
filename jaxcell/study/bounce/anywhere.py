"""Studies of robots that start anywhere and do not know where they are."""

import dataclasses
import math
import warnings
from pathlib import Path
from typing import Annotated, Any, Literal

from ... import bounce, space, walls
from ..map_study import DIRECTION_DEG, MapStudy
from ..parameters import AtLeastOne, Degrees, Length, Only
from ..study import Say, numbers, radians


_DEGREE = math.pi / 180
# The factors from the numbers of `errors` to metres, shares and radians.
_ERRORS = {"run": 1.0, "distance": 1.0, "late": 1.0, "displacement": 1.0}
_ERRORS |= {"turn": _DEGREE, "bump_turn": _DEGREE, "heading": _DEGREE}
# The number of starts whose plans of cells are compared.
_PLANS = 20
_ANYWHERE = Only(anywhere=True)


@dataclasses.dataclass(frozen=True, kw_only=True)
class AnywhereStudy(MapStudy):
    """Base class of studies whose robots may start anywhere, not only at the centres of cells."""

    seed: int = 0
    """Seed of the random starts, errors and choices."""
    anywhere: Annotated[bool, Only(collision="swept")] = False
    """Start robots anywhere, and track their possible positions along the walls instead of their
    possible cells. A robot drives straight from bump to bump, and counts the steps of each run."""
    heading: Annotated[Literal["known", "unknown"], _ANYWHERE] = "known"
    """Knowledge of a robot about its heading at the start: it is one of the directions of the map
    (known), or it may be any heading (unknown)."""
    errors: Annotated[tuple[str, ...], _ANYWHERE] = ()
    """Bounds of the errors, each as NAME=VALUE. In metres: distance=0.05 for the length of a run
    between bumps; late=0.01 for the distance counted between meeting a wall and feeling the bump;
    displacement=0.03 from a bump to the start of the next run. As a share: run=0.02 of the length
    of a run. In degrees: turn=1 for a turn; heading=2 for the first heading; bump_turn=2 for the
    turn toward the wall that a bump at 45 degrees of incidence causes."""
    measured: Annotated[bool, _ANYWHERE] = False
    """Let the robots measure the distance between bumps instead of counting steps."""
    robots: Annotated[AtLeastOne, _ANYWHERE] = 1000
    """Number of robots."""
    bumps: Annotated[AtLeastOne, _ANYWHERE] = 30
    """Number of bumps of each robot."""
    radius: Annotated[Length | None, _ANYWHERE] = None
    """Distance in metres within which a robot is localized: at a bump, the diagonal of the box
    around all its possible places is at most twice as long. By default half a cell, or the radius
    of the goal."""
    slices: Annotated[AtLeastOne, _ANYWHERE] = 360
    """Number of equal intervals into which headings are divided, if they are not known exactly."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.anywhere:
            self.bounds()

    def bounds(self) -> "walls.Errors":
        """Read the bounds of the errors from the parameter `errors`."""
        bounds = {}
        for text in self.errors:
            name, _, value = text.partition("=")
            if name not in _ERRORS:
                raise ValueError(f"errors {text!r}: expected one of {', '.join(_ERRORS)}")
            expected = "a number after ="
            bounds[name] = numbers("errors", value, 1, expected)[0] * _ERRORS[name]
        return walls.Errors(**bounds)

    def needed(self, extent: Any) -> float | int:
        return 0 if self.anywhere else super().needed(extent)

    def filter(self, cells: Any, turns: list[float]) -> "walls.WallFilter":
        """Build the filter that tracks a robot's possible positions on the walls of a map.

        `turns` are the bouncing angles in radians.
        """
        step = cells.cell if self.step is None else self.step
        return walls.WallFilter.of(
            cells.workspace,
            headings=self._known_headings(cells),
            slices=self.slices,
            errors=self.bounds(),
            step=0.0 if self.measured else step,
            turns=turns,
        )

    @property
    def choice(self) -> dict[str, Any]:
        """Keyword arguments `aim` and `ahead` of `walls.drive_anywhere`, if the study has them."""
        return {}

    def save_task(self, result: "bounce.Anywhere", out: Path) -> None:
        """Write the task file for `jaxcell robot run`."""
        from ...robot.tasks.anywhere_task import save_anywhere

        cells, filter = result.cells, result.filter
        if self.errors and not filter.errors.displacement:
            warnings.warn(
                "anywhere.json: `errors` have no displacement: a robot with a bumper "
                "may leave its sets; add displacement=0.06, or twice the way that it backs off",
                stacklevel=2,
            )
        about = {
            "cell_m": cells.cell,
            "directions": cells.directions,
            "step_m": cells.cell if self.step is None else self.step,
            "bounces_deg": result.bounces_deg.tolist(),
            "headings": result.headings,
            "slices": self.slices,
            "errors": dataclasses.asdict(filter.errors),
            "counted_m": filter.step,
            "known_m": result.radius,
            **self.choice,
        }
        if isinstance(result, bounce.HomeFromAnywhere):
            about |= {"goal_m": result.homing.goal, "goal_radius_m": result.homing.radius}
        assert cells.workspace is not None
        save_anywhere(out / "anywhere.json", cells.workspace, **about)

    def _known_headings(self, cells: Any) -> int | None:
        return cells.directions if self.heading == "known" else None

    def run_anywhere(
        self,
        bounces: tuple[Degrees, ...],
        start: str | None,
        say: Say,
        goal: tuple[tuple[float, float], float] | None = None,
    ) -> "bounce.Anywhere":
        """Simulate robots that start anywhere, to localize them or to bring them to a goal.

        `start` is the pose of the first robot, and `goal` a centre and a radius, in metres.
        """
        cells = self.cells()
        workspace = cells.workspace
        assert workspace is not None
        headings = self._known_headings(cells)
        first = None if start is None else pose_at(workspace, start, "start", headings)
        say("finding the chords of the room")
        angles = radians(bounces)
        filter = self.filter(cells, angles.tolist())
        homing = None
        if goal is not None:
            homing = walls.Homing(filter, *goal, tuple(angles.tolist()))
            say("counting bumps to the goal")
        trial = walls.drive_anywhere(
            workspace,
            filter,
            angles.tolist(),
            robots=self.robots,
            bumps=self.bumps,
            headings=headings,
            goal=homing,
            start=first,
            **self.choice,
            seed=self.seed,
            say=say,
        )
        radius = self.radius
        if radius is None:
            radius = cells.cell / 2 if goal is None else goal[1]
        driven: dict[str, Any] = {"cells": cells, "filter": filter, "bounces": angles}
        driven |= {"radius": radius, "trial": trial, "headings": headings}
        if homing is None:
            return bounce.Anywhere(**driven)
        planned = _planned(cells, angles, trial, homing.goal)
        return bounce.HomeFromAnywhere(**driven, homing=homing, **planned)


def pose_at(
    workspace: "space.Workspace", text: str, parameter: str, headings: int | None
) -> tuple[float, float, float]:
    """Parse the pose "x,y,heading" of a parameter, and raise if a robot cannot start there.

    The pose must be in the free space, and its heading must be one of `headings` equally spaced
    headings, unless any heading is possible (`None`).
    """
    import shapely

    x, y, heading = numbers(parameter, text, 3, '"x,y,heading" in metres and degrees')
    if not workspace.free_space.covers(shapely.Point(x, y)):
        raise ValueError(f"{parameter} {text!r}: ({x:g} m, {y:g} m) is not in the free space")
    width = 360 / (headings or math.inf)
    if headings is not None and abs(math.remainder(heading, width)) > DIRECTION_DEG:
        raise ValueError(
            f"{parameter} {text!r}: the robot knows that its heading is a multiple of {width:g} "
            f"degrees, got {heading:g}; expected such a heading, or a robot with an unknown heading"
        )
    return x, y, math.radians(heading)


def _planned(
    cells: Any, angles: Any, trial: "walls.Trial", goal: tuple[float, float]
) -> dict[str, Any]:
    """Compute the median number of bumps and the median length in metres of plans among cells.

    For comparison with a trial, plans lead to the goal from the starts of up to 20 of its robots.
    The medians are `None` if an angle is not a multiple of the angle between directions.
    """
    import numpy as np

    step = 2 * math.pi / cells.directions
    if np.abs(angles / step - np.round(angles / step)).max() > 1e-9:
        return {"planned_bumps": None, "planned_metres": None}
    end = int(cells.index(*goal, 0.0)) % cells.positions
    plans = []
    for place, heading in zip(trial.start[:_PLANS], trial.heading[:_PLANS, 0], strict=True):
        start = int(space.nearest_cell(cells, place[0], place[1], heading))
        candidates = [
            bounce.plan(cells, bounces=angles, start=start, goal=direction * cells.positions + end)
            for direction in range(0, cells.directions, max(1, cells.directions // 8))
        ]
        arriving = [candidate for candidate in candidates if candidate.found]
        least = min(arriving, key=lambda candidate: candidate.bumps, default=None)
        plans.append(
            (math.inf, math.inf) if least is None else (least.bumps, least.steps * cells.cell)
        )
    bumps, metres = np.median(plans, axis=0).tolist()
    return {"planned_bumps": bumps, "planned_metres": metres}
