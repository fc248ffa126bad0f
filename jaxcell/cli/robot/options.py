import dataclasses
from pathlib import Path
from typing import Literal

import tyro

from ...study.study import Degrees
from ..options import Printing


@dataclasses.dataclass(frozen=True, kw_only=True)
class RobotOptions(Printing):
    """The options of `jaxcell robot run`."""

    file: tyro.conf.Positional[Path]
    """What to run: the filter.jxf, policy.jxf, belief.jxb or anywhere.json of `jaxcell localize
    --out`, the summary.json or anywhere.json of `jaxcell navigate --out`, the team.json of `jaxcell
    team --out`, or the patrol.json of `jaxcell patrol map --out`."""
    robot: int | None = None
    """Number of the robot in its team or patrol, by default 0. Each robot runs by itself, in
    its own process."""
    port: str | None = None
    """Serial line of the robot, such as /dev/ttyUSB0 or socket://host:port."""
    ros: Literal["create3", "base"] | None = None
    """Drive a robot on ROS 2 instead: a Create 3 or TurtleBot 4 by its actions, or any base by
    cmd_vel, odom and bumper. Its possible places are published as candidates and
    candidate_squares."""
    remap: tuple[str, ...] = ()
    """Rules for the names of ROS, such as __ns:=/robot1 or cmd_vel:=/base/cmd_vel."""
    simulate: Path | None = None
    """Map in which to emulate the robot instead; it may differ from the map of the file."""
    start: str | None = None
    """Start of the emulated robot, and of any that patrols: "x,y,heading" in m and degrees, or a
    cell; by default that of the file, or random."""
    heading: Degrees | None = None
    """Heading of the robot at the start in degrees, by default that of the plan, team or patrol. A
    filter, policy or belief does not use it, but steps along a diagonal are longer: where steps
    differ between directions, the robot needs it, and an emulated robot does too."""
    steps: Literal["encoder", "clock"] = "encoder"
    """Measure distances by the encoders of the wheels, or by the time at a known speed."""
    tolerance: float | None = None
    """Tolerance of the end of a step by the encoders, in metres; by default 4 mm, or less for steps
    below 1 m."""
    turn_tolerance: float = 0.4
    """Tolerance of the end of a turn by the encoders, in degrees."""
    give: float | None = None
    """Distance that the bumper of the emulated robot goes in before it feels a wall, in metres; by
    default 0.02 times the square of the cell, at most 0.02 and at least 0.0005."""
    noise: float = 0.0
    """Standard deviation of the relative error of the emulated robot's steps and turns, and of its
    veer in radians per metre."""
    physics: bool = False
    """Let a physics engine move the emulated robot, a Create 2 of its true size among the walls of
    the map: a bump turns it, and its wheels may slip."""
    friction: float | None = None
    """Coefficient of friction between the wheels and the floor, with --physics; by default 0.8."""
    speed: float | None = None
    """Speed of the robot on straight ways in m/s, up to 0.5; by default 0.2."""
    speedup: float = 10.0
    """Seconds of the emulated robot per second, at most."""
    seed: int = 0
    """Seed of the random start, of the noise, and of the draws of a patrol."""
    limit: int = 10_000
    """Number of observations after which the run ends without a result."""
    until: Literal["known", "cycle"] = "known"
    """End of the run of a filter: one configuration left or a knowledge cycle, or only the
    cycle."""
    visits: int = 100
    """Number of drawn cells after which a patrol ends."""
    bumps: int = 20
    """Number of bumps in free space after which a patrol ends without a result."""
    intruder: str | None = None
    """Place of an intruder in the emulated map, "x,y" in metres, whom a robot on patrol reports."""
    camera: str | None = None
    """Source of the pictures in which a robot on patrol looks for the cross marker: the number of
    a camera, or a folder of pictures."""
    calibration: Path | None = None
    """File of `jaxcell robot calibrate`; by default, for a robot on a line, calibration.json in
    ~/.config/jaxcell if it exists. Steps by the clock have none."""
    resume: Path | None = None
    """The run.jsonl of a stopped run of this file, to go on from there. The robot stands
    where its last step ended and faces the way of its next; an emulated one stands at --start."""
    out: Path | None = None
    """Directory for the log, which must not exist yet, the recording and summary.json."""
    live: str | None = None
    """Viewer that shows the recording during the run: "here" (without a display a page for a
    browser, until Ctrl-C), or the address of one, such as rerun+http://laptop:9876/proxy."""
