"""Compare filters of cells and sets on walls for robots that start anywhere in a room.

    python -m experiments.chapter_2.anywhere

A robot starts anywhere in the free space, drives straight until it bumps, turns by its bouncing
angle, and repeats this for `--bumps` bumps. It measures each run in whole steps of the length of a
cell, or to 5 cm. The true runs are found by rays among the polygons of the map file, with exact
arcs around corners for a disc robot (`file_rays.py`). They share no code, geometry or tolerance
with the library. A robot whose heading is parallel to a wall that it touches, or whose path touches
a corner, stops or goes on, at random.

The first table is for `--runs` robots whose heading is one of the directions of the map:

- `cells, walker` and `cells, straight`: the share of robots that a filter of cells loses, if a
  walker that knows the heading moves the robot from cell to cell (1,000 robots), and if the robot
  drives straight as in this experiment;
- `lost`: the number of robots that the sets on walls lose;
- `extent (m)` and `90 %`: the median and the 90 % quantile of the extent of the sets at the end;
- `bumps`: the median number of bumps until a robot is localized to within half a cell, which is
  the first bump with an extent of at most a cell; `never`: the share of robots without such a bump;
- `ms` and `ms, first`: the median time of an observation after the first, and of the first.

The second table is for `--few` robots with any heading. Each error is at its positive or negative
bound, drawn at each bump. The table has the number of robots that the sets lose, and the median
extent of the sets after 5, 15 and 50 bumps.

The third table is for `--home` robots that drive to a goal for three times `--bumps` bumps: the
number that the sets lose, and that are elsewhere when their sets are in the goal; the share at home
after half of the bumps and after all; and the median and the 90 % quantile of their bumps.
"""

import dataclasses
import math
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from jaxcell.bounce import bounce_map, localization_filter
from jaxcell.bounce.localization.off_centre import filter_shares
from jaxcell.space import CELL_BY_CELL, CellSpace
from jaxcell.study.bounce.anywhere import goal_at
from jaxcell.walls import Errors, Homing, WallFilter, WallSet, bumps_until_localized

from ..shared.data import MAPS
from ..shared.options import at_least, experiment_parser, read_options
from ..shared.report import Rows, emit
from .file_rays import FileRays, holds, rings_of


ANGLES = {
    "lab_a.json": (45, 135),
    "lab_b.json": (45, 135),
    "complex.json": (45, 135),
    "depot.json": (90, 135),
    "cafe.json": (112.5, 135),
    "office.yaml": (90, 135),
    "slanted.json": (67.5, 135),
    "arena.json": (70, 130),
}
# The bounds of the errors of a run, as a share and in metres, and of a turn, in degrees.
ERRORS = ((0.0, 0.0, 0.0), (0.01, 0.02, 0.5), (0.02, 0.05, 1.0))
AFTER = (5, 15, 50)
# The goals of robots in metres, and the angles in degrees that `jaxcell angles --for navigate`
# proposes for them with any heading and the errors below.
GOALS = {
    "lab_a.json": ("1.5,0.5", (105, 225, 255)),
    "lab_b.json": ("1.5,0.5", (90, 105, 150)),
    "complex.json": ("0.5,0.5", (135, 150, 225)),
    "depot.json": ("0.5,0.5", (120, 135, 285)),
    "slanted.json": ("0.75,0.75", (210, 255, 300)),
    "arena.json": ("1.55,0.75", (195, 240, 255)),
}
HOME_ERRORS = Errors(run=0.01, distance=0.02, turn=math.radians(0.5))
# A robot is in its set within this distance in metres, and this share of its radius, because arcs
# are replaced by chords.
NEAR, CHORD = 1e-7, 0.003
# The share of touches of a wall or a corner at which a robot stops, if it may go on.
STOPPING = 0.1
# The number of robots in a batch, and of batches whose first robot is timed alone.
BATCH, BATCH_OF_ANY_HEADING, BATCH_HOME, TIMED = 250, 5, 10, 20


def after_run(filter: WallFilter, state: WallSet | None, bounce: float, run: np.ndarray) -> WallSet:
    """Turn the sets by the bouncing angle, and return them after the next runs.

    The first sets are `None`, because a robot does not turn before its first run.
    """
    return filter.observe(None if state is None else filter.turn(state, bounce), run)


class Robots:
    """Robots that drive from wall to wall. Each error is at its positive or negative bound."""

    def __init__(
        self,
        room: FileRays,
        count: int,
        directions: int | None,
        errors: Errors,
        rng: np.random.Generator,
    ) -> None:
        self.room, self.errors, self.rng = room, errors, rng
        self.point = room.anywhere(count, rng)
        if directions is None:
            self.heading = rng.uniform(0, math.tau, count)
        else:
            self.heading = rng.integers(directions, size=count) * (math.tau / directions)

    def run(self) -> np.ndarray:
        """Drive to the next bump, and return the distance that each robot measures."""
        stops = self.rng.uniform(size=len(self.point)) < STOPPING
        length, self.point = self.room.run(self.point, self.heading, stops)
        share, metres = self.signs(self.errors.run), self.signs(self.errors.distance)
        return np.maximum(length * (1 + share) + metres, 0.0)

    def turn(self, bounce: float) -> None:
        self.heading = self.heading + bounce + self.signs(self.errors.turn)

    def signs(self, bound: float) -> np.ndarray:
        """Draw the sign of an error for each robot."""
        return self.rng.choice([-bound, bound], len(self.point))


def cell_filter(
    cells: CellSpace, room: FileRays, bounce: float, runs: int, bumps: int
) -> dict[str, float]:
    """Compute the shares of robots that a filter of cells loses."""
    shift = round(bounce * cells.directions / math.tau)
    filter = localization_filter(bounce_map(cells, bounce)).with_trap()
    robots = Robots(room, runs, cells.directions, Errors(), np.random.default_rng(2))
    state = np.zeros(runs, np.int64)
    for k in range(bumps):
        if k:
            robots.turn(bounce)
        steps = np.floor(robots.run() / cells.cell + 1e-9).astype(int)
        while (steps > 0).any():
            state = np.where(steps > 0, filter.transition[state, 0], state)
            steps = steps - 1
        state = filter.transition[state, 1]
    return {
        "cells, walker": sum(filter_shares(filter, cells, shift, CELL_BY_CELL)),
        "cells, straight": float((state == filter.trap).mean()),
    }


class Followed(NamedTuple):
    """The results of robots that were followed by sets on walls."""

    lost: int
    "Number of robots that were outside their set at a bump."
    extent: np.ndarray
    "The extent of each set in metres, `[bumps, robots]`."
    times: dict[str, float]
    "The median times in milliseconds of the first observation, and of the later ones."


def follow(
    filter: WallFilter,
    bounce: float,
    robots: Callable[[int, np.random.Generator], Robots],
    runs: int,
    bumps: int,
    batch: int,
) -> Followed:
    """Follow `runs` robots in batches; `robots(count, rng)` makes a batch."""
    lost, extents, first, later = 0, [], [], []
    for k, rng in enumerate(np.random.default_rng(1).spawn(-(-runs // batch))):
        some = robots(min(batch, runs - k * batch), rng)
        count = len(some.point)
        out, extent, state, seen = np.zeros(count, bool), [], None, []
        for _ in range(bumps):
            if state is not None:
                some.turn(bounce)
            seen.append(some.run())
            state = after_run(filter, state, bounce, seen[-1])
            within = NEAR + CHORD * some.room.radius
            out |= ~holds(filter, state, some.point, some.heading, within)
            extent.append(filter.extent(state, count))
        lost += int(out.sum())
        extents.append(extent)
        if k < TIMED:
            times = milliseconds(filter, bounce, [run[:1] for run in seen])
            first += times[:1]
            later += times[1:]
    times = {"ms": float(np.median(later)), "ms, first": float(np.median(first))}
    return Followed(lost, np.concatenate(extents, axis=1), times)


def milliseconds(filter: WallFilter, bounce: float, runs: list[np.ndarray]) -> list[float]:
    """Measure the time of each observation of a robot."""
    # A copy of the filter has nothing in its caches from earlier robots.
    filter, times, state = dataclasses.replace(filter), [], None
    for run in runs:
        began = time.perf_counter()
        state = after_run(filter, state, bounce, run)
        times.append(1e3 * (time.perf_counter() - began))
    return times


def known_heading(
    cells: CellSpace, room: FileRays, bounce: float, clock: float, runs: int, bumps: int
) -> dict[str, Any]:
    """Measure the sets of robots whose heading is one of the directions of the map."""
    headings = cells.directions
    filter = WallFilter.of(cells.workspace, headings=headings, errors=Errors(), step=clock)

    def robots(count: int, rng: np.random.Generator) -> Robots:
        return Robots(room, count, headings, Errors(), rng)

    lost, extent, times = follow(filter, bounce, robots, runs, bumps, BATCH)
    until = bumps_until_localized(extent.T, cells.cell / 2)
    return {
        "clock (m)": clock,
        "lost": lost,
        "extent (m)": float(np.median(extent[-1])),
        "90 %": float(np.quantile(extent[-1], 0.9, method="inverted_cdf")),
        "bumps": float(np.median(until)),
        "never": float(np.isinf(until).mean()),
        **times,
    }


def any_heading(
    cells: CellSpace,
    room: FileRays,
    bounce: float,
    bounds: tuple[float, float, float],
    runs: int,
    slices: int,
) -> dict[str, Any]:
    """Measure the sets of robots with any heading, with errors at their bounds."""
    share, metres, degrees = bounds
    errors = Errors(run=share, distance=metres, turn=math.radians(degrees))
    began = time.perf_counter()
    filter = WallFilter.of(cells.workspace, headings=None, slices=slices, errors=errors)
    made = time.perf_counter() - began

    def robots(count: int, rng: np.random.Generator) -> Robots:
        return Robots(room, count, None, errors, rng)

    lost, extent, times = follow(filter, bounce, robots, runs, max(AFTER), BATCH_OF_ANY_HEADING)
    return {
        "error": f"{100 * share:g} % + {100 * metres:g} cm, {degrees:g} deg",
        "lost": lost,
        **{f"after {k}": float(np.median(extent[k - 1])) for k in AFTER},
        "made (s)": made,
        **times,
    }


def home(name: str, room: FileRays, robots: int, bumps: int) -> dict[str, Any]:
    """Lead robots that start anywhere, with any heading, to a goal."""
    cells, (text, degrees) = CellSpace.load(MAPS / name), GOALS[name]
    goal, angles = goal_at(cells, text), np.radians(degrees)
    filter = WallFilter.of(cells.room, errors=HOME_ERRORS)
    homing, rng = Homing(filter, *goal, tuple(angles.tolist())), np.random.default_rng(777)
    at_home, lost, wrong = np.full(robots, np.inf), 0, 0
    for first in range(0, robots, BATCH_HOME):
        part = at_home[first : first + BATCH_HOME]
        some, state, out = Robots(room, part.size, None, HOME_ERRORS, rng), None, False
        for bump in range(1, bumps + 1):
            if state is not None:
                turn = angles[homing.choose(state, part.size, rng)]
                state = filter.turn(state, turn)
                some.turn(turn)
            state = filter.observe(state, some.run())
            within = NEAR + CHORD * room.radius
            out = out | ~holds(filter, state, some.point, some.heading, within)
            arrived = filter.within(state, part.size, *goal)
            away = np.hypot(*(some.point - goal[0]).T) > goal[1] + 1e-6
            wrong += int((arrived & away).sum())
            part[arrived & np.isinf(part)] = bump
        lost += int(np.sum(out))
    return {
        "case": name.split(".")[0],
        "robots": robots,
        "lost": lost,
        "wrong": wrong,
        "home, half, %": 100 * float((at_home <= bumps / 2).mean()),
        "home, %": 100 * float(np.isfinite(at_home).mean()),
        "bumps": float(np.median(at_home)),
        "90 %": float(np.quantile(at_home, 0.9, method="inverted_cdf")),
    }


def main() -> None:
    parser = experiment_parser(__doc__, "runs/chapter_2/anywhere")
    parser.add_argument("--maps", nargs="+", default=list(ANGLES), choices=list(ANGLES))
    parser.add_argument(
        "--runs", type=at_least(1), default=10_000, help="robots with a heading of the map"
    )
    parser.add_argument("--few", type=at_least(1), default=200, help="robots with any heading")
    parser.add_argument("--home", type=at_least(1), default=1000, help="robots that have a goal")
    parser.add_argument("--bumps", type=at_least(1), default=20, help="bumps of each robot")
    parser.add_argument("--slices", type=at_least(1), default=720, help="slices of headings")
    options = read_options(parser)
    known: Rows = []
    unknown: Rows = []
    homes: Rows = []
    for name in options.maps:
        cells, room = CellSpace.load(MAPS / name), FileRays(*rings_of(MAPS / name))
        for degrees in ANGLES[name]:
            bounce, case = math.radians(degrees), f"{name.split('.')[0]} {degrees:g}"
            whole = cell_filter(cells, room, bounce, options.runs, options.bumps)
            for clock in (cells.cell, 0.05):
                row = known_heading(cells, room, bounce, clock, options.runs, options.bumps)
                known.append({"case": case, **whole, **row})
        # The last of the angles distinguishes most places.
        for bounds in ERRORS:
            row = any_heading(cells, room, bounce, bounds, options.few, options.slices)
            unknown.append({"case": case, **row})
        emit("Headings among the directions", known, options.out / "known.csv", ".2g")
        emit("Any heading", unknown, options.out / "unknown.csv", ".2g")
        if name in GOALS:
            homes.append(home(name, room, options.home, 3 * options.bumps))
            emit("From anywhere to a goal", homes, options.out / "home.csv", ".3g")


if __name__ == "__main__":
    main()
