"""Robots that start anywhere: a filter of cells, and sets on walls, against rays of its own.

    python -m experiments.chapter_2.anywhere

A robot starts anywhere in the free space, drives straight until it bumps, turns by its bouncing
angle, and so on, for `--bumps` bumps. Its clock counts whole steps of the length of a cell, or
measures runs to 5 cm. The truth is found by rays (`straight_runs.py`), which share no code with the
library.

The first table, of `--runs` robots with one of the directions of the map as heading: in how many
the filter of cells loses the robot, which a walker that knows the heading moves from cell to cell
(1,000 robots), and which moves straight as here; in how many the sets lose it; the extent of the
sets in the end, median and 90 %; from which bump on it is within half a cell, in the median, and
the share of robots where it is not in the end; the milliseconds of an observation, in the median,
after the first and of the first.

The second table, of `--few` robots of any heading: with errors at their bounds, of all signs, drawn
at each bump, in how many the sets lose the robot, and their extent after 5, 15 and 50 bumps.
"""

import copy
import dataclasses
import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from jaxcell.bounce import bounce_map, localization_filter
from jaxcell.bounce.localization.off_centre import filter_shares
from jaxcell.space import CELL_BY_CELL, CellSpace, Workspace
from jaxcell.study import Navigate
from jaxcell.walls import Errors, WallFilter, WallSet, contains

from ..shared.data import MAPS
from ..shared.options import experiment_parser, read_options
from ..shared.report import Rows, emit
from .straight_runs import Rays, anywhere


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
# Share and metres of a run, and degrees of a turn.
ERRORS = ((0.0, 0.0, 0.0), (0.01, 0.02, 0.5), (0.02, 0.05, 1.0))
AFTER = (5, 15, 50)
# The goals of robots that come home, in metres.
GOALS = {
    "lab_a.json": "1.5,0.5",
    "lab_b.json": "1.5,0.5",
    "complex.json": "0.5,0.5",
    "depot.json": "0.5,0.5",
    "slanted.json": "0.75,0.75",
    "arena.json": "1.55,0.75",
}
HOME_ERRORS = ("run=0.01", "distance=0.02", "turn=0.5")
# Robots that are followed at once, and batches of which one robot is timed by itself.
AT_ONCE, AT_ONCE_OF_ANY_HEADING, TIMED = 250, 5, 20


class Sets:
    """The calls of the library that this experiment makes, for many robots at once."""

    def __init__(
        self,
        room: Workspace,
        bounce: float,
        headings: int | None,
        errors: Errors,
        slices: int,
        clock: float = 0.0,
    ) -> None:
        self.filter = WallFilter.of(
            room, headings=headings, slices=slices, errors=errors, step=clock
        )
        self.bounce = bounce

    def fresh(self) -> "Sets":
        """The same without what it keeps from earlier robots."""
        new = copy.copy(self)
        new.filter = dataclasses.replace(self.filter)
        return new

    def observe(self, state: WallSet | None, run: np.ndarray) -> WallSet:
        """Make the set after a run, before the turn."""
        if state is not None:
            state = self.filter.turn(state, self.bounce)
        return self.filter.observe(state, run)

    def holds(self, state: WallSet, point: np.ndarray, heading: np.ndarray) -> np.ndarray:
        """Find the robots in their set; a heading between two slices is in either."""
        slices = [self.filter.slice_of(heading + by) for by in (-1e-9, 1e-9)]
        boundary = self.filter.boundary
        return np.any([contains(boundary, state, one, point) for one in slices], axis=0)

    def extent(self, state: WallSet, robots: int) -> np.ndarray:
        """The diagonal of the box around the places of each set, in metres."""
        return self.filter.extent(state, robots)


class Robots:
    """Robots that run from wall to wall, with errors at their bounds."""

    def __init__(
        self,
        room: Workspace,
        count: int,
        directions: int | None,
        errors: Errors,
        rng: np.random.Generator,
    ) -> None:
        self.rays, self.errors, self.rng = Rays(room.free_space), errors, rng
        self.point = anywhere(room.free_space, count, rng)
        if directions is None:
            self.heading = rng.uniform(0, math.tau, count)
        else:
            self.heading = rng.integers(directions, size=count) * (math.tau / directions)
        self.at = np.full(count, -1)

    def run(self) -> np.ndarray:
        """Drive to the next bump; return how far by the measure of each robot."""
        length, self.point, self.at = self.rays.run(self.point, self.at, self.heading)
        share, metres = self.signs(self.errors.run), self.signs(self.errors.distance)
        return np.maximum(length * (1 + share) + metres, 0.0)

    def turn(self, bounce: float) -> None:
        self.heading = self.heading + bounce + self.signs(self.errors.turn)

    def signs(self, bound: float) -> np.ndarray:
        return self.rng.choice([-bound, bound], len(self.point))


def cell_filter(cells: CellSpace, bounce: float, runs: int, bumps: int) -> dict[str, float]:
    """The shares of robots that a filter of cells does not hold."""
    motion = CELL_BY_CELL
    shift = round(bounce * cells.directions / math.tau)
    filter = localization_filter(bounce_map(cells, bounce)).with_trap()
    robots = Robots(room_of(cells), runs, cells.directions, Errors(), np.random.default_rng(2))
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
        "cells, walker": sum(filter_shares(filter, cells, shift, motion)),
        "cells, straight": float((state == filter.trap).mean()),
    }


def room_of(cells: CellSpace) -> Workspace:
    assert cells.workspace is not None
    return cells.workspace


@dataclasses.dataclass
class Followed:
    """Robots that sets have followed."""

    lost: np.ndarray
    "A mask of the robots that were out of their set at a bump."
    extent: np.ndarray
    "The extent of each set after each bump, by bump and robot."
    first: float
    later: float
    "The milliseconds of the first observation and of later ones, in the median."


def follow(
    sets: Sets,
    robots: Callable[[int, np.random.Generator], Robots],
    runs: int,
    bumps: int,
    at_once: int,
) -> Followed:
    """Follow robots, some at once."""
    lost, extents, first, later = [], [], [], []
    batches = -(-runs // at_once)
    for k, rng in enumerate(np.random.default_rng(1).spawn(batches)):
        some = robots(min(at_once, runs - k * at_once), rng)
        count = len(some.point)
        out, extent, state, seen = np.zeros(count, bool), [], None, []
        for _ in range(bumps):
            if state is not None:
                some.turn(sets.bounce)
            seen.append(some.run())
            state = sets.observe(state, seen[-1])
            out |= ~sets.holds(state, some.point, some.heading)
            extent.append(sets.extent(state, count))
        lost.append(out)
        extents.append(extent)
        if k < TIMED:
            alone = [run[:1] for run in seen]
            times = milliseconds(sets.fresh(), alone)
            first += times[:1]
            later += times[1:]
    return Followed(
        np.concatenate(lost),
        np.concatenate(extents, axis=1),
        float(np.median(first)),
        float(np.median(later)),
    )


def milliseconds(sets: Sets, observed: list[np.ndarray]) -> list[float]:
    """Measure the time of each observation."""
    times, state = [], None
    for run in observed:
        began = time.perf_counter()
        state = sets.observe(state, run)
        times.append(1e3 * (time.perf_counter() - began))
    return times


def known_heading(
    cells: CellSpace, bounce: float, clock: float, runs: int, bumps: int
) -> dict[str, Any]:
    """Measure the sets of robots whose heading is one of the directions."""
    room = room_of(cells)
    sets = Sets(room, bounce, cells.directions, Errors(), cells.directions, clock)
    found = follow(
        sets,
        lambda count, rng: Robots(room, count, cells.directions, Errors(), rng),
        runs,
        bumps,
        AT_ONCE,
    )
    # The bump from which on the robot is within half a cell.
    far = found.extent > cells.cell / 2
    within = np.where(far.any(axis=0), bumps + 1 - far[::-1].argmax(axis=0), 1)
    never = far[-1]
    return {
        "clock (m)": clock,
        "lost": int(found.lost.sum()),
        "extent (m)": float(np.median(found.extent[-1])),
        "90 %": float(np.quantile(found.extent[-1], 0.9)),
        "bumps": float(np.median(np.where(never, np.inf, within))),
        "never": float(never.mean()),
        "ms": found.later,
        "ms, first": found.first,
    }


def any_heading(
    cells: CellSpace, bounce: float, bounds: tuple[float, float, float], runs: int, slices: int
) -> dict[str, Any]:
    """Measure the sets of robots of any heading, with errors at their bounds."""
    room = room_of(cells)
    share, metres, degrees = bounds
    errors = Errors(run=share, distance=metres, turn=math.radians(degrees))
    began = time.perf_counter()
    sets = Sets(room, bounce, None, errors, slices)
    made = time.perf_counter() - began
    found = follow(
        sets,
        lambda count, rng: Robots(room, count, None, errors, rng),
        runs,
        max(AFTER),
        AT_ONCE_OF_ANY_HEADING,
    )
    return {
        "error": f"{100 * share:g} % + {100 * metres:g} cm, {degrees:g} deg",
        "lost": int(found.lost.sum()),
        **{f"after {k}": float(np.median(found.extent[k - 1])) for k in AFTER},
        "made (s)": made,
        "ms": found.later,
        "ms, first": found.first,
    }


def home(name: str, robots: int, bumps: int) -> dict[str, Any]:
    """Measure how robots that start anywhere come to a goal, and plans that know their start."""
    study = Navigate(
        map=MAPS / name,
        goal=GOALS[name],
        bounces=(40, 90, 130) if name == "arena.json" else (45, 90, 135),
        anywhere=True,
        heading="unknown",
        errors=HOME_ERRORS,
        measured=True,
        robots=robots,
        bumps=bumps,
    )
    came: Any = study.run()
    return {
        "case": name.split(".")[0],
        "lost": came.lost_share,
        "arrived": came.arrived_share,
        "bumps": came.median_bumps_until_home,
        "90 %": float(np.quantile(came.bumps_until_home, 0.9, method="inverted_cdf")),
        "metres": came.median_metres,
        "bumps, plan": came.planned_bumps,
        "metres, plan": came.planned_metres,
    }


def main() -> None:
    parser = experiment_parser(__doc__, "runs/chapter_2/anywhere")
    parser.add_argument("--maps", nargs="+", default=list(ANGLES), choices=list(ANGLES))
    parser.add_argument("--runs", type=int, default=10_000, help="robots of known heading")
    parser.add_argument("--few", type=int, default=200, help="robots of any heading")
    parser.add_argument("--home", type=int, default=1000, help="robots that come to a goal")
    parser.add_argument("--bumps", type=int, default=20)
    parser.add_argument("--slices", type=int, default=720, help="slices of headings")
    asked = read_options(parser)
    known: Rows = []
    unknown: Rows = []
    homes: Rows = []
    for name in asked.maps:
        cells = CellSpace.load(MAPS / name)
        for degrees in ANGLES[name]:
            bounce, case = math.radians(degrees), f"{name.split('.')[0]} {degrees:g}"
            whole = cell_filter(cells, bounce, asked.runs, asked.bumps)
            for clock in (cells.cell, 0.05):
                found = known_heading(cells, bounce, clock, asked.runs, asked.bumps)
                known.append({"case": case, **whole, **found})
        # The last of the angles, which tells most places apart.
        for bounds in ERRORS:
            found = any_heading(cells, bounce, bounds, asked.few, asked.slices)
            unknown.append({"case": case, **found})
        emit("Headings among the directions", known, asked.out / "known.csv", ".2g")
        emit("Any heading", unknown, asked.out / "unknown.csv", ".2g")
        if name in GOALS:
            homes.append(home(name, asked.home, 3 * asked.bumps))
            emit("Home from anywhere", homes, asked.out / "home.csv", ".3g")


if __name__ == "__main__":
    main()
