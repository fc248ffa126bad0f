"""Simulate robots that start anywhere, and track them with their filter."""

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from ..base.shown import Shown
from ..space import Workspace
from .boundary import bump_gains, places_anywhere, run_to_wall
from .choice import Aim, choose_angles
from .filter import WallFilter
from .homing import Homing
from .relaxed import RelaxedFilter, RelaxedSet, likeliest
from .sets import WallSet
from .start import StartRegion


# The largest number of robots that are followed together, and of the stretches of their sets.
_ROBOTS, _STRETCHES = 1000, 1_000_000
# The number of discs for each stretch of the first set, for each bump that was not on the map.
_DISCS = 8
# An error is smaller than its bound by this factor, so that rounding does not exceed the bound.
_WITHIN = 1 - 1e-9


@dataclasses.dataclass(frozen=True, eq=False)
class Trial(Shown):
    """The runs of simulated robots, and their sets of possible places."""

    start: Float[np.ndarray, "robots 2"]
    "The place of each robot at the start, in metres."
    sets: tuple[WallSet, ...]
    """The set of possible places of the first robot after each bump, if the fewest bumps were not
    on the map."""
    outliers: int
    "The number of bumps of each robot that were not on the map."
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
    disbelieved: Int[np.ndarray, "robots bumps"]
    "The fewest bumps so far that were not on the map, by the sets."


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
    outliers: int = 0,
    seed: int = 0,
    say: Callable[..., None] = lambda doing, done=0, total=0: None,
) -> Trial:
    """Drive robots from random places, and track each robot with a filter.

    Robots start anywhere, or in the region `filter.start`. Each error of a robot has the size of
    its bound, with a random sign. `outliers` bumps of each robot, at random times, are at things
    inside the room that are not on the map, and the sets tolerate as many.

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
    place, heading = draw_starts(workspace, filter.start, robots, headings, rng)
    if start is not None:
        place[0], heading[0] = start[:2], start[2]

    def choose(state: WallSet, robots: int) -> Int[np.ndarray, "robots"]:
        if goal is not None:
            return goal.choose(state, robots, rng)
        return choose_angles(filter, state, robots, angles, rng, aim=aim, ahead=ahead)

    driver = _Driver(filter, np.asarray(angles), goal, choose, outliers, rng)
    trials = []
    first_set = len(filter.observe(None, 0.0).wall) * (1 + _DISCS * outliers)
    size = max(1, min(_ROBOTS, _STRETCHES // max(1, first_set)))
    for first in range(0, robots, size):
        say("driving robots", first, robots)
        part = slice(first, first + size)
        trials.append(driver.drive(place[part], heading[part], bumps))
    sets = trials[0][1]
    arrays = (np.concatenate(parts) for parts in zip(*(rows for rows, _ in trials), strict=True))
    return Trial(place, sets, outliers, *arrays)


def draw_starts(
    workspace: Workspace,
    region: StartRegion | None,
    robots: int,
    headings: int | None,
    rng: np.random.Generator,
) -> tuple[Float[np.ndarray, "robots 2"], Float[np.ndarray, "robots"]]:
    """Draw the places of robots in metres, and their headings in radians.

    Robots start in a region, or anywhere if it is `None`, with one of `headings` equally spaced
    headings, or with any heading if this is `None`.
    """
    draw = places_anywhere if region is None else region.draw
    place = draw(workspace, robots, rng)
    if region is not None and region.heading is not None:
        return place, np.full(robots, region.heading)
    if headings is None:
        return place, rng.uniform(0, 2 * np.pi, robots)
    return place, rng.integers(headings, size=robots) * 2 * np.pi / headings


@dataclasses.dataclass(frozen=True, eq=False)
class _Driver:
    """The robots of a trial: their filter, their angles, and the choice among them."""

    filter: WallFilter
    angles: Float[np.ndarray, "angles"]
    goal: Homing | None
    choose: Callable[[WallSet, int], Int[np.ndarray, "robots"]]
    outliers: int
    rng: np.random.Generator

    @functools.cached_property
    def tracker(self) -> WallFilter | RelaxedFilter:
        """The filter that follows the robots."""
        return RelaxedFilter(self.filter, self.outliers) if self.outliers else self.filter

    def drive(
        self, place: Float[np.ndarray, "robots 2"], heading: Float[np.ndarray, "robots"], bumps: int
    ) -> tuple[list[np.ndarray], tuple[WallSet, ...]]:
        """Drive robots from their starts; return the arrays and the sets of a [`Trial`][]."""
        filter, robots = self.filter, len(place)
        tracker: Any = self.tracker
        heading = heading + filter.errors.heading * self._signs(robots) * _WITHIN
        things = self.rng.integers(bumps, size=(self.outliers, robots))
        rows, sets, state = [], [], None
        for bump in range(bumps):
            wall, arc, run = run_to_wall(filter.boundary, place, heading)
            met = (things == bump).any(axis=0)
            short = run * self.rng.uniform(0.1, 0.9, robots) if met.any() else run
            ahead = np.stack([np.cos(heading), np.sin(heading)], axis=1)
            inside = place + short[:, None] * ahead
            place = np.where(met[:, None], inside, filter.boundary.point(wall, arc))
            run = np.where(met, short, run)
            state = tracker.observe(state, self._measure(run))
            rows.append((place, heading, run, *self._track(state, place, heading)))
            likely = likeliest(state, robots)
            sets.append(likely.take(likely.robot == 0))
            angle = self.angles[self.choose(likely, robots)]
            state = tracker.turn(state, angle)
            heading = self._turn(wall, heading, angle)
            place = self._displace(place, wall)
        return [np.stack(part, axis=1) for part in zip(*rows, strict=True)], tuple(sets)

    def _signs(self, robots: int) -> Int[np.ndarray, "robots"]:
        return self.rng.choice([-1, 1], robots)

    def _measure(self, run: Float[np.ndarray, "robots"]) -> Float[np.ndarray, "robots"]:
        """Measure the lengths of runs with the largest errors."""
        errors, robots = self.filter.errors, len(run)
        measured = run * (1 + errors.run * self._signs(robots))
        measured += errors.distance * self._signs(robots)
        measured += errors.late * self.rng.integers(2, size=robots)
        return np.maximum(measured, 0.0)

    def _track(
        self,
        state: WallSet | RelaxedSet,
        place: Float[np.ndarray, "robots 2"],
        heading: Float[np.ndarray, "robots"],
    ) -> tuple[np.ndarray, ...]:
        """Compute the last four arrays of a [`Trial`][] after a bump."""
        tracker: Any = self.tracker
        robots, goal = len(place), self.goal
        held = tracker.contains(state, self.filter.slice_of(heading), place)
        arrived = np.zeros(robots, bool)
        if goal is not None:
            arrived = tracker.within(state, robots, goal.goal, goal.radius)
        disbelieved = np.zeros(robots, int)
        if self.outliers:
            disbelieved = tracker.disbelieved(state, robots)
        return tracker.extent(state, robots), held, arrived, disbelieved

    def _turn(
        self,
        wall: Int[np.ndarray, "robots"],
        heading: Float[np.ndarray, "robots"],
        angle: Float[np.ndarray, "robots"],
    ) -> Float[np.ndarray, "robots"]:
        """Turn robots at their walls with the largest errors."""
        errors, robots = self.filter.errors, len(heading)
        gains = bump_gains(self.filter.boundary, wall, heading, errors.bump_turn)
        heading = heading + angle + np.where(self._signs(robots) > 0, *gains)
        return heading + errors.turn * self._signs(robots) * _WITHIN

    def _displace(
        self, place: Float[np.ndarray, "robots 2"], wall: Int[np.ndarray, "robots"]
    ) -> Float[np.ndarray, "robots 2"]:
        """Move robots away from their walls by the largest displacement, if nothing is in the way.

        The direction is random, within half a radian of the normal of the wall.
        """
        boundary, reach = self.filter.boundary, self.filter.errors.displacement
        if not reach:
            return place
        normal = boundary.normal[wall]
        off = self.rng.uniform(-0.5, 0.5, len(place)) + np.arctan2(normal[:, 1], normal[:, 0])
        _, _, free = run_to_wall(boundary, place + 1e-6 * normal, off)
        aside = np.stack([np.cos(off), np.sin(off)], axis=1)
        return place + np.where(free > reach, reach * _WITHIN, 0.0)[:, None] * aside
