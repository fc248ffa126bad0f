"""Simulate robots that start anywhere, and track them with their filter."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from ..space import Workspace
from .boundary import bump_gains, places_anywhere, run_to_wall
from .choice import Aim, choose_angles
from .filter import WallFilter
from .homing import Homing
from .sets import WallSet, contains


# The largest number of robots that are followed together, and of the stretches of their sets.
_ROBOTS, _STRETCHES = 1000, 3_000_000


@dataclasses.dataclass(frozen=True, eq=False)
class Trial:
    """The runs of simulated robots, and their sets of possible places."""

    start: Float[np.ndarray, "robots 2"]
    "The place of each robot at the start, in metres."
    sets: tuple[WallSet, ...]
    "The set of possible places of the first robot after each bump."
    place: Float[np.ndarray, "robots bumps 2"]
    "The place of each bump, in metres."
    heading: Float[np.ndarray, "robots bumps"]
    "The heading of the robot before each bump, in radians."
    run: Float[np.ndarray, "robots bumps"]
    "The true length of the run before each bump, in metres."
    extent: Float[np.ndarray, "robots bumps"]
    "The diagonal of the box around the possible places, in metres; infinite for an empty set."
    held: Bool[np.ndarray, "robots bumps"]
    "True if the set after the bump contains the robot."
    arrived: Bool[np.ndarray, "robots bumps"]
    "True if the whole set is in the goal; false without a goal."


def drive_anywhere(
    workspace: Workspace,
    filter: WallFilter,
    angles: Sequence[float],
    *,
    robots: int,
    bumps: int,
    headings: int | None = None,
    goal: Homing | None = None,
    start: tuple[float, float, float] | None = None,
    aim: Aim = "mean",
    ahead: int = 1,
    seed: int = 0,
    say: Callable[..., None] = lambda doing, done=0, total=0: None,
) -> Trial:
    """Drive robots from random places, and track each robot with a filter.

    Each error of a robot has the size of its bound, with a random sign.

    **Arguments:**

    - `angles`: the bouncing angles, in radians; each robot chooses one of them at each bump.
    - `headings`: robots start with a heading `2 pi k / headings`, plus or minus its error; `None`
        for any heading.
    - `goal`: the goal of the robots; `None` for robots that are only localized.
    - `start`: x and y in metres and heading in radians of the first robot; `None` to draw them.
    - `aim`, `ahead`: as for [`choose_angles`][jaxcell.walls.choose_angles], for robots without a
        goal.
    - `say`: a function that is called with the progress: the work, the robots done, and all robots.
    """
    rng = np.random.default_rng(seed)
    place = places_anywhere(workspace, robots, rng)
    if headings is None:
        heading = rng.uniform(0, 2 * np.pi, robots)
    else:
        heading = rng.integers(headings, size=robots) * 2 * np.pi / headings
    if start is not None:
        place[0], heading[0] = start[:2], start[2]

    def choose(state: WallSet, robots: int) -> Int[np.ndarray, "robots"]:
        if goal is not None:
            return goal.choose(state, robots, rng)
        return choose_angles(filter, state, robots, angles, rng, aim=aim, ahead=ahead)

    trials = []
    size = max(1, min(_ROBOTS, _STRETCHES // max(1, len(filter.observe(None, 0.0).wall))))
    for first in range(0, robots, size):
        say("driving robots", first, robots)
        part = slice(first, first + size)
        trials.append(_drive(filter, angles, place[part], heading[part], bumps, goal, choose, rng))
    arrays = [
        np.concatenate(parts) for parts in zip(*(trial[:-1] for trial in trials), strict=True)
    ]
    return Trial(place, trials[0][-1], *arrays)


def _drive(
    filter: WallFilter,
    angles: Sequence[float],
    place: Float[np.ndarray, "robots 2"],
    heading: Float[np.ndarray, "robots"],
    bumps: int,
    goal: Homing | None,
    choose: Callable[[WallSet, int], Int[np.ndarray, "robots"]],
    rng: np.random.Generator,
) -> tuple[Any, ...]:
    errors, robots = filter.errors, len(place)

    def signs() -> Int[np.ndarray, "robots"]:
        return rng.choice([-1, 1], robots)

    heading = heading + errors.heading * signs() * (1 - 1e-9)
    rows, sets, state = [], [], None
    for _ in range(bumps):
        wall, arc, run = run_to_wall(filter.boundary, place, heading)
        place = filter.boundary.point(wall, arc)
        measured = run * (1 + errors.run * signs()) + errors.distance * signs()
        measured += errors.late * rng.integers(2, size=robots)
        state = filter.observe(state, np.maximum(measured, 0.0))
        held = contains(filter.boundary, state, filter.slice_of(heading), place)
        arrived = np.zeros(robots, bool) if goal is None else goal.arrived(state, robots)
        rows.append((place, heading, run, filter.extent(state, robots), held, arrived))
        sets.append(state.take(state.robot == 0))
        angle = np.asarray(angles)[choose(state, robots)]
        state = filter.turn(state, angle)
        gains = bump_gains(filter.boundary, wall, heading, errors.bump_turn)
        heading = heading + angle + np.where(signs() > 0, *gains)
        heading += errors.turn * signs() * (1 - 1e-9)
        place = _displaced(filter, place, wall, rng)
    return *(np.stack(part, axis=1) for part in zip(*rows, strict=True)), tuple(sets)


def _displaced(
    filter: WallFilter,
    place: Float[np.ndarray, "robots 2"],
    wall: Int[np.ndarray, "robots"],
    rng: np.random.Generator,
) -> Float[np.ndarray, "robots 2"]:
    """Move each robot away from its wall by the largest displacement, unless a wall is in the way.

    The direction is random, within half a radian of the normal of the wall.
    """
    reach = filter.errors.displacement
    if not reach:
        return place
    normal = filter.boundary.normal[wall]
    off = rng.uniform(-0.5, 0.5, len(place)) + np.arctan2(normal[:, 1], normal[:, 0])
    _, _, free = run_to_wall(filter.boundary, place + 1e-6 * normal, off)
    aside = np.stack([np.cos(off), np.sin(off)], axis=1)
    return place + np.where(free > reach, reach * (1 - 1e-9), 0.0)[:, None] * aside
