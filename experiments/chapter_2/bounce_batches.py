"""Bounces of a Create 2 that a physics engine moves, one by one, for `physics_bounces.py`."""

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
RUN_UP, AFTER = 0.15, 0.5
FELT = ("seen", "gained", "error", "late", "aside")


@dataclasses.dataclass(frozen=True)
class Bounce:
    """A bounce to make: the run at a wall, the bump, and the turn. Angles are in degrees."""

    incidence: float
    "Of the heading with the normal of the wall; where it is positive the wall is to the left."
    turn: float
    speed: float
    back: float
    "Metres that it backs up before it turns."
    physics: Physics
    latency: float = LATENCY
    phase: float = 0.0
    "Part of the time slot of the robot, 0 to 1, by which it comes later to the wall."


def made(bounce: Bounce) -> dict[str, float]:
    """Make a bounce, and measure it by the true pose and by the encoders, in degrees and mm."""
    incidence = math.radians(bounce.incidence)
    heading = math.pi / 2 - incidence
    way = RUN_UP + bounce.phase * 0.015 * bounce.speed
    start = -way * math.cos(heading), 6 - RADIUS - way * math.sin(heading), heading
    body = PhysicsBody(HALL, start, bounce.physics)
    line = Line(latency=bounce.latency, speedup=1e9)
    robot = SimulatedCreate(Emulator(body, line=line))
    moved = robot.forward(way + AFTER, speed=bounce.speed)
    if not moved.bumped:
        return dict.fromkeys(FELT, math.nan)
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
        # With a long latency the turn goes to and fro about its end.
        error = math.nan
    return {
        "gained": math.degrees(gained),
        "seen": math.degrees(seen),
        "error": math.degrees(error),
        "late": 1000 * (moved.distance - way),
        "aside": 1000 * x,
    }


def batch(bounces: Sequence[Bounce], processes: int) -> dict[str, np.ndarray]:
    """Make bounces on several processors; `nan` stands where a bump was not felt."""
    spawn = multiprocessing.get_context("spawn")
    with concurrent.futures.ProcessPoolExecutor(processes, spawn) as pool:
        found = list(pool.map(made, bounces, chunksize=20))
    return {name: np.array([one[name] for one in found]) for name in FELT}
