"""Studies of robots that start anywhere and do not know where they are."""

import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import tyro

from ... import bounce as bouncing, space, walls
from ...base.doubts import warn
from ...base.quantities import Result
from ..errors import ErrorTexts, read_errors
from ..map_study import DIRECTION_DEG, RobotStudy, disc_at
from ..parameters import Angles, AtLeastOne, Count, Headings, Length, Limit, Only, Pose
from ..study import Say, about, numbers, radians, silent


# The default distance in metres within which a robot is localized.
LOCALIZED = 0.5
# The default number of robots: with exact headings, with other headings, and with outliers too.
_ROBOTS = (1000, 100, 20)
_COMPASS = {"east": "0", "north": "90", "west": "180", "south": "270"}
_SEVERAL = Only(bounce=Count.SEVERAL)


@dataclasses.dataclass(frozen=True, kw_only=True)
class AnywhereStudy(RobotStudy):
    """Base class of studies whose robots may start anywhere, not only at the centres of cells."""

    headings: ClassVar[Headings] = {
        "How wrong can the robot be?": ("heading", "errors", "measured", "outliers"),
        "How is it simulated?": ("robots", "bumps", "radius", "slices", "seed"),
    }

    from_: Annotated[Pose | None, tyro.conf.arg(name="from")] = None
    """Region where all robots start, "x,y", "x,y,heading" or "x,y,heading,radius" in m and degrees,
    such as a dock; by default they start anywhere. Without a radius it is a point. The heading is
    North (90), East (0) or another word or number; an empty one, "1,1,,0.1", stands for all the
    directions of the map, or with an unknown `heading` for all headings."""
    start: Pose | None = None
    """Start of the first robot, "x,y,heading" in m and degrees; the others start at random, and by
    default the first, too."""
    heading: Literal["known", "unknown"] = "known"
    """Knowledge of a robot about its heading at the start: it is one of the directions of the map
    (known), or it may be any heading (unknown)."""
    errors: ErrorTexts = ()
    """Bounds of the errors, each as NAME=VALUE: distance=5cm for the length of a run between bumps;
    late=1cm for the distance counted between meeting a wall and feeling the bump; displacement=3cm
    from a bump to the start of the next run; run=2% of the length of a run; turn=1deg for a turn;
    heading=2deg for the first heading; bump_turn=2deg for the turn toward the wall that a bump at
    45 degrees of incidence causes."""
    measured: bool = False
    """Let the robots measure the distance between bumps instead of counting steps."""
    outliers: Annotated[int, Limit(ge=0, le=3)] = 0
    """Number of bumps of each robot at things that are not on the map, such as a chair. Sets hold
    the robot although as many bumps were not on the map."""
    robots: AtLeastOne | None = None
    """Number of robots; by default 1000, or 100 if headings are not exact, or 20 if with such
    headings some bumps are not on the map (`outliers`)."""
    bumps: AtLeastOne = 30
    """Number of bumps of each robot."""
    radius: Length | None = None
    """Distance in metres within which a robot is localized: at a bump, the diagonal of the box
    around all its possible places is at most twice as long. By default half a metre, or the radius
    of the goal."""
    slices: AtLeastOne = 360
    """Number of equal intervals into which headings are divided, if they are not known exactly."""
    seed: int = 0
    """Seed of the random starts, errors and choices."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.bounds()

    def bounds(self) -> "walls.Errors":
        """Read the bounds of the errors from the parameter `errors`."""
        known = [field.name for field in dataclasses.fields(walls.Errors)]
        return walls.Errors(**read_errors(self.errors, known))

    def needed(self, extent: Any) -> float | int:
        return 0

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
            start=self._region(cells),
        )

    def _region(self, cells: Any) -> "walls.StartRegion | None":
        if self.from_ is None:
            return None
        return region_of(cells.workspace, self.from_, self._known_headings(cells))

    @property
    def choice(self) -> dict[str, Any]:
        """Keyword arguments `aim` and `ahead` of `walls.drive_anywhere`, if the study has them."""
        return {}

    def write(self, result: "bouncing.Anywhere", out: Path) -> None:
        """Write the task file for `jaxcell robot run`."""
        from ...robot.tasks.anywhere_task import save_anywhere

        cells, filter = result.cells, result.filter
        if self.errors and not filter.errors.displacement:
            warn(
                "anywhere.json: `errors` have no displacement: a robot with a bumper "
                "may leave its sets; add displacement=0.06, or twice the way that it backs off",
            )
        about = {
            "cell_m": cells.cell,
            "directions": cells.directions,
            "step_m": cells.cell if self.step is None else self.step,
            "bounce_deg": result.bounce_deg.tolist(),
            "headings": result.headings,
            "slices": self.slices,
            "errors": dataclasses.asdict(filter.errors),
            "counted_m": filter.step,
            "known_m": result.radius,
            **self.choice,
            **({"outliers": self.outliers} if self.outliers else {}),
        }
        if filter.start is not None:
            about["from"] = dataclasses.asdict(filter.start)
        if isinstance(result, bouncing.HomeFromAnywhere):
            about |= {"goal_m": result.homing.goal, "goal_radius_m": result.homing.radius}
        assert cells.workspace is not None
        save_anywhere(out / "anywhere.json", cells.workspace, **about)

    def _known_headings(self, cells: Any) -> int | None:
        return cells.directions if self.heading == "known" else None

    def simulate(
        self,
        say: Say,
        bounce: Sequence[float],
        goal: tuple[tuple[float, float], float] | None = None,
        filter: "walls.WallFilter | None" = None,
    ) -> "bouncing.Anywhere":
        """Simulate robots with angles in degrees, to localize them or to bring them to a goal.

        `goal` is a centre and a radius, in metres. By default the filter is built.
        """
        cells = self.cells()
        workspace = cells.workspace
        assert workspace is not None
        headings = self._known_headings(cells)
        first = None
        if self.start is not None:
            first = pose_at(workspace, self.start, "start", headings)
            check_start(self._region(cells), first, f"start {self.start!r}")
        angles = radians(bounce)
        if filter is None:
            say("finding the chords of the room")
            filter = self.filter(cells, angles.tolist())
        homing = None
        if goal is not None:
            homing = walls.Homing(filter, *goal, tuple(angles.tolist()))
            say("counting bumps to the goal")
        trial = walls.drive_anywhere(
            workspace,
            filter,
            angles.tolist(),
            robots=self.robots or self._usual_robots(filter),
            bumps=self.bumps,
            headings=headings,
            goal=homing,
            start=first,
            outliers=self.outliers,
            **self.choice,
            seed=self.seed,
            say=say,
        )
        radius = self.radius
        if radius is None:
            radius = LOCALIZED if goal is None else goal[1]
        driven: dict[str, Any] = {"cells": cells, "filter": filter, "bounces": angles}
        driven |= {"radius": radius, "trial": trial, "headings": headings}
        if homing is None:
            return bouncing.Anywhere(**driven)
        return bouncing.HomeFromAnywhere(**driven, homing=homing)

    def _usual_robots(self, filter: "walls.WallFilter") -> int:
        if not filter.chords.width:
            return _ROBOTS[0]
        return _ROBOTS[2] if self.outliers else _ROBOTS[1]


@dataclasses.dataclass(frozen=True, kw_only=True)
class BouncingAnywhere(AnywhereStudy):
    """Base class of studies of robots that start anywhere with given bouncing angles."""

    bounce: Angles
    """Bouncing angles in degrees, counter-clockwise; the robot chooses among several."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class LocalizeAnywhere(BouncingAnywhere):
    """Localize robots that start anywhere, by the sets of their possible places on the walls.

    A robot drives straight from bump to bump, and counts the steps of each run."""

    name: ClassVar[str] = "localization"
    command: ClassVar[str] = "localize anywhere"
    example: ClassVar[str] = "@lab_b --bounce 45 135 --errors run=2% turn=1deg --measured"
    task: ClassVar[str] = "localize anywhere"

    aim: Annotated[Literal["worst", "mean"], _SEVERAL] = "worst"
    """Statistic to minimize by the choice among angles: the largest (worst) or the mean size of the
    set of possible positions."""
    ahead: Annotated[int, Limit(ge=1, le=3), _SEVERAL] = 1
    """Number of bumps to look ahead in the choice among angles."""

    @property
    def choice(self) -> dict[str, Any]:
        return {"aim": self.aim, "ahead": self.ahead}

    def run(self, say: Say = silent) -> "bouncing.Anywhere":
        return self.simulate(say, self.bounce)


@dataclasses.dataclass(frozen=True, kw_only=True)
class NavigateAnywhere(BouncingAnywhere):
    """Lead robots that start anywhere to a goal, by the sets of their possible places on the walls.

    A robot drives straight from bump to bump, and counts the steps of each run."""

    name: ClassVar[str] = "navigation"
    command: ClassVar[str] = "navigate anywhere"
    example: ClassVar[str] = "@complex --bounce 45 100 135 --goal 1,1 --measured --robots 20"
    task: ClassVar[str] = "navigate anywhere"

    goal: Pose
    """Goal, "x,y" or "x,y,radius" in metres. By default the radius is the side of a cell, or half a
    metre if cells are smaller; where no wall is so near, at which a robot can stop, it is the
    distance to the nearest wall and a quarter of a metre."""

    def run(self, say: Say = silent) -> Result:
        return self.simulate(say, self.bounce, goal_at(self.cells(), self.goal))


def goal_at(cells: Any, text: Any) -> tuple[tuple[float, float], float]:
    """Parse the goal "x,y" or "x,y,radius"; the default radius reaches a wall."""
    import shapely

    goal, radius = disc_at(cells, text, "goal")
    if len(str(text).split(",")) == 2:
        away = cells.workspace.free_space.boundary.distance(shapely.Point(goal))
        if radius < math.hypot(away, 0.2):
            radius = away + 0.25
    return goal, radius


def pose_at(
    workspace: "space.Workspace", text: Any, parameter: str, headings: int | None
) -> tuple[float, float, float]:
    """Parse the pose "x,y,heading" of a parameter, and raise if a robot cannot start there.

    The pose must be in the free space, and its heading must be one of `headings` equally spaced
    headings, unless any heading is possible (`None`).
    """
    x, y, heading = numbers(
        parameter,
        ",".join(_with_degrees(text)),
        ("m", "m", "deg"),
        '"x,y,heading" in metres and degrees, such as 1,1,90 or 1,1,North',
    )
    with about(f"{parameter} {text!r}"):
        walls.StartRegion((x, y)).check(workspace)
    return x, y, _direction(text, parameter, heading, headings)


def region_of(workspace: "space.Workspace", text: Any, headings: int | None) -> "walls.StartRegion":
    """Parse the region "x,y[,heading[,radius]]" of `from`, and raise if no robot can start there.

    The heading may be empty, for all headings. Its condition is that of `pose_at`.
    """
    parts = _with_degrees(text)
    any_heading = len(parts) > 2 and not parts[2].strip()
    if any_heading:
        parts[2] = "0"
    units = ("m", "m", "deg", "m")[: max(2, len(parts))]
    expected = (
        '"x,y", "x,y,heading" or "x,y,heading,radius" in metres and degrees, such as 1,1,90,0.1 or '
        "1,1,North,0.1"
    )
    x, y, *rest = numbers("from", ",".join(parts), units, expected)
    any_heading |= not rest
    heading = None if any_heading else _direction(text, "from", rest[0], headings)
    region = walls.StartRegion((x, y), heading, *rest[1:])
    with about(f"from {text!r}"):
        region.check(workspace)
    return region


def _with_degrees(text: Any) -> list[str]:
    """Split a pose at its commas, and replace the word of a compass by its angle in degrees."""
    parts = text.split(",") if isinstance(text, str) else list(map(str, text))
    return [*parts[:2], *(_COMPASS.get(part.strip().lower(), part) for part in parts[2:])]


def check_start(
    region: "walls.StartRegion | None", pose: tuple[float, float, float], parameter: str
) -> None:
    """Raise if the region where all robots start does not contain the pose of a parameter."""
    if region is None:
        return
    if math.dist(region.place, pose[:2]) > region.radius + 1e-9 or (
        region.heading is not None
        and abs(math.remainder(region.heading - pose[2], math.tau)) > math.radians(DIRECTION_DEG)
    ):
        raise ValueError(f"{parameter}: the pose is not in the region `from`")


def _direction(text: Any, parameter: str, heading: float, headings: int | None) -> float:
    """Return a heading in degrees in radians, and raise if it is not one of `headings`."""
    width = 360 / (headings or math.inf)
    if headings is not None and abs(math.remainder(heading, width)) > DIRECTION_DEG:
        raise ValueError(
            f"{parameter} {text!r}: the robot knows that its heading is a multiple of {width:g} "
            f"degrees, got {heading:g}; expected such a heading, or a robot with an unknown heading"
        )
    return math.radians(heading if headings is None else round(heading / width) * width)
