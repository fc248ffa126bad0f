"""Single bounces of a Create 2 in a physics engine, for `physics_bounces.py`."""

import concurrent.futures
import dataclasses
import math
import multiprocessing
from collections.abc import Sequence

import numpy as np

from jaxcell.robot.create.driver import RobotStopped
from jaxcell.robot.emulation.emulator import Emulator, Line
from jaxcell.robot.emulation.simulated import SimulatedCreate
from jaxcell.robot.physics import LATENCY, RADIUS, Physics, PhysicsBody
from jaxcell.space import Workspace


HALL = Workspace([(-6, -6), (6, -6), (6, 6), (-6, 6)])
# The way to the wall, and the farthest that the robot drives beyond it, in metres.
RUN_UP, AFTER = 0.15, 0.5
MEASURED = ("seen", "gained", "error", "late", "aside")


@dataclasses.dataclass(frozen=True)
class Bounce:
    """The conditions of a bounce: a run to a wall, a bump, and a turn. Angles are in degrees."""

    incidence: float
    "Angle of the heading with the normal of the wall; positive if the wall is to the left."
    turn: float
    speed: float
    back: float
    "Metres that the robot backs up before it turns."
    physics: Physics
    latency: float = LATENCY
    phase: float = 0.0
    "Delay of the arrival at the wall, as a part 0 to 1 of the time slot of the robot."


def measure(bounce: Bounce) -> dict[str, float]:
    """Simulate a bounce, and measure the true pose and the encoders, in degrees and mm.

    All values are `nan` if the robot does not notice the bump.
    """
    incidence = math.radians(bounce.incidence)
    heading = math.pi / 2 - incidence
    way = RUN_UP + bounce.phase * 0.015 * bounce.speed
    start = -way * math.cos(heading), 6 - RADIUS - way * math.sin(heading), heading
    body = PhysicsBody(HALL, start, bounce.physics)
    line = Line(latency=bounce.latency, speedup=1e9)
    robot = SimulatedCreate(Emulator(body, line=line))
    moved = robot.forward(way + AFTER, speed=bounce.speed)
    if not moved.bumped:
        return dict.fromkeys(MEASURED, math.nan)
    x, _, bumped = body.pose
    toward = math.copysign(1.0, incidence)
    gained, seen = toward * (bumped - heading), toward * moved.angle
    if bounce.back:
        robot.forward(-bounce.back, tolerance=0.003)
    before = body.pose[2]
    try:
        turned = robot.turn(math.radians(bounce.turn), tolerance=math.radians(0.4))
        error = body.pose[2] - before - turned.angle
    except RobotStopped:
        # With a long latency the turn oscillates around its end.
        error = math.nan
    return {
        "gained": math.degrees(gained),
        "seen": math.degrees(seen),
        "error": math.degrees(error),
        "late": 1000 * (moved.distance - way),
        "aside": 1000 * x,
    }


def batch(bounces: Sequence[Bounce], processes: int) -> dict[str, np.ndarray]:
    """Measure bounces in several processes, and return an array `[bounces]` per measurement."""
    spawn = multiprocessing.get_context("spawn")
    with concurrent.futures.ProcessPoolExecutor(processes, spawn) as pool:
        results = list(pool.map(measure, bounces, chunksize=20))
    return {name: np.array([result[name] for result in results]) for name in MEASURED}
