"""The options of `jaxcell robot run`, and the meaning of `--heading`."""

import dataclasses
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import tyro

from ...study.errors import ErrorTexts
from ...study.parameters import AtLeastOne, Degrees, Headings, Limit, Metres, Only, Unit
from ..output import Printing


if TYPE_CHECKING:
    from ...robot.tasks.task import Task


_EMULATED = Only(simulate=True)
_EMULATED_WITHOUT_PHYSICS = Only(simulate=True, physics=False)


@dataclasses.dataclass(frozen=True, kw_only=True)
class RunOptions(Printing):
    """The options of a run of a task on a robot."""

    headings: ClassVar[Headings] = {
        "How does the robot drive?": (
            *("steps", "tolerance", "turn_tolerance", "speed"),
            *("calibration", "remap"),
        ),
        "How is the robot emulated?": (
            *("errors", "give", "physics"),
            *("friction", "speedup", "seed"),
        ),
        "When does the run end?": ("limit", "until", "outliers", "restarts", "visits", "bumps"),
        "Which robot of a patrol is it?": ("robot", "intruder", "camera"),
    }

    file: tyro.conf.Positional[Path]
    """Task to run, from the folder --out of a command: filter.jxf or policy.jxf (localize),
    belief.jxb (localize slip), anywhere.json (localize anywhere, navigate anywhere), summary.json
    (navigate), team.json (team), or patrol.json (patrol map)."""
    robot: int | None = None
    """Number of the robot in its team or patrol, by default 0. Each robot needs its own process."""
    port: str | None = None
    """Serial line of the robot, such as /dev/ttyUSB0 or socket://host:port."""
    ros: Annotated[Literal["create3", "base"] | None, Only(port=False)] = None
    """Drive a robot on ROS 2: a Create 3 or TurtleBot 4 through its ROS actions (create3), or any
    robot with the topics cmd_vel, odom and bumper (base). The possible cells of the robot are
    published on the topics candidates and candidate_squares."""
    remap: Annotated[tuple[str, ...], Only(ros=True)] = ()
    """Rules that rename topics of ROS, such as __ns:=/robot1 or cmd_vel:=/base/cmd_vel."""
    simulate: Annotated[Path | None, Only(port=False, ros=False)] = None
    """Map in which to emulate a robot; it may differ from the map of the task."""
    start: str | None = None
    """Start of an emulated robot, or of a robot on patrol: "x,y,heading" in m and degrees, or a
    cell number; by default the start of the task, or a random cell."""
    heading: Annotated[Degrees | None, Only(resume=False)] = None
    """Heading of the robot at the start in degrees; by default the heading of the plan, team or
    patrol. A filter, a policy and a belief need it only if the steps of the task differ between
    directions, for instance because they are longer along a diagonal."""
    steps: Annotated[Literal["encoder", "clock"], Only(ros=False)] = "encoder"
    """Source of distances: the encoders of the wheels (encoder), or time and speed (clock)."""
    tolerance: Metres | None = None
    """Largest error at the end of a step, in metres, that is not corrected; by default 4 mm, or
    less for steps below 1 m."""
    turn_tolerance: Degrees = 0.4
    """Largest error at the end of a turn, in degrees, that is not corrected."""
    give: Annotated[Metres | None, _EMULATED_WITHOUT_PHYSICS] = None
    """Distance that the bumper of the emulated robot moves before it detects a wall, in metres; by
    default 0.02 times the squared side of a cell, at least 0.0005 and at most 0.02."""
    errors: Annotated[ErrorTexts, _EMULATED_WITHOUT_PHYSICS] = ()
    """Error slip=2% of the emulated robot: the common standard deviation of the relative errors of
    each step and turn, and of the angle in radians by which it veers per metre."""
    physics: Annotated[bool, _EMULATED] = False
    """Move the emulated robot with a physics engine, as a Create 2 of its true size. Bumps then
    turn the robot, and its wheels may slip."""
    friction: Annotated[float | None, Limit(gt=0), Only(physics=True)] = None
    """Coefficient of friction between the wheels and the floor; by default 0.8."""
    speed: Annotated[
        float | None, Unit("", "m/s"), Limit(gt=0, le=0.5), Only(ros=False, steps="encoder")
    ] = None
    """Speed of the robot on straight runs in m/s, up to 0.5; by default 0.2."""
    speedup: Annotated[float, _EMULATED] = 10.0
    """Largest speed of the emulation, in emulated seconds per second."""
    seed: int = 0
    """Seed of the random start, of the noise, and of the random walk of a patrol."""
    limit: AtLeastOne = 10_000
    """Number of observations after which the run ends without an answer."""
    until: Literal["known", "cycle"] = "known"
    """Condition that ends the run of a filter: a knowledge cycle, which the filter cannot leave
    (cycle); or such a cycle or a single possible configuration, whichever is first (known)."""
    confirm: Annotated[int | None, Limit(ge=0), Only(resume=False)] = None
    """Number of further observations that must agree with the map before the robot is localized, by
    default 30; for a robot that starts anywhere, number of further bumps, by default 20. A filter
    leaves one configuration on a wrong map, too, unless further observations refute it. For a
    belief, decibans of evidence, by default 30: the map must explain the observations 10^(N/10)
    times better than a predictor that learns from them. With 0 an answer is not confirmed."""
    outliers: Annotated[int | None, Limit(ge=0, le=3)] = None
    """Number of bumps at things that are not on the map, such as a chair, that the sets of a robot
    that starts anywhere tolerate; by default the number in the task."""
    restarts: Annotated[int | None, Limit(ge=0)] = None
    """Number of times that a robot that starts anywhere begins again from everywhere, without a
    stop, after a run that is impossible; by default 0."""
    visits: AtLeastOne = 100
    """Number of cells to visit on a patrol."""
    bumps: AtLeastOne = 20
    """Number of bumps, at cells that are free on the map, after which a patrol gives up."""
    intruder: Annotated[str | None, _EMULATED] = None
    """Position "x,y" in metres of an intruder that an emulated robot on patrol may detect."""
    camera: Annotated[str | None, Only(intruder=False)] = None
    """Camera with which a robot on patrol finds an intruder, marked with a cross: the number of the
    camera, or a folder of pictures."""
    calibration: Annotated[Path | None, Only(steps="encoder")] = None
    """File of `jaxcell robot calibrate`; by default, for a robot on a serial line, calibration.json
    in ~/.config/jaxcell if it exists."""
    resume: Path | None = None
    """Log of a run to continue: run.jsonl of a stopped run of this task. The robot must stand at
    the end of the last step, with the heading of the next step; an emulated robot is at --start."""
    out: Path | None = None
    """Folder for the log, the recording and summary.json; it must not contain a log yet."""
    live: str | None = None
    """Viewer that shows the recording during the run: "here" for a viewer on this computer (without
    a display, a web page that is served until Ctrl-C), or the address of a running viewer, such as
    rerun+http://laptop:9876/proxy."""


def direction_at(heading: float, directions: int) -> int:
    """Convert the option `--heading`, in degrees, to the index of a direction of the task."""
    turn = heading * directions / 360
    if not math.isfinite(turn) or abs(turn - round(turn)) > 1e-6:
        raise ValueError(
            f"--heading {heading:g}: expected a multiple of the {360 / directions:g} degrees "
            "between the directions"
        )
    return round(turn) % directions


def check_heading(task: "Task") -> None:
    """Require the option `--heading` if the steps of a task differ between directions."""
    if task.needs_heading:
        raise ValueError(
            f"--heading: expected the heading of the robot at the start in degrees, because the "
            f"steps of {task.path} differ between directions"
        )
